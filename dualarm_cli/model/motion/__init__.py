"""Motion of joints: trajectories, splines of joint groups, and times from rest to rest."""
