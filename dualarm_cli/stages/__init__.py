"""Which posture each arm takes at every stop of given stages: stage by stage, or the whole sequence at once."""
