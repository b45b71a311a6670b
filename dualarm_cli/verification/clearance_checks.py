"""Verdicts on clearance: pairs that may not touch, exceptions, findings by stage."""

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
    are_near,
    bodies_without_shape,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import COLLISIONS, SHAPES, Check, StageClearance
from dualarm_cli.records import dataclass
from dualarm_cli.verification.clearance_proof import (
    PROOF,
    Certified,
    ClearanceProof,
    UnprovenError,
    Windows,
)
from dualarm_cli.verification.kind_checks import Touch
from dualarm_cli.verification.lying_bodies import ExecutedJob, LyingBodies
from dualarm_cli.verification.measuring.criteria import judge, not_checked
from dualarm_cli.verification.measuring.holding_spans import (
    Span,
    carrying_spans,
    overlaps,
    spans_on_lines,
    without,
)
from dualarm_cli.verification.measuring.line_spans import LineSpan, line_spans
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel


def edges_of(schedule: Schedule) -> FloatArray:
    """List the starts and ends of the stages and of the motion [s]."""
    time = schedule.trajectory.time
    first, last = float(time[0]), float(time[-1])
    edges = sorted({first, *(s.start for s in schedule.stages if first < s.start < last)})
    for end in sorted(stage.end for stage in schedule.stages):
        # An end that differs from the start of the next stage by rounding is no further edge.
        place = bisect(edges, end)
        near = (*edges[place - 1 : place + 1], last)
        if first < end < last and all(abs(end - edge) > TOL.same_time for edge in near):
            insort(edges, end)
    return np.array([*edges, last])


def stages_of(schedule: Schedule, edges: FloatArray) -> list[list[int]]:
    """List the stages that contain each interval between two edges.

    Motion between stages counts with the last stage that has begun, so that none is left out.
    """
    starts = np.array([stage.start for stage in schedule.stages])
    ends = np.array([stage.end for stage in schedule.stages])
    stages = []
    for start, end in pairwise(edges.tolist()):
        inside = np.flatnonzero((starts <= start) & (end <= ends + TOL.same_time)).tolist()
        begun = np.flatnonzero(starts <= start)
        last = int(begun[np.argmax(starts[begun])]) if len(begun) else 0
        stages.append(inside or [last])
    return stages


NO_JOB = "obstacles, tools and clearances are in the cell file: no task file was given (--tasks)"


def check_clearance(
    schedule: Schedule, job: Job | None, spans: Sequence[LineSpan] | None = None
) -> tuple[Check, tuple[StageClearance, ...]]:
    """Check the clearance of all pairs of bodies, stage by stage.

    A carried part belongs to its arm from the pick's event to the place's. In a hand-over it belongs to the giver until
    the giver lets go, and to the taker from its grip on; both tools may touch it from the taker's approach to the end
    of the giver's retract. On the lines of its pick and place a part may touch obstacles, because it lies on one, but
    not penetrate them. The same holds for a changed tool on the lines at its stand; it belongs to its arm while it is
    mounted. A tool in its stand is no obstacle.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks, each with the arm that did it; None checks nothing.
        spans: of the job's stops (`line_spans`), with the job's robot; None measures them.

    Returns:
        The check, and the least clearance of each stage; where near links have it, also that of all other pairs.
    """
    if job is None:
        return not_checked(COLLISIONS, NO_JOB), ()
    watched = watched_pairs(schedule, job, spans)
    if not watched.pairs:
        return not_checked(COLLISIONS, "there are no two bodies with shapes that may touch"), ()
    edges = edges_of(schedule)
    parts = stages_of(schedule, edges)
    try:
        stages = watched.least(edges, parts)
        touching = [
            watched.certified(edges, contact=True, lying=False),
            watched.certified(
                edges, contact=True, lying=True, other_margins=np.zeros(len(edges) - 1)
            ),
        ]
        # Near links would hide what else is near.
        apart = watched.least(edges, parts, near=False) if any(s.near for s in stages) else []
    except UnprovenError:
        where = "cannot be proven: the motion goes too far between its knots, beyond the limits of its joints"
        return judge(COLLISIONS, np.nan, TOL.clearance_slack, where), ()
    # Parts that may lie on something have no clearance: they count only if they penetrate it.
    deep = watched.by_stage(parts, touching)
    stages += [stage for stage in deep if stage.margin < -TOL.clearance_slack]
    if not stages:
        return not_checked(COLLISIONS, "the motion has no length"), ()
    worst = min(stages, key=lambda stage: stage.margin)
    where = (
        f"{worst.bodies[0]} and {worst.bodies[1]} at {worst.time:.4f} s: "
        f"{_millimetres(worst.clearance)} where {_millimetres(worst.required)} "
        f"{'are required' if worst.required >= 0.0 else 'are allowed'}"
    )
    hidden = {stage.stage for stage in stages if stage.near}
    stages += [stage for stage in apart if stage.stage in hidden]
    stages.sort(key=lambda stage: stage.stage)
    return judge(COLLISIONS, -worst.margin, TOL.clearance_slack, where), tuple(stages)


