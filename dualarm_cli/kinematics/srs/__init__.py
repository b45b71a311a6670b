"""Arms with a spherical shoulder, a revolute elbow and a spherical wrist, in closed form."""
