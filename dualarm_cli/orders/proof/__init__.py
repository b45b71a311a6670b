"""Bounds on all orders, and orders that are nearly as good."""
