"""Planning of a job up to its unverified schedule: sections, candidate orders and methods."""
