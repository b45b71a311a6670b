"""Waiting and lying parts as bodies for the proof of clearance.

A part is where the tool is at the event that picks or places it, measured on the motion. The tool that picks or places
it may touch it on its lines; from there to its neighbouring stops it must not penetrate it deeper than at the outer end
of the line, or at the grip without a line. Parts may touch if one's task names the other's in `touches`, but must not
penetrate each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    pairs_with_lying,
    shape_solid,
    solid_distance,
)
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import Job, StopKey
from dualarm_cli.model.lying import LyingPart, Visit, lying_parts, may_touch
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import WORK_ENDS, Event, Schedule
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass
from dualarm_cli.verification.clearance_proof import Windows
from dualarm_cli.verification.measuring.holding_spans import Span, carrying_spans, overlaps, without
from dualarm_cli.verification.measuring.line_spans import LineSpan, spans_of
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel


@dataclass(frozen=True)
class LyingBodies:
    """Solids of parts that wait or lie, and their pairs."""

    solids: list[Solid] = field(default_factory=list)
    """Solids in the frames of the root link or of belts' joints."""
    pairs: list[tuple[Pair, Windows]] = field(default_factory=list)
    """Pairs that must keep apart, the moving solid first, and the windows in which they count."""
    belts: dict[tuple[float, ...], int] = field(default_factory=dict)
    """Joints of belts by their velocities in the world [m/s]."""

    @classmethod
    def of(cls, motion: ExecutedJob, model: pin.Model, solids: Sequence[Solid]) -> LyingBodies:
        """Find the parts that wait and lie in a schedule.

        Args:
            motion: the schedule and the job as it was done.
            model: of the robot; belts that carry parts become joints of it.
            solids: of the cell, numbered before those of lying parts.
        """
        bodies, job = cls(), motion.job
        for lying in lying_parts(job, motion.visits):
            span = motion.lies(lying)
            if not span[0] < span[1]:
                continue
            solids_of_part = bodies._solids_at(lying, motion, model)
            numbers = range(
                len(solids) + len(bodies.solids),
                len(solids) + len(bodies.solids) + len(solids_of_part),
            )
            bodies.solids.extend(solids_of_part)
            for pair in pairs_with_lying([*solids, *bodies.solids], numbers, job.cell):
                shape = motion.shapes(lying)[pair.second - numbers.start]
                for depth, during in motion.allowed_depths(lying, shape, solids[pair.first], model):
                    required = pair.required if depth is None else -TOL.contact_slack - depth
                    if inside := overlaps([span], during):
                        bodies.pairs.append((replace(pair, required=required), inside))
        return bodies

    def _solids_at(self, lying: LyingPart, motion: ExecutedJob, model: pin.Model) -> list[Solid]:
        """Build a part's solids at the pose of its tool at the event."""
        event, base = motion.events[lying.key], motion.job.cell.base
        pose, joint = motion.tool_pose(event), WORLD
        if event.moves:
            joint = self._belt(event.velocity, base, model)
            travelled = (event.changes_held - motion.whole[0]) * np.array(event.velocity)
            pose = pin.SE3(pose.rotation, pose.translation - travelled)
        placed = [
            shape_solid(lying.task.part, joint, base.actInv(pose), shape)
            for shape in motion.shapes(lying)
        ]
        return [replace(solid, lying=lying.label) for solid in placed]

    def _belt(self, velocity: tuple[float, ...], base: pin.SE3, model: pin.Model) -> int:
        """Return the joint of a belt, added to the model at its first use."""
        if velocity not in self.belts:
            along = product(base.rotation.T, np.array(velocity))
            joint = pin.JointModelPrismaticUnaligned(along / norm(along))
            name = f"belt {len(self.belts)}"
            self.belts[velocity] = model.addJoint(WORLD, joint, pin.SE3.Identity(), name)
        return self.belts[velocity]

    def with_belts(self, motion: Trajectory) -> Trajectory:
        """Append the joints of belts to a motion, at zero when it starts."""
        if not self.belts:
            return motion
        speed = norm(np.array(list(self.belts)), axis=1)
        travelled, rows = (
            (motion.time - motion.time[0])[:, None] * speed,
            np.ones((len(motion.time), 1)),
        )
        return Trajectory(
            (*motion.joints, *(f"belt {k}" for k in range(len(speed)))),
            motion.time,
            np.hstack([motion.position, travelled]),
            np.hstack([motion.velocity, rows * speed]),
            np.hstack([motion.acceleration, np.zeros_like(travelled)]),
        )


