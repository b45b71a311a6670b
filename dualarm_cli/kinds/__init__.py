"""One package for each kind of work that needs planning of its own."""
