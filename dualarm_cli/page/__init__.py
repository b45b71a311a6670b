"""Interactive HTML page of a plan: one self-contained file in which the cell moves."""
