"""Robot files, URDF and DH parameters to robots."""
