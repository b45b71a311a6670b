"""What people read of a schedule: measures, tables and the report file."""
