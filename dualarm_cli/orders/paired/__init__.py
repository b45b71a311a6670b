"""Orders of synchronous stages on a turning platform."""
