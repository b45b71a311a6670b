"""The command line: the only layer that prints, and the one place where errors become exit codes."""
