"""Readers of input files: YAML, URDF, CSV and units become the data model."""
