"""Measuring of motions for all checks: tool poses, spans, instants, criteria, tolerances."""
