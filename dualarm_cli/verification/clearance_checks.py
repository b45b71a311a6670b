"""Whether everything that may not touch keeps its clearance, proven over the whole motion."""

from __future__ import annotations

from bisect import bisect, insort
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    bodies_without_shape,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import AT_STANDS, GIVES, LYING, TAKES, Job
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import COLLISIONS, SHAPES, Check, StageClearance
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.clearance_proof import (
    PRECISION,
    ClearanceProof,
    UnprovenError,
    Windows,
)
from dualarm_cli.verification.kind_checks import Touch
from dualarm_cli.verification.line_spans import LineSpan, line_spans
from dualarm_cli.verification.motion_checks import judge, not_checked
from dualarm_cli.verification.tool_model import ToolModel


def edges_of(schedule: Schedule) -> FloatArray:
    """Returns the starts and ends of the stages and of the motion [s]; one stretch where no stages are stated."""
    time = schedule.trajectory.time
    first, last = float(time[0]), float(time[-1])
    edges = sorted({first, *(s.start for s in schedule.stages if first < s.start < last)})
    for end in sorted(stage.end for stage in schedule.stages):
        # An end that only rounding parts from where the next stage starts is no edge of its own.
        place = bisect(edges, end)
        near = (*edges[place - 1 : place + 1], last)
        if first < end < last and all(abs(end - edge) > tol.SAME_TIME for edge in near):
            insort(edges, end)
    return np.array([*edges, last])


def stages_of(schedule: Schedule, edges: FloatArray) -> list[list[int]]:
    """Returns the stages that each stretch between two edges is part of.

    What is between stages counts with the last that has begun: no motion is left out.
    """
    starts = np.array([stage.start for stage in schedule.stages])
    ends = np.array([stage.end for stage in schedule.stages])
    found = []
    for start, end in pairwise(edges.tolist()):
        inside = np.flatnonzero((starts <= start) & (end <= ends + tol.SAME_TIME)).tolist()
        begun = np.flatnonzero(starts <= start)
        last = int(begun[np.argmax(starts[begun])]) if len(begun) else 0
        found.append(inside or [last])
    return found


NOT_ASKED = "not requested; `dualarm verify PLAN --tasks FILE` proves it"
NO_JOB = "obstacles, tools and clearances are in the cell file: no task file was given (--tasks)"
Span = tuple[float, float]
"""From when to when [s]."""


def check_clearance(
    schedule: Schedule, job: Job | None, spans: Sequence[LineSpan] | None = None
) -> tuple[Check, tuple[StageClearance, ...]]:
    """Checks the clearance of all pairs of bodies, and returns the least of every stage.

    A carried part belongs to its arm from the pick's event to the place's; one that is handed over to the giver until
    it lets go, and to the taker once that has gripped. On the lines where it is picked and placed it need not be
    clear of obstacles (it lies on one), only not reach into them. From the taker's approach to the end of the giver's
    retract both tools may touch it. A changed tool belongs to its arm while it is on, and has the same right as a part
    on the lines at its stand. What stands there without an arm is no obstacle.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks, each with the arm that did it; without them nothing is checked.
        spans: of the job's stops (`line_spans`), with the job's robot; measured where they are not given.
    """
    if job is None:
        return not_checked(COLLISIONS, NO_JOB), ()
    model, solids, pairs, windows = watched_pairs(schedule, job, spans)
    if not pairs:
        return not_checked(COLLISIONS, "there are no two bodies with shapes that may touch"), ()
    # Parts that may lie on something have no clearance to speak of: they count where they reach into it.
    kept, lying = (
        [k for k, pair in enumerate(pairs) if (pair.required < 0.0) is contact]
        for contact in (False, True)
    )
    try:
        proven = [
            _proven(
                model,
                solids,
                [pairs[k] for k in some],
                [windows[k] for k in some],
                schedule,
                precision,
            )
            # What may lie on something is allowed so little that the proof must not use it up.
            for some, precision in ((kept, PRECISION), (lying, 0.1 * tol.CONTACT_SLACK))
        ]
    except UnprovenError:
        where = "cannot be proven: the motion goes too far between its knots, beyond the limits of its joints"
        return judge(COLLISIONS, np.nan, tol.CLEARANCE_SLACK, "m", where), ()
    stages = [*proven[0], *(stage for stage in proven[1] if stage.margin < -tol.CLEARANCE_SLACK)]
    stages.sort(key=lambda stage: stage.stage)
    if not stages:
        return not_checked(COLLISIONS, "the motion has no length"), ()
    worst = min(stages, key=lambda stage: stage.margin)
    where = (
        f"{worst.bodies[0]} and {worst.bodies[1]} at {worst.time:.4f} s: "
        f"{_millimetres(worst.clearance)} where {_millimetres(worst.required)} "
        f"{'are required' if worst.required >= 0.0 else 'are allowed'}"
    )
    return judge(COLLISIONS, -worst.margin, tol.CLEARANCE_SLACK, "m", where), tuple(stages)


