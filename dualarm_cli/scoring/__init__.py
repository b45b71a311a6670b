"""Cells that must not get worse: cases found, compared with a baseline, and told in the formats of CI."""
