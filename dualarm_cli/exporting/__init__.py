"""Schedules to files and back."""
