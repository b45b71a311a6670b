"""Part of a table that each arm reaches without collision, and from which platform angles."""
