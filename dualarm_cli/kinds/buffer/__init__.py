"""Room for parts on the way from one task to another."""
