"""Collisions of a plan and their repairs: delays, curves, via points, paths of the whole robot."""
