"""General optimisers on the same decisions, for comparison."""
