"""Minimum time over a whole sequence: platform angles and postures of both arms together, and a bound."""
