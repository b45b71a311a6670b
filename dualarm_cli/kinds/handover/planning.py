"""Planner interface of hand-overs: both arms meet."""

from __future__ import annotations

from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.notes import Note

HANDED_TOGETHER = Note(
    "mode: free: with hand-overs, both arms start each stage together in this version", "mode"
)
"""Note on asynchronous arms that have to meet."""

PLANNING = KindPlanning(works=lambda task: task.handover is not None, synchronous=HANDED_TOGETHER)
