"""Command line: the only layer that prints, where errors become exit codes."""
