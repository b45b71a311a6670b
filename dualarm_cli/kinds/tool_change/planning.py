"""Planner interface of tool changes.

Stops at stands are inserted wherever the next task needs another tool.
"""

from __future__ import annotations

from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.orders.model.tool_changes import with_changes

PLANNING = KindPlanning(works=lambda task: task.is_change, decided=with_changes)
