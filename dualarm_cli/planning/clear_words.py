"""What is said of stages that do not keep clear."""

from __future__ import annotations

import numpy as np

from dualarm_cli.errors import BlockedError, millimetres
from dualarm_cli.model.job import Job
from dualarm_cli.planning.clearing import Cleared, Clearing
from dualarm_cli.planning.motion import Motion
from dualarm_cli.planning.stage_plan import StagePlan
from dualarm_cli.planning.stage_samples import stage_samples

ADVICE = (
    "what helps: other targets or tasks in that stage (two arms whose targets are that near need an order in which "
    "they take turns), moving what is in the way, or a clearance of its own (`clearances`) for the pair"
)
"""What a person can do about it."""


MANY = 0.02
"""Share of stages; where lines touch in more of them, another order is better than mending."""


def refuse_touching_lines(clearing: Clearing, plans: list[StagePlan], motion: Motion) -> None:
    """Refuses many stages in which both arms' lines touch: no mending helps them as much as another order.

    Args:
        clearing: the job.
        plans: its stages.
        motion: theirs.

    Raises:
        BlockedError: with those stages.
    """
    apart = tuple(clearing.side_by_side(plans, clearing.touching(plans, motion)))
    if len(apart) > max(1.0, MANY * len(plans)):
        raise BlockedError(why_blocked(clearing, Cleared(plans, motion, apart)), apart)


def why_blocked(clearing: Clearing, found: Cleared | None) -> str:
    """Returns which stages do not keep clear, with the pair of bodies and what is missing."""
    head = (
        "no plan was found that keeps clear by other postures, platform angles, waits, detours or "
        "paths of the whole robot"
    )
    if found is None:
        return head
    lines, cell = [], clearing.holding.cell
    for k in found.blocked:
        samples = stage_samples(found.motion, k, k, clearing.holding)
        margins = cell.margins(samples.position, samples.held)
        worst = int(np.argmin(margins))
        one, other, margin = cell.nearest(samples.position[worst], samples.held[worst])
        stage = found.motion.stages[k]
        when = (stage.end - stage.start) * worst / (len(margins) - 1)
        places = ", ".join(
            f"{stop.stop.place}: task '{stop.task.id}'" for stop in found.plans[k].stops.values()
        )
        lines.append(
            f"{places or 'return'}: {one} and {other} lack {millimetres(min(0.0, margin))} of clearance "
            f"{when:.2f} s into stage {k + 1}"
        )
    return f"{head}:\n  " + "\n  ".join(lines) + f"\n{ADVICE}{_standing(clearing.job, found)}"


def _standing(job: Job, found: Cleared) -> str:
    """Returns which arms stand where they started in stages that do not keep clear, as their work begins later."""
    words = ""
    for arm in job.cell.robot.arms:
        first = next((k for k, plan in enumerate(found.plans) if arm.name in plan.stops), 0)
        if found.blocked and min(found.blocked) < first:
            where = "home" if job.start == "free" else job.start
            words += (
                f"; the {arm.name} arm stands in posture '{where}' before stage {first + 1}, its first: a bare `move` "
                "before its other tasks takes it out of the way"
                + (" (in stage 1 it starts there: `start: free`)" if job.start == "free" else "")
            )
    return words
