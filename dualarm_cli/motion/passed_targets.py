"""Targets of moves that arms need not stop at: each is passed in motion, as far beside it as the file allows.

A transfer to a target and the one after it meet there in a common state of motion. Where the tool may leave the corner
(`blend`), they meet in a point nearer to the straight motion in joint space between their other ends; the tool keeps
the orientation that is asked for. Which point and which velocity, is tried. Our own.
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
from dualarm_cli.motion.blending import WORTH, platform_time, waits_for_time
from dualarm_cli.motion.stop_motion import rates_between, transfers_in_motion
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers, tool_speed_of
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

FACTORS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)
"""Shares of mean velocities with which a target may be passed."""
CUTS = (0.0, 0.5, 0.99)
"""Shares of what a tool may leave its target by, at which it passes it."""


@dataclass(frozen=True)
class Passing:
    """How groups pass a stage's end."""

    rates: Mapping[str, FloatArray]
    """Velocities and accelerations, shape (2, n), by group."""
    joints: Mapping[str, FloatArray]
    """Where arms are then, beside their targets [rad], shape (n,), by arm; those that are not in it are at them."""


def passed_targets(
    drive: Drive, plans: Sequence[StagePlan], stopping: Collection[tuple[int, str]] = ()
) -> dict[int, Passing]:
    """Returns how targets of moves are passed in motion, by stage.

    One after the other, each as if the transfer after it led to rest. The platform moves on where all arms that have a
    target there pass it; else it stands for the others.

    Args:
        drive: of the job.
        plans: its stages, with all stops.
        stopping: transfers between stops all the same, by the stage that they lead to and arm.
    """
    found: dict[int, Passing] = {}
    made = list(plans)
    for k in range(len(plans) - 1):
        corner = _Corner(drive, made[k - 1] if k else None, made[k], made[k + 1])
        plan, after = corner.plan, corner.after
        if plan.waits or plan.detours or after.waits or after.detours or waits_for_time(after):
            continue
        if any(one.tracked is not None for one in (*plan.stops.values(), *after.stops.values())):
            continue
        arms = [
            name
            for name, arm_stop in plan.stops.items()
            # An arm that has nothing to do then stands.
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
            own = [one for name in arms if (one := corner.quickest((name,)))]
            rates = {name: rates for one in own for name, rates in one.rates.items()}
            joints = {name: q for one in own for name, q in one.joints.items()}
            passing = Passing(rates, joints) if own else None
        if passing and corner.can_be_timed(passing):
            found[k] = passing
            made[k], made[k + 1] = _passed(drive, plan, after, passing)
    return found


def with_passed_targets(
    drive: Drive, plans: Sequence[StagePlan], passed: Mapping[int, Passing]
) -> list[StagePlan]:
    """Returns stages whose targets are passed in given ways, by stage."""
    found = list(plans)
    for k, passing in passed.items():
        found[k], found[k + 1] = _passed(drive, found[k], found[k + 1], passing)
    return found


@dataclass(frozen=True)
class _Corner:
    """A stage whose targets may be passed."""

    drive: Drive
    before: StagePlan | None
    plan: StagePlan
    after: StagePlan

    def quickest(self, groups: Sequence[str]) -> Passing | None:
        """Returns how groups pass the stage's end together best, None where it is quicker with a stop.

        The velocity is the best one of some in the directions in which joints go on: their lower mean velocity, or that
        of the whole way, slower and faster.
        """
        drive, plan, after = self.drive, self.plan, self.after
        index = [column for group in groups for column in drive.columns[group]]
        limits = drive.limits.select([name for group in groups for name in drive.joints(group)])
        law = limits.law
        least = [0.0, 0.0]
        if PLATFORM not in groups:
            least = [
                platform_time(drive, one, two) for one, two in ((self.before, plan), (None, after))
            ]
        rest = np.zeros((2, len(index)))
        leaving = rest if self.before is None else _rates(drive, self.before, groups)

        def transfers(joints: Mapping[str, FloatArray]) -> tuple[FloatArray, list[MovingTransfer]]:
            there = _moved(drive, plan.arrival, joints)
            ends = np.stack([plan.start[index], there[index], after.arrival[index]])
            problems = [
                TransferProblem(limits.joints, *pair, limits, one)
                for pair, one in zip(pairwise(ends), least, strict=True)
            ]
            return np.diff(ends, axis=0), [MovingTransfer(one) for one in problems]

        ways, stopping = transfers({})
        if not ways.any(axis=1).all():
            return None
        times = [stopping[0].duration(leaving, rest), max(float(law.duration(ways[1])), least[1])]
        best, quickest = None, sum(times) - WORTH
        for cut in CUTS:
            joints = self._beside(groups, cut, times[0] / sum(times))
            if joints is None:
                continue
            ways, (there, away) = transfers(joints)
            means = ways / np.array(times)[:, None]
            slower = np.sign(means[0]) * np.abs(means).min(axis=0)
            onwards = np.where(means[0] * means[1] > 0.0, slower, 0.0)
            for mean in (onwards, ways.sum(axis=0) / sum(times)):
                for factor in FACTORS:
                    velocity = np.clip(factor * mean, -limits.velocity, limits.velocity)
                    rates = np.stack([velocity, np.zeros(len(index))])
                    time = there.duration(leaving, rates, quickest)
                    time += away.duration(rates, rest, quickest)
                    if time < quickest:
                        best, quickest = (rates, joints), time
        if best is None:
            return None
        parts = np.cumsum([len(drive.columns[group]) for group in groups])[:-1]
        return Passing(dict(zip(groups, np.split(best[0], parts, axis=1), strict=True)), best[1])

    def can_be_timed(self, passing: Passing) -> bool:
        """Returns whether the transfers to and from targets can be timed, within the tools' speed."""
        drive = self.drive
        plan, after = _passed(drive, self.plan, self.after, passing)
        try:
            for one, transfers in (
                (plan, transfers_in_motion(drive, plan, rates_between(drive, self.before, plan))),
                (after, time_transfers(drive, after, rates_between(drive, plan, after))),
            ):
                if drive.cap is not None and tool_speed_of(drive, one, transfers) > drive.cap:
                    return False
        except InfeasibleError:
            return False
        return True

    def _beside(
        self, groups: Sequence[str], cut: float, share: float
    ) -> dict[str, FloatArray] | None:
        """Returns where arms pass beside their targets [rad], shape (n,), by arm; None where one of them cannot.

        Args:
            groups: which groups pass; arms whose targets are joints pass these.
            cut: share of what each tool may leave its target by, at which it passes it; at most as far as the tool
                would be on the straight motion in joint space between the other ends.
            share: of the time of that motion at which it is nearest.
        """
        found: dict[str, FloatArray] = {}
        model, plan = self.drive.model, self.plan
        for name in groups if cut else ():
            if name == PLATFORM or not isinstance(plan.stops[name].stop.target, PoseTarget):
                continue
            columns = self.drive.columns[name]
            between = (1.0 - share) * plan.start[columns] + share * self.after.arrival[columns]
            straight = _moved(self.drive, plan.arrival, {name: between})
            target = model.tool_pose(name, plan.arrival)
            way = model.tool_position(name, straight) - target.translation
            far = float(norm(way))
            if far == 0.0:
                continue
            shift = way * min(1.0, cut * plan.stops[name].stop.blend / far)
            q = self._reached(name, pin.SE3(target.rotation, target.translation + shift))
            if q is None:
                return None
            found[name] = q
        return found if found or not cut else None

    def _reached(self, name: str, tool: pin.SE3) -> FloatArray | None:
        """Returns the joints (n,) [rad] that bring a tool to a pose near its target, in the world; None if none do."""
        arm, posture = self.drive.model.arms[name], self.plan.stops[name].posture
        R, p = self.drive.model.carried_frame(self.plan.arrival)
        flange = pin.SE3(R, p).inverse() * tool * arm.T_flange_tcp.inverse()
        near = replace(posture.at_target, q=self.plan.arrival[arm.columns])
        return arm.kinematics.neighbour(near, flange.rotation, flange.translation)


def _rates(drive: Drive, before: StagePlan, groups: Sequence[str]) -> FloatArray:
    """Returns the velocities and accelerations with which groups leave a stage, shape (2, n): passing, or at rest."""
    rest = {group: np.zeros((2, len(drive.columns[group]))) for group in groups}
    return np.concatenate([before.through.get(group, rest[group]) for group in groups], axis=1)


def _moved(drive: Drive, position: FloatArray, joints: Mapping[str, FloatArray]) -> FloatArray:
    """Returns all joints (n,) [rad] with those of some groups replaced."""
    found = np.array(position)
    for name, q in joints.items():
        found[drive.columns[name]] = q
    return found


def _passed(
    drive: Drive, plan: StagePlan, after: StagePlan, passing: Passing
) -> tuple[StagePlan, StagePlan]:
    """Returns a stage whose targets are passed, and the one after it."""
    stops = dict(plan.stops)
    for name, q in passing.joints.items():
        posture = replace(stops[name].posture, q_approach=q, q_target=q, q_retract=q)
        stops[name] = replace(stops[name], posture=posture)
    arrival, end = (_moved(drive, one, passing.joints) for one in (plan.arrival, plan.end))
    passed = replace(plan, arrival=arrival, end=end, stops=stops, through=passing.rates)
    return passed, replace(after, start=end)
