"""Schedule files: writing, reading, and the cell as URDF."""
