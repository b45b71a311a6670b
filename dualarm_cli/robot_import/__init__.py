"""Import of a robot from its URDF: arms, platform, limits, contacts and home posture."""
