"""Decided stages to one trajectory: transfers, lines, dwells and waits, merged at common knots."""
