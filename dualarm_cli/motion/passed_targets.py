"""Targets of moves that arms pass in motion, within the tolerance of the file.

The transfers to and from a target meet there in a common state of motion. If the tool may leave the corner (`blend`),
they meet nearer to the straight joint motion between their other ends, with the target's orientation. Several points
and velocities are tried. The method is ours.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.motion.blending import MIN_GAIN, platform_time, waits_for_time
from dualarm_cli.motion.stop_motion import rates_between, transfers_in_motion
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers, within_tool_speed
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

SPEED_FACTORS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)
"""Velocities at a target that are tried, as fractions of mean velocity."""
CUT_FRACTIONS = (0.0, 0.5, 0.99)
"""Distances from a target that are tried, as fractions of the allowed distance."""


@dataclass(frozen=True)
class Passing:
    """State in which groups pass the end of a stage."""

    rates: Mapping[str, FloatArray]
    """Velocities and accelerations by group, shape (2, n)."""
    joints: Mapping[str, FloatArray]
    """Joint values of arms that pass next to their target [rad], shape (n,), by arm."""


def passed_targets(
    drive: Drive, plans: Sequence[StagePlan], stopping: Collection[tuple[int, str]] = ()
) -> dict[int, Passing]:
    """Choose how targets of moves are passed in motion, by stage.

    Stages are treated in order, each as if the following transfer ended at rest. The platform passes only if all arms
    with a target do; otherwise it stops for the others.

    Args:
        drive: of the job.
        plans: stages of the job, with all stops.
        stopping: transfers that stay at rest, by the stage at their end and the arm.
    """
    passings: dict[int, Passing] = {}
    changed = list(plans)
    for k in range(len(plans) - 1):
        corner = _Corner(drive, changed[k - 1] if k else None, changed[k], changed[k + 1])
        plan, after = corner.plan, corner.after
        if plan.waits or plan.detours or after.waits or after.detours or waits_for_time(after):
            continue
        if any(s.tracked is not None for s in (*plan.stops.values(), *after.stops.values())):
            continue
        arms = [
            name
            for name, arm_stop in plan.stops.items()
            # An arm without work in the next stage stops.
            if arm_stop.stop.blend
            and (not after.stops or name in after.stops)
            and not {(k, name), (k + 1, name)} & set(stopping)
        ]
        if not arms:
            continue
        passing: Passing | None = None
        if len(arms) == len(plan.stops) and PLATFORM in drive.columns:
            passing = corner.quickest((PLATFORM, *arms))
        if passing is None:
            single = [p for name in arms if (p := corner.quickest((name,)))]
            rates = {name: rates for p in single for name, rates in p.rates.items()}
            joints = {name: q for p in single for name, q in p.joints.items()}
            passing = Passing(rates, joints) if single else None
        if passing and corner.can_be_timed(passing):
            passings[k] = passing
            changed[k], changed[k + 1] = _passed(drive, plan, after, passing)
    return passings


def with_passed_targets(
    drive: Drive, plans: Sequence[StagePlan], passed: Mapping[int, Passing]
) -> list[StagePlan]:
    """Build stages whose targets are passed as given, by stage."""
    changed = list(plans)
    for k, passing in passed.items():
        changed[k], changed[k + 1] = _passed(drive, changed[k], changed[k + 1], passing)
    return changed


@dataclass(frozen=True)
class _Corner:
    """Stage whose targets may be passed, with its neighbours."""

    drive: Drive
    before: StagePlan | None
    plan: StagePlan
    after: StagePlan

    def quickest(self, groups: Sequence[str]) -> Passing | None:
        """Find the fastest passing of the stage's end; None if a stop is faster.

        Velocities point in the direction in which joints continue. They are fractions and multiples of the lower mean
        velocity, or of the mean velocity over both transfers.
        """
        drive, plan, after = self.drive, self.plan, self.after
        index = [column for group in groups for column in drive.columns[group]]
        both = drive.to(plan).limits.stricter(drive.to(after).limits)
        limits = both.select([name for group in groups for name in drive.joints(group)])
        law = limits.law
        least = [0.0, 0.0]
        if PLATFORM not in groups:
            least = [platform_time(drive, *pair) for pair in ((self.before, plan), (None, after))]
        at_rest = np.zeros((2, len(index)))
        leaving = at_rest if self.before is None else _rates(drive, self.before, groups)

        def transfers(joints: Mapping[str, FloatArray]) -> tuple[FloatArray, list[MovingTransfer]]:
            passed = _moved(drive, plan.arrival, joints)
            ends = np.stack([plan.start[index], passed[index], after.arrival[index]])
            problems = [
                TransferProblem(limits.joints, *pair, limits, minimum)
                for pair, minimum in zip(pairwise(ends), least, strict=True)
            ]
            return np.diff(ends, axis=0), [MovingTransfer(problem) for problem in problems]

        distances, stopping = transfers({})
        if not distances.any(axis=1).all():
            return None
        times = [
            stopping[0].duration(leaving, at_rest),
            max(float(law.duration(distances[1])), least[1]),
        ]
        best, quickest = None, sum(times) - MIN_GAIN
        for cut in CUT_FRACTIONS:
            joints = self._beside(groups, cut, times[0] / sum(times))
            if joints is None:
                continue
            distances, (arriving, departing) = transfers(joints)
            means = distances / np.array(times)[:, None]
            slower = np.sign(means[0]) * np.abs(means).min(axis=0)
            onwards = np.where(means[0] * means[1] > 0.0, slower, 0.0)
            for mean in (onwards, distances.sum(axis=0) / sum(times)):
                for factor in SPEED_FACTORS:
                    velocity = np.clip(factor * mean, -limits.velocity, limits.velocity)
                    rates = np.stack([velocity, np.zeros(len(index))])
                    time = arriving.duration(leaving, rates, quickest)
                    time += departing.duration(rates, at_rest, quickest)
                    if time < quickest:
                        best, quickest = (rates, joints), time
        if best is None:
            return None
        parts = np.cumsum([len(drive.columns[group]) for group in groups])[:-1]
        return Passing(dict(zip(groups, np.split(best[0], parts, axis=1), strict=True)), best[1])

    def can_be_timed(self, passing: Passing) -> bool:
        """Check whether the transfers to and from targets can be timed, within tool speed."""
        drive = self.drive
        plan, after = _passed(drive, self.plan, self.after, passing)
        try:
            rates = rates_between(drive, self.before, plan), rates_between(drive, plan, after)
            here, then = drive.to(plan), drive.to(after)
            return within_tool_speed(
                here, plan, transfers_in_motion(here, plan, rates[0])
            ) and within_tool_speed(then, after, time_transfers(then, after, rates[1]))
        except InfeasibleError:
            return False

    def _beside(
        self, groups: Sequence[str], cut: float, progress: float
    ) -> dict[str, FloatArray] | None:
        """Compute the joint values next to the targets [rad], shape (n,), by arm; or None.

        Args:
            groups: groups that pass; arms with joint targets pass these exactly.
            cut: fraction of the allowed distance from the target, limited to the distance of
                the straight motion in joint space between the other ends.
            progress: fraction of that motion's time at the nearest point.
        """
        joints: dict[str, FloatArray] = {}
        model, plan = self.drive.model, self.plan
        for name in groups if cut else ():
            if name == PLATFORM or not isinstance(plan.stops[name].stop.target, PoseTarget):
                continue
            columns = self.drive.columns[name]
            between = (1.0 - progress) * plan.start[columns] + progress * self.after.arrival[
                columns
            ]
            straight = _moved(self.drive, plan.arrival, {name: between})
            target = model.tool_pose(name, plan.arrival)
            offset = model.tool_position(name, straight) - target.translation
            distance = float(norm(offset))
            if distance == 0.0:
                continue
            shift = offset * min(1.0, cut * plan.stops[name].stop.blend / distance)
            q = self._reached(name, pin.SE3(target.rotation, target.translation + shift))
            if q is None:
                return None
            joints[name] = q
        return joints if joints or not cut else None

    def _reached(self, name: str, tool: pin.SE3) -> FloatArray | None:
        """Solve for the joints (n,) [rad] at a tool pose near the target, or None."""
        arm, posture = self.drive.model.arms[name], self.plan.stops[name].posture
        R, p = self.drive.model.carried_frame(self.plan.arrival)
        flange = pin.SE3(R, p).inverse() * tool * arm.T_flange_tcp.inverse()
        reference = replace(posture.at_target, q=self.plan.arrival[arm.columns])
        return arm.kinematics.neighbour(reference, flange.rotation, flange.translation)


def _rates(drive: Drive, before: StagePlan, groups: Sequence[str]) -> FloatArray:
    """Return the rates with which groups leave a stage, shape (2, n)."""
    at_rest = {group: np.zeros((2, len(drive.columns[group]))) for group in groups}
    return np.concatenate([before.through.get(group, at_rest[group]) for group in groups], axis=1)


def _moved(drive: Drive, position: FloatArray, joints: Mapping[str, FloatArray]) -> FloatArray:
    """Replace the joint values of some groups, shape (n,) [rad]."""
    changed = np.array(position)
    for name, q in joints.items():
        changed[drive.columns[name]] = q
    return changed


def _passed(
    drive: Drive, plan: StagePlan, after: StagePlan, passing: Passing
) -> tuple[StagePlan, StagePlan]:
    """Build a stage whose targets are passed, and the stage after it."""
    stops = dict(plan.stops)
    for name, q in passing.joints.items():
        posture = replace(stops[name].posture, q_approach=q, q_target=q, q_retract=q)
        stops[name] = replace(stops[name], posture=posture)
    arrival, end = (_moved(drive, q, passing.joints) for q in (plan.arrival, plan.end))
    passed = replace(plan, arrival=arrival, end=end, stops=stops, through=passing.rates)
    return passed, replace(after, start=end)
