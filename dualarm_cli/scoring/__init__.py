"""Cells that must not get worse: cases found, held against a baseline, and told in the formats of CI."""
