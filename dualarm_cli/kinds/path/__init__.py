"""Tool paths: tools follow curves with a speed, one arm or both together."""
