"""Rules that orders keep: buffer levels and tool stands."""
