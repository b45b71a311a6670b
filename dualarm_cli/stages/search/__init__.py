"""The fastest plan of fixed stages: a search over platform angles and postures of the whole sequence."""
