"""Reader of study files."""
