"""Which part of a table each arm reaches, clear of everything that stands, from which platform angles."""
