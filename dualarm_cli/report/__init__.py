"""Reports of a schedule for people: measures, tables and the report file."""
