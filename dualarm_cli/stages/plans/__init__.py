"""Plans of whole sequences as arrays: decisions, joints and times."""
