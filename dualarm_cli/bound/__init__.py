"""A lower bound on the cycle time of every plan of given stages."""
