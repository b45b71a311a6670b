"""Collision model: solids, pairs to check, and a quick test of many postures."""
