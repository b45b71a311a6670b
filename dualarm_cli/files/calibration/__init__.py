"""Files of touched points, and of the base that a calibration writes."""
