"""Joints to poses and back: the platform's chain and arms in closed form."""
