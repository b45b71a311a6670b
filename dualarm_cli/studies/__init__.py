"""Layout studies: plan points of a parameter space, rank them, and analyse sensitivity."""
