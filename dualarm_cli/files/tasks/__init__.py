"""Task files to jobs."""
