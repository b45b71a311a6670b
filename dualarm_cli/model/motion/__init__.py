"""Motion of joints as data: trajectories, splines of one or several joints, and times from rest to rest."""
