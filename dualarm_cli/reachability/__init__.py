"""Reach maps: table areas that arms reach without collision, by platform angle."""
