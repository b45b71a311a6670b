"""Times of a plan's pieces under a changed job, its decisions kept.

Postures keep their branch and arm angles (arms without arm angles: the nearest posture) at targets that move. Lines
and transfers take the times of the search for stages: line ends that the plan passes in motion have the default launch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from dualarm_cli.effort import EFFORTS
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import BLENDINGS
from dualarm_cli.model.job import Job, PoseTarget, Stop
from dualarm_cli.model.schedule import TOOL_SPEED, Event, Schedule, Segment
from dualarm_cli.records import dataclass
from dualarm_cli.report.critical_path import TimedPiece, pieces_of
from dualarm_cli.report.stage_parts import CORNERS, PLATFORM
from dualarm_cli.stages.plans.candidates import CandidatePostures
from dualarm_cli.stages.plans.launches import default_launches
from dualarm_cli.stages.plans.passing import passed, transfer_times
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, SequenceProblem
from dualarm_cli.stages.plans.source import given_postures, postures
from dualarm_cli.stages.plans.times import left_with
from dualarm_cli.stages.sequence_problem import stops_problem
from dualarm_cli.stages.serving import cell_model
from dualarm_cli.verification.as_done import job_as_done

LINES = ("approach", "retract")


@dataclass(frozen=True)
class KeptStop:
    """Stop of an arm in the plan."""

    event: Event
    """Its event."""
    q: FloatArray
    """Joints at approach start, target and retract end [rad], shape (3, n)."""
    passes: tuple[bool, bool]
    """Whether the ends of approach and retract are passed in motion."""
    platform: FloatArray
    """Joints of the platform [rad], shape (k,)."""


@dataclass(frozen=True)
class KeptPlan:
    """Plan whose decisions are kept while its job changes."""

    schedule: Schedule
    """The plan."""
    job: Job
    """The job that it is of."""

    @cached_property
    def pieces(self) -> list[TimedPiece]:
        """Pieces of the plan."""
        return pieces_of(self.schedule)

    @cached_property
    def stops(self) -> Mapping[str, list[KeptStop]]:
        """Stops of each arm in order."""
        schedule = self.schedule
        robot, motion = schedule.robot, schedule.trajectory
        lines: dict[tuple[str, ...], Segment] = {
            (part.arm, part.task, part.action, part.kind): part
            for part in schedule.segments
            if part.kind in LINES
        }
        stops: dict[str, list[KeptStop]] = {arm: [] for arm in robot.arms}
        for event in schedule.events:
            key = event.arm, event.task, event.action
            approach, retract = (lines.get((*key, kind)) for kind in LINES)
            start = event.time if approach is None else approach.start
            end = event.time + event.dwell if retract is None else retract.end
            position, velocity, _ = motion.clamped(np.array([start, event.time, end]))
            columns = [motion.joints.index(name) for name in robot.arms[event.arm].joints]
            moves = np.abs(velocity[:, columns]).max(axis=1) > CORNERS.at_rest
            platform = position[1, [motion.joints.index(name) for name in robot.platform]]
            passes = bool(moves[0]), bool(moves[2])
            stops[event.arm].append(KeptStop(event, position[:, columns], passes, platform))
        return stops

    @cached_property
    def times(self) -> FloatArray | None:
        """Modelled time of each piece as the job is [s], shape (pieces,)."""
        return self._modelled(self.job)

    def lengths(self, changed: Job) -> FloatArray | None:
        """Estimate the time of each piece under a changed job [s], shape (pieces,).

        None where a posture of the plan is out of reach, or a time is not modelled.
        """
        before, after = self.times, self._modelled(changed)
        if before is None or after is None:
            return None
        present = np.array([piece.length for piece in self.pieces])
        # A piece that the tool's speed limits, or that makes a detour, keeps its excess over the model.
        excess = present - before
        estimated = after + excess
        if self.job.tool_speed is not None and changed.tool_speed is not None:
            slowed = self._slowed
            share = self.job.tool_speed / changed.tool_speed
            estimated[slowed] = np.maximum(after, present * share)[slowed]
        is_modelled = np.isfinite(before) & np.isfinite(after)
        return np.maximum(np.where(is_modelled, estimated, present), 0.0)

    @property
    def is_modelled(self) -> bool:
        """Whether the times of lines and transfers are modelled; paths and seams keep theirs."""
        return not self.job.moves

    @cached_property
    def _slowed(self) -> np.ndarray:
        """Flags of pieces that the limit of tool speed makes longer."""
        slow = {k for k, stage in enumerate(self.schedule.stages) if stage.bottleneck == TOOL_SPEED}
        times = self.times
        assert times is not None
        return np.array(
            [
                piece.stage in slow and piece.kind == "transfer" and piece.length > time
                for piece, time in zip(self.pieces, times, strict=True)
            ]
        )

    def _modelled(self, job: Job) -> FloatArray | None:
        """Compute the modelled time of each piece [s]; NaN where there is no model."""
        straight, settings = BLENDINGS[str(self._setting("blend"))].straight, self.schedule
        job = straight(job)
        model = cell_model(job.cell, str(settings.provenance.settings["redundancy"]))
        stops = self._moved_stops(job)
        if stops is None:
            return None
        problem = stops_problem(model, job, stops)
        effort = EFFORTS[str(self._setting("effort"))]
        problem = replace(problem, settings=effort.sequence)
        times = self._platform_times(model, job)
        for a, work in enumerate(problem.arms):
            kept = self.stops[work.name]
            if not kept:
                continue
            alone = self._arm_times(problem, a, kept)
            if alone is None:
                return None
            times |= alone
        return np.array([times.get(_key(piece), np.nan) for piece in self.pieces])

    def _setting(self, name: str) -> object:
        return self.schedule.provenance.settings[name]

    def _moved_stops(self, job: Job) -> dict[str, list[Stop | None]] | None:
        """Collect each arm's stops of a job at the plan's targets, moved as the job's are."""
        before, after = self._straight.stops_by_key(), self._done(job).stops_by_key()
        rows = max(len(kept) for kept in self.stops.values())
        moved: dict[str, list[Stop | None]] = {}
        for arm, kept in self.stops.items():
            moved[arm] = [None] * rows
            for k, stop in enumerate(kept):
                key = arm, stop.event.task, stop.event.action
                if key not in before or key not in after:
                    return None
                pose, old, new = stop.event.pose, before[key].target, after[key].target
                if isinstance(old, PoseTarget) and isinstance(new, PoseTarget):
                    pose = new.pose * old.pose.inverse() * pose
                moved[arm][k] = replace(after[key], target=PoseTarget(pose, free_yaw=False))
        return moved

    @cached_property
    def _straight(self) -> Job:
        return self._done(BLENDINGS[str(self._setting("blend"))].straight(self.job))

    def _done(self, job: Job) -> Job:
        """Add the tool changes of the plan to a job."""
        return job_as_done(self.schedule, job) if job.cell.tool_changes else job

    def _platform_times(self, model: CellModel, job: Job) -> dict[tuple[object, ...], float]:
        """Compute how long the platform's motions take alone [s], by key of their pieces."""
        schedule, names = self.schedule, self.schedule.robot.platform
        if not names:
            return {}
        law, motion = job.limits.select(names).law, schedule.trajectory
        columns = [motion.joints.index(name) for name in names]
        times: dict[tuple[object, ...], float] = {}
        for k, stage in enumerate(schedule.stages):
            q = motion.clamped(np.array([stage.start, stage.end]))[0][:, columns]
            times[PLATFORM, k] = float(law.duration(q[1] - q[0]))
        return times

    def _arm_times(
        self, problem: SequenceProblem, a: int, kept: list[KeptStop]
    ) -> dict[tuple[object, ...], float] | None:
        """Compute an arm's times of lines, dwells and transfers [s], by key of their pieces."""
        work, n = problem.arms[a], len(kept)
        candidates = self._postures(problem, a, kept)
        if not candidates.possible.all():
            return None
        times: dict[tuple[object, ...], float] = {}
        lines = np.stack([candidates.approach.max(axis=1), candidates.retract.max(axis=1)], axis=1)
        lines *= candidates.shares
        previous = np.arange(-1, n - 1)
        free = problem.free_start
        start = candidates.q_approach[0] if free else work.start
        q_from = np.where(previous[:, None] >= 0, candidates.q_retract[previous], start)
        leaving = q_from[:, None], left_with(candidates, previous)[:, None]
        arriving = candidates.q_approach[:, None], candidates.rates[:, None, 0]
        transfer = transfer_times(work, leaving, arriving)[:, 0, 0]
        for k, stop in enumerate(kept):
            key = work.name, stop.event.task, stop.event.action
            times[(*key, "approach")], times[(*key, "retract")] = lines[k].tolist()
            times[(*key, "transfer")] = float(transfer[k])
            target = work.stops[k]
            assert target is not None
            times[(*key, "dwell")] = target.dwell
        back = work.law.duration(start - candidates.q_retract[-1])
        times[work.name, "", "", "return"] = float(back)
        return times

    def _postures(
        self, problem: SequenceProblem, a: int, kept: list[KeptStop]
    ) -> CandidatePostures:
        """Compute an arm's postures at its stops, line ends passed as in the plan."""
        work, rows = problem.arms[a], np.arange(len(kept))
        decisions = _decisions(work, np.stack([stop.q for stop in kept]), self._shares(work, kept))
        platform = np.stack([stop.platform for stop in kept])
        angle = platform[:, 0] if problem.turns else np.zeros(len(kept))
        candidates = postures(problem, a, rows, angle, decisions)
        launches: IntArray = default_launches(problem)[a][: len(kept)]
        moving = np.array([stop.passes for stop in kept])
        every = launches.max(initial=0)
        return passed(work, np.where(moving, np.maximum(launches, every), 0), candidates)

    def _shares(self, work: ArmWork, kept: list[KeptStop]) -> FloatArray:
        """Compute lengths of lines over those in the plan; the arm angle swings likewise."""
        before, shares = self._straight.stops_by_key(), np.ones((len(kept), 2))
        for k, (stop, target) in enumerate(zip(kept, work.stops, strict=False)):
            old = before[work.name, stop.event.task, stop.event.action]
            assert target is not None  # the first stops are the plan's
            for line, (new, length) in enumerate(
                ((target.approach, old.approach), (target.retract, old.retract))
            ):
                shares[k, line] = new / length if length > 0.0 else 0.0
        return shares


def _decisions(work: ArmWork, q: FloatArray, shares: FloatArray) -> ArmDecisions:
    """Restore the decisions behind joints at line ends and targets.

    Args:
        work: the arm under the changed job.
        q: joints in the plan [rad], shape (n, 3, joints).
        shares: lengths of approach and retract over those in the plan, shape (n, 2).
    """
    rows = ArmDecisions.idle(work.start, len(q))
    targets = given_postures(work, rows, q[:, 1])
    if not work.kinematics.has_arm_angle:
        return targets
    ends = [work.closed_form.arm_angle(q[:, place]) for place in (0, 2)]
    psi = [
        targets.psi_target + share * (turn - TURN * np.round(turn / TURN))
        for turn, share in zip((end - targets.psi_target for end in ends), shares.T, strict=True)
    ]
    branch = work.closed_form.branch(q[:, 1])
    return replace(targets, branch=branch, psi_approach=psi[0], psi_retract=psi[1])


def _key(piece: TimedPiece) -> tuple[object, ...]:
    """Build the key of a piece's time."""
    if piece.group == PLATFORM:
        return PLATFORM, piece.stage
    return piece.group, piece.task, piece.action, piece.kind
