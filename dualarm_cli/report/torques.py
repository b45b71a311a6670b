"""Torques of a plan: joints, stages, energy, and the effect of lower efforts.

The samples are the verifier's, so that both say the same. Slowing a motion by s changes a joint's torque from
rest + motion to rest + motion / s² ([Hollerbach1984]).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointTorques
from dualarm_cli.model.schedule import Schedule, Stage
from dualarm_cli.records import dataclass
from dualarm_cli.report.stage_parts import PLATFORM
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.torque_checks import (
    SAMPLING,
    InverseDynamics,
    TorqueSamples,
    carried,
    measured_torques,
    torque_samples,
    why_unknown,
)


@dataclass(frozen=True)
class TorqueReportSettings:
    """Sensitivity to efforts."""

    share: float = 0.1
    """Relative reduction of the efforts."""
    at_rest: float = 1e-9
    """Speed and acceleration below which the robot is at rest, apart from rounding."""


EFFORTS = TorqueReportSettings()


def has_torques(job: Job) -> bool:
    """Check whether torques of a job's robot can be computed, and are not ignored."""
    return job.cell.torque != "ignored" and not why_unknown(job.cell)


def largest_share(schedule: Schedule, job: Job) -> tuple[float, str]:
    """Find the largest torque as a share of its effort, and its joint.

    Args:
        schedule: a planned schedule.
        job: the planned job, with torques.
    """
    peaks, _ = measured_torques(schedule, job_as_done(schedule, job))
    robot = job.cell.robot
    return max(
        (peak.torque / float(effort), joint)
        for peak, effort, joint in zip(peaks, robot.torques.effort, robot.joints, strict=True)
    )


def torque_members(schedule: Schedule, job: Job) -> tuple[dict[str, Any] | None, list[Any]]:
    """Build the members of the report on torques, JSON-ready.

    Args:
        schedule: a planned schedule.
        job: the planned job.

    Returns:
        Torques of joints and energy, or None without data; the joint of each stage nearest to its effort, or None.
    """
    stages = schedule.stages
    if not has_torques(job):
        return None, [None] * len(stages)
    done, robot = job_as_done(schedule, job), job.cell.robot
    dynamics = InverseDynamics(job.cell)
    samples = list(torque_samples(dynamics, schedule, done))
    if not samples:  # a motion without length
        return None, [None] * len(stages)
    rest, motion = zip(*(_parts(dynamics, part, robot.torques) for part in samples), strict=True)
    whole = _Whole(samples, np.vstack(rest), np.vstack(motion), robot.torques)
    groups = {PLATFORM: robot.platform} | {arm.name: arm.joints for arm in robot.arms}
    columns = {name: robot.columns(joints) for name, joints in groups.items() if joints}
    checks = schedule.verification.checks if schedule.verification is not None else ()
    judged = any(c.name == "torque" and c.verdict != "not checked" for c in checks)
    # Slower arms would meet parts on a belt elsewhere.
    limited = judged and not any(event.moves for event in schedule.events)
    members = {
        "joints": {
            name: whole.joint(k) | {"unit": "N" if name in robot.sliding else "Nm"}
            for k, name in enumerate(robot.joints)
        },
        "energy": {name: whole.energy(part) for name, part in columns.items()},
        "lower_effort": _lower_effort(schedule, whole, robot.joints) if limited else None,
    }
    everything = list(range(len(robot.joints)))
    rows = [
        whole.stage(stage, columns.get(stage.arm, everything), robot.joints) for stage in stages
    ]
    return members, rows


def _parts(
    dynamics: InverseDynamics, samples: TorqueSamples, joint: JointTorques
) -> tuple[FloatArray, FloatArray]:
    """Split torques into those at rest and those of the motion.

    Each has shape (k, n); Coulomb friction is in neither.
    """
    v, still = samples.velocity, np.zeros_like(samples.velocity)
    rest = dynamics.torques(samples.position, still, still, samples.loads)
    rest = rest - joint.coulomb * np.sign(rest)
    sign = np.where(np.abs(v) > SAMPLING.at_rest, np.sign(v), np.sign(samples.torque))
    return rest, samples.torque - joint.coulomb * sign - rest


