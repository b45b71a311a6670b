"""A robot's folder from its URDF: arms, platform, limits, contacts and a posture to start from, found and explained."""