@dataclass(frozen=True)
class ExecutedJob:
    """A schedule and the job as it was done, by stops and lying parts."""

    schedule: Schedule
    """Schedule with the job's robot."""
    job: Job
    """Job with the arm that did each task."""
    spans: Sequence[LineSpan]
    """Spans of the job's stops."""
    tools: ToolModel
    """Forward kinematics of the tools."""

    @cached_property
    def stops(self) -> Mapping[StopKey, Visit]:
        """Stops and tasks by arm, task and action."""
        return {(t.arm, t.id, s.action): (t, s) for t in self.job.tasks for s in t.stops}

    @cached_property
    def events(self) -> Mapping[StopKey, Event]:
        """First event of each stop, in time order."""
        first_events: dict[StopKey, Event] = {}
        for event in sorted(self.schedule.events, key=lambda event: event.changes_held):
            key = event.arm, event.task, event.action
            if key in self.stops:
                # The velocity of the target is the job's.
                first_events.setdefault(key, replace(event, velocity=self.stops[key][1].velocity))
        return first_events

    @property
    def visits(self) -> list[Visit]:
        """Stops in the order of their events."""
        return [self.stops[key] for key in self.events]

    @property
    def whole(self) -> Span:
        """Start and end of the motion [s]."""
        time = self.schedule.trajectory.time
        return float(time[0]), float(time[-1])

    def lies(self, lying: LyingPart) -> Span:
        """Compute the span in which a part waits or lies [s]."""
        start, end = self.whole
        if lying.until is not None:
            end = self.events[lying.until].changes_held
        if lying.since is not None and lying.since in self.events:
            start = self.events[lying.since].changes_held
        elif lying.fed:
            start = end
        if lying.fed:
            start = min(start, *(span.start for span in spans_of(self.spans, *lying.key)))
        return start, end

    def tool_pose(self, event: Event) -> pin.SE3:
        """Compute the arm's tool centre point in the world as it grips or releases."""
        time = np.array([event.changes_held])
        return self.tools.pose(event.arm, self.schedule.trajectory.clamped(time)[0][0])

    def shapes(self, lying: LyingPart) -> tuple[Shape, ...]:
        """Return a part's solids in the frame of its tool centre point."""
        task = lying.task
        return self.job.cell.held_shapes(task.arm, Held(task.tool, task.part))[1]

    def allowed_depths(
        self, lying: LyingPart, shape: Shape, solid: Solid, model: pin.Model
    ) -> list[tuple[float | None, list[Span]]]:
        """List the depths to which a solid may penetrate a lying part, with spans.

        Args:
            lying: the part.
            shape: one of the part's shapes.
            solid: of the robot, a tool, or a part that is carried.
            model: of the robot.

        Returns:
            Depths [m], None where the clearance is required, and the spans [s] of each.
        """
        if solid.carrier and not solid.bolted:
            tasks = [t for t in self.job.tasks if t.arm == solid.carrier and t.tool == solid.tool]
            return [
                (
                    0.0 if may_touch(task, lying.task) else None,
                    carrying_spans(self.schedule, self.job, solid, task.id),
                )
                for task in tasks
                if task.part == solid.body
            ]
        during = [self.whole]
        if solid.bolted:
            during = carrying_spans(self.schedule, self.job, solid)
        touching: list[tuple[float | None, list[Span]]] = []
        stops = {
            key: self._at_stop(key)
            for key in (lying.key, lying.until)
            if key is not None and solid.joint == self._flange(key[0], model).parentJoint
        }
        lines = sorted(line for line, _ in stops.values())
        depths = [
            (self._depth(lying, shape, key, solid, model), between)
            for key, (_, between) in stops.items()
        ]
        # Between two of its stops it may penetrate as deep as at either line's end.
        for depth, between in sorted(depths, reverse=True):
            touching.append((depth, overlaps(without([between], lines), during)))
            during = without(during, [between])
        return [(None, during), *touching]

    def _flange(self, arm: str, model: pin.Model) -> pin.Frame:
        return model.frames[
            model.getFrameId(self.job.cell.robot.arm(arm).flange, pin.FrameType.BODY)
        ]

    def _at_stop(self, key: StopKey) -> tuple[Span, Span]:
        """Return the spans of a stop's lines, and between the neighbouring work [s]."""
        start, end = self.whole
        event, events_of_arm = (
            self.events[key],
            [e for e in self.schedule.events if e.arm == key[0]],
        )
        before = [e.changes_held for e in events_of_arm if e.changes_held < event.time]
        after = [e.time for e in events_of_arm if e.time > event.changes_held]
        # A path or seam has its event at its end.
        works = [s for s in self.schedule.segments if s.arm == key[0] and s.kind in WORK_ENDS]
        after += [s.start for s in works if s.start > event.time]
        [span, *_] = spans_of(self.spans, *key)
        between = max(before, default=start), min(after, default=end)
        return (span.start, span.end), between

    def _depth(
        self, lying: LyingPart, shape: Shape, key: StopKey, solid: Solid, model: pin.Model
    ) -> float:
        """Measure a tool's penetration of a part at the outer end of its line [m]."""
        stop = self.stops[key][1]
        flange, arm = self._flange(key[0], model), key[0]
        pose_at_stop = self.tool_pose(self.events[key])
        pose_of_part = self.tool_pose(self.events[lying.key])
        length, line = stop.lines[stop.action != "pick"]
        back = line.back(pose_at_stop.rotation, -length)
        tool = (flange.placement * self.job.cell.tools[arm].tcp).actInv(solid.pose)
        part = shape_solid("", WORLD, back * pose_at_stop.actInv(pose_of_part), shape)
        places = [coal.Transform3s(p.rotation, p.translation) for p in (tool, part.pose)]
        return max(0.0, -solid_distance(solid, places[0], part, places[1]))
