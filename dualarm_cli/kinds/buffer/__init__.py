"""Buffers for parts between tasks."""
