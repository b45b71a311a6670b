"""The page beside a plan: one HTML file in which the cell moves."""
