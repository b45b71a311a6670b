"""Search for the fastest plan of fixed stages over platform angles and postures."""
