"""Figures, drawn without a screen, the same bytes for the same input."""
