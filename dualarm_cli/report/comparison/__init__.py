"""Comparisons of methods, of schedules and of layouts: documents and tables."""
