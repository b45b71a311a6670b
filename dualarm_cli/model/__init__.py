"""Frozen data values from files to reports, and closed-form minimum times."""
