"""Studies of layouts, and evaluations of their points and of other jobs."""
