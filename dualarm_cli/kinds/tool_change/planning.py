"""Tool changes in the planner: two stops more wherever the next task asks for another tool."""

from __future__ import annotations

from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.orders.model.tool_changes import with_changes

PLANNING = KindPlanning(works=lambda task: task.is_change, decided=with_changes)
