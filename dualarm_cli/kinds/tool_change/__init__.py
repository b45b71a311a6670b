"""Tools that arms take from stands and leave there."""
