"""Collisions of a plan and their repairs: delays, curves, via points."""
