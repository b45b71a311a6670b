"""What a capable user would try instead: general optimisers on the same decisions, for comparison."""
