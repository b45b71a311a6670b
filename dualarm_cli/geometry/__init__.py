"""Numbers in, numbers out: arrays, angles, rotations and polynomial roots, with no robot in sight."""
