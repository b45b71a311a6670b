"""Seams: one arm holds the part, the other one works along a curve on it."""