def watched_pairs(
    schedule: Schedule, job: Job, spans: Sequence[LineSpan] | None = None
) -> tuple[pin.Model, list[Solid], list[Pair], list[Windows]]:
    """Returns the robot's model, the solids of the cell, the pairs that must keep apart, and when each pair counts.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks, each with the arm that did it.
        spans: see `check_clearance`.
    """
    # Robot and tools are the job's, whatever the schedule states.
    schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    solids = cell_solids(job.cell, model, job.carried())
    if spans is None:
        spans = line_spans(schedule, job, ToolModel(schedule))
    return model, solids, *_pairs_and_windows(model, solids, schedule, job, spans)


def check_shapes(job: Job) -> list[Check]:
    """Checks that each arm and each tool has a shape: without one its clearance is not proven.

    Args:
        job: cell and tasks.

    Returns:
        One check that is `not checked` and names what has no shape, or none.
    """
    missing = bodies_without_shape(job.cell)
    return [not_checked(SHAPES, f"no shapes of {', '.join(missing)}")] if missing else []


def _proven(
    model: pin.Model,
    solids: Sequence[Solid],
    pairs: list[Pair],
    windows: list[Windows],
    schedule: Schedule,
    precision: float,
) -> list[StageClearance]:
    """Returns the least margin of some pairs in every stage in which they count."""
    proof = ClearanceProof(model, solids, pairs, windows, schedule.trajectory)
    edges = edges_of(schedule)
    least: dict[int, StageClearance] = {}
    for found, numbers in zip(
        proof.certify(edges, precision), stages_of(schedule, edges), strict=True
    ):
        if found.pair < 0:
            continue
        pair = pairs[found.pair]
        for number in numbers:
            if number in least and least[number].margin <= found.margin:
                continue
            least[number] = StageClearance(
                stage=number,
                clearance=found.margin + pair.required,
                margin=found.margin,
                required=pair.required,
                bodies=(solids[pair.first].label, solids[pair.second].label),
                time=found.time,
            )
    return [least[number] for number in sorted(least)]


def _millimetres(distance: float) -> str:
    if distance < 0.0:
        return f"{-distance * 1e3:.1f} mm of penetration"
    return f"{distance * 1e3:.1f} mm"


def _pairs_and_windows(
    model: pin.Model,
    solids: Sequence[Solid],
    schedule: Schedule,
    job: Job,
    spans: Sequence[LineSpan],
) -> tuple[list[Pair], list[Windows]]:
    """Returns the pairs, and when each counts; a part's pairs with obstacles twice, in transfers and on lines."""
    pairs: list[Pair] = []
    windows: list[Windows] = []
    touches = [touch for kind in of_kinds("checks") for touch in kind.touches(job, spans)]
    for pair in pairs_that_must_keep_apart(model, solids, job.cell):
        one, other = solids[pair.first], solids[pair.second]
        carriers = [solid for solid in (one, other) if solid.carrier]
        if not carriers:
            _add_plain(pairs, windows, pair, _touching(touches, one, other), schedule)
            continue
        held = [_carried(schedule, job, solid) for solid in carriers]
        during = held[0] if len(held) == 1 else _overlaps(held[0], held[1])
        during = _without(during, _touching(touches, one, other, gripped=True))
        if len(carriers) == 1 and WORLD in (one.joint, other.joint):
            lines = _lines(job, carriers[0], spans)
            pairs += [pair, Pair(pair.first, pair.second, -tol.CONTACT_SLACK)]
            windows += [_without(during, lines), _overlaps(during, lines)]
        else:
            pairs.append(pair)
            windows.append(during)
    return pairs, windows


