"""From a job to a verified schedule: sections, candidate orders and methods."""
