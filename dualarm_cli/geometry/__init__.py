"""Numeric tools without robots: arrays, angles, rotations and polynomial roots."""
