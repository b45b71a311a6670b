"""Readers of task files: schema, rules across tasks, and the tasks themselves."""