def _add_plain(
    pairs: list[Pair],
    windows: list[Windows],
    pair: Pair,
    works: Sequence[Span],
    schedule: Schedule,
) -> None:
    """Appends a pair that carries no part: always, but while one works on the other it need only not reach into it."""
    if not works:
        pairs.append(pair)
        windows.append(None)
        return
    time = schedule.trajectory.time
    pairs += [pair, Pair(pair.first, pair.second, -tol.CONTACT_SLACK)]
    windows += [_without([(float(time[0]), float(time[-1]))], works), works]


def _touching(
    touches: Sequence[Touch], one: Solid, other: Solid, *, gripped: bool = False
) -> list[Span]:
    """Returns when two solids may touch, where one grips the other or where it does not [s]; sorted."""
    bodies = {(solid.carrier, solid.body) for solid in (one, other)}
    mine = [touch for touch in touches if touch.gripped is gripped and touch.bodies == bodies]
    return sorted({(touch.start, touch.end) for touch in mine})


def _carried(schedule: Schedule, job: Job, solid: Solid) -> list[Span]:
    """Returns when an arm carries a part or has a tool on [s].

    A part from where it takes it to where it gives it, or to the end; a tool from the start where it is on then, and
    from each time that it is taken, until it is left or to the end.
    """
    arm, end = solid.carrier, float(schedule.trajectory.time[-1])
    tasks = _tasks_of(solid, job)
    spans = []
    if solid.bolted:
        own = [e for e in schedule.events if e.arm == arm and e.task in tasks]
        begins = [e.time for e in own if e.action in TAKES]
        if job.cell.start_tool(arm) == solid.tool:
            begins.append(float(schedule.trajectory.time[0]))
        left = [(e.time, e.changes_held) for e in own if e.action in GIVES]
        for begin in begins:
            spans.append((begin, min((over for at, over in left if at >= begin), default=end)))
        return spans
    for event in schedule.events:
        if event.arm != arm or event.task not in tasks or event.action not in TAKES:
            continue
        ends = [
            e.changes_held
            for e in schedule.events
            if (e.arm, e.task) == (arm, event.task) and e.action in GIVES and e.time >= event.time
        ]
        spans.append((event.changes_held, min(ends, default=end)))
    return spans


def _tasks_of(solid: Solid, job: Job) -> set[str]:
    """Returns the tasks that move a part, of the tool that grips it, or that take or leave a tool."""
    return {
        task.id
        for task in job.tasks
        if (task.arm, task.tool) == (solid.carrier, solid.tool)
        and (task.is_change if solid.bolted else task.part == solid.body)
    }


def _lines(job: Job, solid: Solid, spans: Sequence[LineSpan]) -> list[Span]:
    """Returns when a part's carrier is on the lines or dwells at the ends of its way, or at the stand of a tool [s].

    Sorted and apart.
    """
    tasks, actions = _tasks_of(solid, job), AT_STANDS if solid.bolted else LYING
    joined: list[Span] = []
    for start, end in sorted(
        (span.start, span.end)
        for span in spans
        if span.event.arm == solid.carrier
        and span.event.task in tasks
        and span.event.action in actions
    ):
        if joined and start <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(end, joined[-1][1]))
        else:
            joined.append((start, end))
    return joined


def _overlaps(one: Sequence[Span], other: Sequence[Span]) -> list[Span]:
    """Returns what two lists of spans have in common."""
    both = [(max(a, c), min(b, d)) for a, b in one for c, d in other]
    return [(start, end) for start, end in both if start < end]


def _without(spans: Sequence[Span], holes: Sequence[Span]) -> list[Span]:
    """Returns spans without others, which are sorted and apart."""
    left = []
    for start, end in spans:
        here = start
        for a, b in holes:
            if a < end and b > here:
                if a > here:
                    left.append((here, a))
                here = max(here, b)
        if here < end:
            left.append((here, end))
    return left
