"""Plans of all stages together as numbers: what is decided, and what it means in joints and seconds."""
