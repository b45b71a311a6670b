"""Who does what in which order: exact for few tasks, by search for many, with bounds."""
