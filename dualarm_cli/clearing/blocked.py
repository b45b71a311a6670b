"""Refusals of jobs without a collision-free plan: start, parts, grips and blocked stages."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np

from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.clearing.stage_samples import stage_samples
from dualarm_cli.collision.clearance import LEVER
from dualarm_cli.collision.lying import too_near
from dualarm_cli.errors import BlockedError
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.job import ANY, GIVES, LYING, Job, JointTarget, PoseTarget, Stop, Task
from dualarm_cli.model.part_flow import kind_of_part
from dualarm_cli.postures.holding import Holding, TooNearObstacle
from dualarm_cli.refusals import Refusal

MOST_PAIRS = 30
"""Maximum number of body pairs in a message, worst first."""


NEAR_POSTURES = 500
"""Number of random postures that decide whether a pair of bodies is never clear."""


def start_faults(job: Job, holding: Holding) -> list[Refusal]:
    """Refuse bodies that lack clearance in every posture, and others at the start.

    Bodies that overlap in every posture count at the start, if it is given: contacts that are not allowed may be meant.

    Args:
        job: the job, with its start posture.
        holding: bodies that must not collide.
    """
    lacking = holding.cell.lacking(np.array(job.start_joints), holding.before[0])
    special = {frozenset(pair): least for *pair, least in job.cell.clearances}
    never = [
        (body_a, body_b, margin)
        for body_a, body_b, margin in _never_clear(job, holding, lacking)
        if job.start == "free"
        or margin + special.get(frozenset((body_a, body_b)), job.cell.clearance) >= 0.0
    ]
    named = {pair[:2] for pair in never}
    at_start = [] if job.start == "free" else [p for p in lacking if p[:2] not in named]
    refusals = []
    for key, touching in (("never_clear", never), ("start_touches", at_start)):
        pairs = [
            Refusal("touches", measured=-margin, data={"body_a": body_a, "body_b": body_b})
            for body_a, body_b, margin in touching
        ]
        omitted = len(pairs) - MOST_PAIRS
        details = {
            "posture": job.start,
            "pairs": pairs[:MOST_PAIRS],
            "rest": f", and {omitted} more pairs" if omitted > 0 else "",
            "entries": [replace(pair, key="pair_clearance") for pair in pairs[:MOST_PAIRS]],
        }
        place = job.start_place if job.start_place.line else None
        if pairs:
            refusals.append(Refusal(key, place, measured=pairs[0].measured, data=details))
    return refusals


def _never_clear(
    job: Job, holding: Holding, lacking: list[tuple[str, str, float]]
) -> list[tuple[str, str, float]]:
    """Find the pairs that lack clearance in every random posture, with the largest margins [m].

    Such are links whose distance their joints hardly change, with a clearance that is wider.

    Args:
        job: the job.
        holding: bodies that must not collide.
        lacking: pairs that lack clearance at the start, with their margins.
    """
    robot, random = job.cell.robot, np.random.default_rng(0)
    low, high = np.maximum(robot.limits.lower, -TURN), np.minimum(robot.limits.upper, TURN)
    largest = {(body_a, body_b): margin for body_a, body_b, margin in lacking}
    for _ in range(NEAR_POSTURES):
        if not largest:
            return []
        there = holding.cell.lacking(random.uniform(low, high), holding.before[0])
        margins = {(body_a, body_b): margin for body_a, body_b, margin in there}
        largest = {pair: max(largest[pair], margins[pair]) for pair in largest if pair in margins}
    return [(*pair, margin) for pair, margin in largest.items()]


def reaches_into(task: Task, stop: Stop, arm: str, fault: TooNearObstacle) -> Refusal:
    """Return the refusal of a part or tool too near to an obstacle.

    Args:
        task: the task of the stop.
        stop: the stop.
        arm: the arm at the stop.
        fault: the part or tool, and the obstacle.
    """
    is_part = fault.held == task.part
    held = kind_of_part(fault.held) if is_part else fault.held
    details = {"action": stop.action.split("_")[0], "held": held, "into": fault.into}
    if fault.needed is not None:
        where = "approach begins" if stop.action in GIVES else "retract ends"
        line = where.split()[0]
        # Without `blend: none`, lines are as long as their straight parts.
        longer = "longer_approach" if line == "approach" else "longer_retract"
        longer = "longer_straight" if getattr(stop, line) == stop.straight else longer
        details |= {"where": where}
        values = fault.needed - fault.lacks, fault.needed, (longer, "own_clearance")
        return Refusal("line_ends_near", stop.place, task.id, arm, *values, details)
    code, advice = "part_reaches_into" if is_part else "tool_reaches_into", tuple[str, ...]()
    if not task.is_change and not (is_part and stop.action in LYING):
        code, advice = "tool_too_near", ("move_target", "allow_contact")
    return Refusal(code, stop.place, task.id, arm, fault.lacks, remedy=advice, data=details)


def grip_faults(job: Job) -> list[Refusal]:
    """Refuse hand-overs whose tools or part are too close in every posture.

    Of those without fixed arms only pairs of grasps are checked, for either giver; the search of orders refuses others.

    Args:
        job: the job.
    """
    takers = {task.id: task for task in job.tasks if task.stops[0].action == "take"}
    refusals = []
    for task in job.tasks:
        work, give = task.handover, task.stops[-1]
        if work is None or give.action != "give" or (task.arm == ANY and task.grasp is None):
            continue
        taker = takers[task.id]
        take = taker.stops[0]
        drawn = [
            line.back(stop.target.pose.rotation, length)
            for stop, (length, line) in ((take, take.lines[0]), (give, give.lines[1]))
            if isinstance(stop.target, PoseTarget)
        ]
        arms = permutations([arm.name for arm in job.cell.robot.arms], 2)
        works = [replace(work, giver=a, taker=b) for a, b in arms if task.allows(a)]
        contacts = [too_near(job.cell, work, task.part, taker.part, *drawn) for work in works]
        for contact in contacts[0] if all(contacts) else ():
            details = {
                "where": contact.where,
                "body_a": contact.bodies[0],
                "body_b": contact.bodies[1],
            }
            refusals.append(
                Refusal(
                    "grip_touches", work.place, task.id, task.arm, -contact.margin, data=details
                )
            )
    return refusals


def refuse_touching_lines(clearing: Clearing, plan: TimedPlan) -> None:
    """Refuse a plan with many stages in which both arms' lines collide.

    Args:
        clearing: collision checks of the job.
        plan: its stages and their motion.

    Raises:
        BlockedError: names those stages. Another order helps more than repairs.
    """
    touching_lines = tuple(
        clearing.side_by_side(plan.plans, clearing.colliding_stages(plan.plans, plan.motion))
    )
    if len(touching_lines) > max(1.0, clearing.settings.crowded_stages * len(plan.plans)):
        raise BlockedError(
            *why_blocked(clearing, replace(plan, blocked=touching_lines)), stages=touching_lines
        )


def why_blocked(clearing: Clearing, plan: TimedPlan | None) -> list[Refusal]:
    """Explain the blocked stages of a plan: colliding bodies and missing clearance."""
    if plan is None:
        return [Refusal("not_clear")]
    refusals, cell = [], clearing.holding.cell
    standing, tried = _standing(clearing.job, plan), _tried(clearing)
    for k in plan.blocked:
        samples = stage_samples(plan.motion, k, k, clearing.holding)
        margins = cell.margins(samples.position, samples.held)
        worst = int(np.argmin(margins))
        body_a, body_b, margin = cell.nearest(samples.position[worst], samples.held[worst])
        stage = plan.motion.stages[k]
        stops = list(plan.plans[k].stops.values())
        row = slice(worst, worst + 1)
        if stops and cell.cross_margins(samples.position[row], samples.held[row])[0] <= margin:
            # The last stop of a standing arm explains its position.
            active = set(plan.plans[k].stops)
            before = [plan.stops for plan in plan.plans[:k]]
            last = {arm: stop for stops_before in before for arm, stop in stops_before.items()}
            stops += [stop for arm, stop in last.items() if arm not in active]
        details = {
            "body_a": body_a,
            "body_b": body_b,
            "when": (stage.end - stage.start) * worst / (len(margins) - 1),
            "stage": k + 1,
            "partner": [
                Refusal("partner", None, stop.task.id, stop.arm, data={"there": stop.stop.place})
                for stop in stops[1:]
            ],
            "standing": standing,
            "tried": tried,
        }
        refused = Refusal("return_touches", measured=max(0.0, -margin), data=details)
        arm, spare = cell.least_spare_tilt(samples.position[row], samples.held[row])
        leans = LEVER * spare < margin
        first = plan.plans[k].stops.get(arm) if leans else None
        for stop in [first] if first else stops[:1]:
            origin = stop.stop.place, stop.task.id, stop.arm
            refused = Refusal("stage_touches", *origin, refused.measured, data=details)
        if leans:
            details["degrees"] = np.degrees(-spare)
            refused = replace(refused, key="stage_leans", arm=arm, measured=-spare)
        elif cell.skew > 0.0 and margin >= 0.0:
            refused = replace(refused, key="stage_lacks_skew", allowed=cell.skew)
        refusals.append(refused)
    return refusals


def _tried(clearing: Clearing) -> list[Refusal]:
    """Return a note on the remedies tried against collisions; empty if none applied."""
    targets = [stop.target for task in clearing.job.tasks for stop in task.stops]
    given = all(
        isinstance(target, JointTarget) and len(target.configurations) == 1 for target in targets
    )
    remedies = [] if given else [Refusal("other_postures")]
    platform = clearing.model.platform
    if platform.is_chosen:
        remedies.append(Refusal("other_places" if platform.is_rail else "other_angles"))
    remedies += [Refusal(remedy) for remedy in ("delays", "detours") if remedy in clearing.tried]
    return [Refusal("tried", data={"repairs": remedies})] if remedies else []


def _standing(job: Job, plan: TimedPlan) -> list[Refusal]:
    """Return the arms that stand at their start in a blocked stage."""
    standing = []
    for arm in job.cell.robot.arms:
        first = next((k for k, plan in enumerate(plan.plans) if arm.name in plan.stops), 0)
        if plan.blocked and min(plan.blocked) < first:
            details = {
                "posture": job.start_posture,
                "stage": first + 1,
                "start": [Refusal("starts_there")] if job.start == "free" else [],
            }
            standing.append(Refusal("stands_in_the_way", arm=arm.name, data=details))
    return standing
