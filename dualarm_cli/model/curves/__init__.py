"""Curves by the length along them: contours on parts, tool paths, points for controllers."""