@dataclass(frozen=True)
class WatchedPairs:
    """Pairs of solids that must keep apart along a motion."""

    model: pin.Model
    """Model of the robot, with a joint for every belt that carries parts."""
    solids: list[Solid]
    """Solids of the cell, and of parts that wait or lie."""
    pairs: list[Pair]
    """Pairs that must keep apart, one for each required distance."""
    windows: list[Windows]
    """Windows in which each pair counts."""
    trajectory: Trajectory
    """Motion of the model's joints."""

    def least(
        self, edges: FloatArray, stages: Sequence[Sequence[int]], *, near: bool = True
    ) -> list[StageClearance]:
        """Prove the least margin of every stage, of pairs that may not touch.

        Args:
            edges: instants [s], see `ClearanceProof.certify`.
            stages: numbers of the stages of every interval (`stages_of`).
            near: whether near links count.
        """
        plain = self.certified(edges, contact=False, lying=False, near=near)
        # Of many parts that wait or lie few come near: only those that may be the nearest are measured.
        margins = np.array([interval.met for interval in plain])
        resting = self.certified(edges, contact=False, lying=True, other_margins=margins)
        return self.by_stage(stages, [plain, resting])

    def certified(
        self,
        edges: FloatArray,
        *,
        contact: bool,
        lying: bool,
        near: bool = True,
        other_margins: FloatArray | None = None,
    ) -> list[Certified]:
        """Prove the least margin of the selected pairs between neighbouring edges.

        Args:
            edges: instants [s], see `ClearanceProof.certify`.
            other_margins: margins of other pairs between the edges [m], see there.
            contact: selects the pairs that may touch, or all others.
            lying: selects the pairs of parts that wait or lie, or all others.
            near: whether pairs of near links are among them.
        """
        selected = [
            k
            for k, pair in enumerate(self.pairs)
            if (pair.required < 0.0) is contact
            and bool(self.solids[pair.second].lying) is lying
            and (near or not self.are_near(pair))
        ]
        proof = ClearanceProof(
            self.model,
            self.solids,
            [self.pairs[k] for k in selected],
            [self.windows[k] for k in selected],
            self.trajectory,
        )
        # Parts that may lie on something have little allowance, which the proof must not use up.
        precision = 0.1 * TOL.contact_slack if contact else PROOF.precision
        certified = proof.certify(edges, precision, other_margins)
        return [
            replace(interval, pair=selected[interval.pair]) if interval.pair >= 0 else interval
            for interval in certified
        ]

    def are_near(self, pair: Pair) -> bool:
        """Test whether a pair is one of near links."""
        return are_near(self.model, self.solids[pair.first], self.solids[pair.second])

    def by_stage(
        self, stages: Sequence[Sequence[int]], certified: Sequence[Sequence[Certified]]
    ) -> list[StageClearance]:
        """List the least margin of every stage in which a pair counts.

        Args:
            stages: numbers of the stages of every interval (`stages_of`).
            certified: proven margins of several groups of pairs, interval by interval.
        """
        least: dict[int, StageClearance] = {}
        for group in certified:
            for interval, numbers in zip(group, stages, strict=True):
                if interval.pair < 0:
                    continue
                pair = self.pairs[interval.pair]
                for number in numbers:
                    if number in least and least[number].margin <= interval.margin:
                        continue
                    least[number] = StageClearance(
                        stage=number,
                        clearance=interval.margin + pair.required,
                        margin=interval.margin,
                        required=pair.required,
                        bodies=(self.solids[pair.first].label, self.solids[pair.second].label),
                        time=interval.time,
                        near=self.are_near(pair),
                    )
        return [least[number] for number in sorted(least)]


