"""First project for a robot: cell, reachable tasks, study and CI workflow."""
