"""Files to the data model: the only code that knows YAML, URDF, degrees, millimetres or line numbers."""
