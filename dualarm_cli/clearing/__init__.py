"""Collisions of a plan and their repairs: delays and curves."""
