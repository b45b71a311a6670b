"""Orders of asynchronous arms while the platform stands still."""
