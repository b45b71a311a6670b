"""What there is to collide with."""