class _Whole:
    """Samples of a whole motion."""

    def __init__(
        self,
        samples: Sequence[TorqueSamples],
        rest: FloatArray,
        motion: FloatArray,
        limits: JointTorques,
    ) -> None:
        """Join the parts of the motion.

        Args:
            samples: by loads.
            rest: torques at rest [N m or N], shape (k, n).
            motion: torques of the motion, shape (k, n).
            limits: efforts and friction.
        """
        self.time = np.concatenate([part.time for part in samples])
        self.rest, self.motion, self.limits = rest, motion, limits
        self._weight = np.concatenate([part.weight for part in samples])
        self._torque = np.vstack([part.torque for part in samples])
        self._power = self._torque * np.vstack([part.velocity for part in samples])
        self._loads = [carried(part.loads) for part in samples for _ in part.time]
        self._shares = np.abs(self._torque) / limits.effort

    def joint(self, joint: int) -> dict[str, Any]:
        """Describe the torques of a joint."""
        rated = float(self.limits.rated[joint])
        squares = float(product(self._weight, np.square(self._torque[:, joint])))
        factor = 1.0 / float(self.squares(self.limits.effort)[:, joint].max(initial=0.0) or np.inf)
        return self._peak(int(np.argmax(self._shares[:, joint])), joint) | {
            "effort": float(self.limits.effort[joint]),
            "effective": float(np.sqrt(squares / max(self._weight.sum(), 1e-9))),
            "rated": rated if np.isfinite(rated) else None,
            "acceleration_factor": factor if 0.0 < factor < np.inf else None,
        }

    def stage(self, stage: Stage, columns: list[int], joints: Sequence[str]) -> Any:
        """Describe the joint nearest to its effort in a stage.

        None for a stage without time.
        """
        rows = np.flatnonzero((self.time >= stage.start) & (self.time <= stage.end))
        if not len(rows):
            return None
        shares = self._shares[rows][:, columns]
        row, column = np.unravel_index(int(np.argmax(shares)), shares.shape)
        joint = columns[int(column)]
        return {"joint": joints[joint]} | self._peak(int(rows[row]), joint)

    def _peak(self, row: int, joint: int) -> dict[str, Any]:
        """Describe a torque."""
        return {
            "torque": float(abs(self._torque[row, joint])),
            "share": float(self._shares[row, joint]),
            "time": float(self.time[row]),
            "carrying": self._loads[row],
        }

    def energy(self, columns: Sequence[int]) -> dict[str, float]:
        """Integrate the mechanical work of joints over the motion [J]."""
        power = self._power[:, columns]
        work = float(product(self._weight, np.maximum(power, 0.0).sum(axis=1)))
        braking = float(product(self._weight, np.maximum(-power, 0.0).sum(axis=1)))
        return {"work": work, "braking": braking, "net": work - braking}

    def squares(self, effort: FloatArray) -> FloatArray:
        """Compute the square of the least slowing factor at instants, shape (k, n).

        It is infinite where none suffices.

        Args:
            effort: of the joints [N m or N], shape (n,).
        """
        room = effort - self.limits.coulomb - np.sign(self.motion) * self.rest
        size = np.abs(self.motion)
        ratio = np.divide(size, room, out=np.full(size.shape, np.inf), where=room > 0.0)
        return np.where(size > 0.0, ratio, 0.0)


def _lower_effort(
    schedule: Schedule, whole: _Whole, joints: Sequence[str]
) -> Mapping[str, float | str | None]:
    """Estimate the cycle time with lower efforts: the same motion, slowed between rests [s].

    The time is None where a joint could not hold still. New transfers may be faster.
    """
    effort = whole.limits.effort * (1.0 - EFFORTS.share)
    lacking = (np.abs(whole.rest) / (effort - whole.limits.coulomb)).max(axis=0)
    members = {"share": EFFORTS.share, "cycle_time": None, "joint": joints[int(lacking.argmax())]}
    if lacking.max() >= 1.0:
        return members
    trajectory = schedule.trajectory
    still = np.abs(np.hstack([trajectory.velocity, trajectory.acceleration])).max(axis=1)
    rests = trajectory.time[still <= EFFORTS.at_rest]
    edges = np.unique([trajectory.time[0], *rests, trajectory.time[-1]])
    squares = whole.squares(effort)
    span = np.clip(np.searchsorted(edges, whole.time, side="right") - 1, 0, max(len(edges) - 2, 0))
    slowest = np.ones(max(len(edges) - 1, 1))
    np.maximum.at(slowest, span, squares.max(axis=1))
    longer = float((np.diff(edges) * (np.sqrt(slowest[: len(edges) - 1]) - 1.0)).sum())
    return members | {
        "cycle_time": schedule.duration + longer,
        "joint": joints[int(squares.max(axis=0).argmax())],
    }
