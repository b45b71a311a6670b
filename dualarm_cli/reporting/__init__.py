"""What people read of a schedule: tables, figures and the report file."""
