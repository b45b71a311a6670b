"""Methods that choose each arm's posture at every stop of given stages."""