def watched_pairs(
    schedule: Schedule, job: Job, spans: Sequence[LineSpan] | None = None
) -> WatchedPairs:
    """List the pairs of solids that must keep apart, with windows.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks, each with the arm that did it.
        spans: see `check_clearance`.
    """
    # Robot and tools are the job's, whatever the schedule states.
    schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    solids = cell_solids(job.cell, model, job.carried())
    tools = ToolModel(schedule)
    if spans is None:
        spans = line_spans(schedule, job, tools)
    pairs, windows = _pairs_and_windows(model, solids, schedule, job, spans)
    resting = LyingBodies.of(ExecutedJob(schedule, job, spans, tools), model, solids)
    pairs += [pair for pair, _ in resting.pairs]
    windows += [during for _, during in resting.pairs]
    return WatchedPairs(
        model, [*solids, *resting.solids], pairs, windows, resting.with_belts(schedule.trajectory)
    )


def check_shapes(job: Job) -> list[Check]:
    """Check that each arm and each tool has a shape, which clearance needs.

    Args:
        job: cell and tasks.

    Returns:
        One check that is `not checked` and names the bodies without shape, or none.
    """
    missing = bodies_without_shape(job.cell)
    return [not_checked(SHAPES, f"no shapes of {', '.join(missing)}")] if missing else []


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
    """List pairs of solids with the windows in which they count.

    Pairs of a part and an obstacle appear twice: in transfers and on lines.
    """
    pairs: list[Pair] = []
    windows: list[Windows] = []
    touches = [touch for kind in of_kinds("checks") for touch in kind.touches(job, spans)]
    for pair in pairs_that_must_keep_apart(model, solids, job.cell):
        solid_a, solid_b = solids[pair.first], solids[pair.second]
        carriers = [solid for solid in (solid_a, solid_b) if solid.carrier]
        if not carriers:
            _add_plain(pairs, windows, pair, touching_spans(touches, solid_a, solid_b), schedule)
            continue
        carried = [carrying_spans(schedule, job, solid) for solid in carriers]
        during = carried[0] if len(carried) == 1 else overlaps(carried[0], carried[1])
        during = without(during, touching_spans(touches, solid_a, solid_b, gripped=True))
        if len(carriers) == 1 and WORLD in (solid_a.joint, solid_b.joint):
            lines = spans_on_lines(job, carriers[0], spans)
            pairs += [pair, Pair(pair.first, pair.second, -TOL.contact_slack)]
            windows += [without(during, lines), overlaps(during, lines)]
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
    """Append a pair without parts; while one works on the other, contact is allowed."""
    if not works:
        pairs.append(pair)
        windows.append(None)
        return
    time = schedule.trajectory.time
    pairs += [pair, Pair(pair.first, pair.second, -TOL.contact_slack)]
    windows += [without([(float(time[0]), float(time[-1]))], works), works]


def touching_spans(
    touches: Sequence[Touch], solid_a: Solid, solid_b: Solid, *, gripped: bool = False
) -> list[Span]:
    """List the spans in which two solids may touch [s], sorted.

    Args:
        touches: of a job.
        solid_a: one of the solids.
        solid_b: the other one.
        gripped: selects spans in which one grips the other, or those in which it does not.
    """
    bodies = {(solid.carrier, solid.body) for solid in (solid_a, solid_b)}
    matching = [touch for touch in touches if touch.gripped is gripped and touch.bodies == bodies]
    return sorted({(touch.start, touch.end) for touch in matching})
