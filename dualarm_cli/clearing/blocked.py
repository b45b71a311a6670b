"""Reasons why a job has no collision-free plan: of its start, parts and grips, and of stages that stay blocked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.clearing.stage_samples import stage_samples
from dualarm_cli.collision.lying import too_near
from dualarm_cli.errors import BlockedError
from dualarm_cli.model.job import ANY, Job, JointTarget, Stop, Task
from dualarm_cli.postures.holding import Holding
from dualarm_cli.refusals import Refusal

MOST_PAIRS = 30
"""Most pairs of bodies that a message lists, worst first."""


def start_faults(job: Job, holding: Holding) -> list[Refusal]:
    """Return why no motion begins in the start posture: all pairs of bodies that lack clearance; nothing if it may.

    Args:
        job: with its start.
        holding: what has to be collision-free.
    """
    if job.start == "free":
        return []
    lacking = holding.cell.lacking(np.array(job.start_joints), holding.before[0])
    pairs = [
        Refusal("touches", measured=-margin, more={"one": one, "other": other})
        for one, other, margin in lacking
    ]
    if not pairs:
        return []
    rest = len(pairs) - MOST_PAIRS
    more = {
        "posture": job.start,
        "pairs": pairs[:MOST_PAIRS],
        "rest": f", and {rest} more pairs" if rest > 0 else "",
    }
    place = job.start_place if job.start_place.line else None
    return [Refusal("start_touches", place, measured=pairs[0].measured, more=more)]


def reaches_into(task: Task, stop: Stop, arm: str, held: str, depth: float, into: str) -> Refusal:
    """Return that a part, or a tool, is inside an obstacle at a stop.

    Args:
        task: of the stop.
        stop: where.
        arm: that makes it.
        held: name of the part or tool.
        depth: how deep at best [m].
        into: name of the obstacle.
    """
    more = {"action": stop.action.split("_")[0], "held": held, "into": into}
    what = "part_reaches_into" if held == task.part else "tool_reaches_into"
    remedy: tuple[str, ...] = ()
    if held != task.part and not task.is_change:
        what, remedy = "tool_too_near", ("move_target", "allow_contact")
    return Refusal(what, stop.place, task.id, arm, depth, remedy=remedy, more=more)


def grip_faults(job: Job) -> list[Refusal]:
    """Return hand-overs in which tools or part are too near to each other: no posture changes that.

    Those whose arms are open are left out.

    Args:
        job: with its tasks.
    """
    takes = {task.id: task.stops[0] for task in job.tasks if task.stops[0].action == "take"}
    found = []
    for task in job.tasks:
        work, give = task.handover, task.stops[-1]
        if work is None or give.action != "give" or task.arm == ANY:
            continue
        lengths = takes[task.id].approach, give.retract
        for one in too_near(job.cell, work, task.id, task.part, *lengths):
            more = {"where": one.where, "one": one.bodies[0], "other": one.bodies[1]}
            found.append(
                Refusal("grip_touches", work.place, task.id, task.arm, -one.margin, more=more)
            )
    return found


def refuse_touching_lines(clearing: Clearing, plan: TimedPlan) -> None:
    """Refuse many stages in which both arms' lines touch: another order helps more than repairs.

    Args:
        clearing: collision checks of the job.
        plan: its stages and their motion.

    Raises:
        BlockedError: with those stages.
    """
    apart = tuple(
        clearing.side_by_side(plan.plans, clearing.colliding_stages(plan.plans, plan.motion))
    )
    if len(apart) > max(1.0, clearing.settings.crowded_stages * len(plan.plans)):
        raise BlockedError(*why_blocked(clearing, replace(plan, blocked=apart)), stages=apart)


def why_blocked(clearing: Clearing, found: TimedPlan | None) -> list[Refusal]:
    """Returns which stages collide, with the pair of bodies and what is missing."""
    if found is None:
        return [Refusal("not_clear")]
    refusals, cell = [], clearing.holding.cell
    standing, tried = _standing(clearing.job, found), _tried(clearing)
    for k in found.blocked:
        samples = stage_samples(found.motion, k, k, clearing.holding)
        margins = cell.margins(samples.position, samples.held)
        worst = int(np.argmin(margins))
        one, other, margin = cell.nearest(samples.position[worst], samples.held[worst])
        stage = found.motion.stages[k]
        stops = list(found.plans[k].stops.values())
        row = slice(worst, worst + 1)
        if stops and cell.cross_margins(samples.position[row], samples.held[row])[0] <= margin:
            # Of an arm that stands, its last stop says why it is there.
            active = set(found.plans[k].stops)
            before = [plan.stops for plan in found.plans[:k]]
            last = {arm: stop for each in before for arm, stop in each.items()}
            stops += [stop for arm, stop in last.items() if arm not in active]
        more = {
            "one": one,
            "other": other,
            "when": (stage.end - stage.start) * worst / (len(margins) - 1),
            "stage": k + 1,
            "beside": [
                Refusal("beside", None, stop.task.id, stop.arm, more={"there": stop.stop.place})
                for stop in stops[1:]
            ],
            "standing": standing,
            "tried": tried,
        }
        refused = Refusal("return_touches", measured=max(0.0, -margin), more=more)
        for stop in stops[:1]:
            whose = stop.stop.place, stop.task.id, stop.arm
            refused = Refusal("stage_touches", *whose, refused.measured, more=more)
        if cell.skew > 0.0 and margin >= 0.0:
            refused = replace(refused, what="stage_lacks_skew", allowed=cell.skew)
        refusals.append(refused)
    return refusals


def _tried(clearing: Clearing) -> list[Refusal]:
    """Return what was tried against collisions, where that is anything: only what was done, and could be."""
    targets = [stop.target for task in clearing.job.tasks for stop in task.stops]
    given = all(isinstance(one, JointTarget) and len(one.configurations) == 1 for one in targets)
    ways = [] if given else [Refusal("other_postures")]
    platform = clearing.model.platform
    if platform.is_chosen:
        ways.append(Refusal("other_places" if platform.is_rail else "other_angles"))
    ways += [Refusal(way) for way in ("delays", "detours") if way in clearing.tried]
    return [Refusal("tried", more={"ways": ways})] if ways else []


def _standing(job: Job, found: TimedPlan) -> list[Refusal]:
    """Returns which arms stand where they started in stages that collide, as their work begins later."""
    standing = []
    for arm in job.cell.robot.arms:
        first = next((k for k, plan in enumerate(found.plans) if arm.name in plan.stops), 0)
        if found.blocked and min(found.blocked) < first:
            more = {
                "posture": job.start_posture,
                "stage": first + 1,
                "start": [Refusal("starts_there")] if job.start == "free" else [],
            }
            standing.append(Refusal("stands_in_the_way", arm=arm.name, more=more))
    return standing
