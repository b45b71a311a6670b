"""Forward and inverse kinematics of platforms and arms."""
