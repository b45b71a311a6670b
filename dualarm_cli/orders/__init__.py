"""Searches for arms, order and pairing of tasks."""
