"""Regression scores of cells: find cases, compare them with a baseline, report to CI."""
