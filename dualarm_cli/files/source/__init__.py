"""Text of input files with places: YAML, quantities with units, typed documents, overrides."""
