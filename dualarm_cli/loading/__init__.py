"""Files to nouns: the only code that knows YAML, URDF, degrees, millimetres or line numbers."""
