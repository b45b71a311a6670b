"""A first project for a robot: cell, tasks, study and CI workflow, with targets that this robot reaches."""
