"""Shared parts of commands: options, output, result files, interrupts, progress."""
