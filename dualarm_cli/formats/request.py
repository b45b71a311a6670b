"""What is asked of an export."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from dualarm_cli.errors import UsageError
from dualarm_cli.formats.sampling import NANO, Samples, sampled
from dualarm_cli.geometry.interpolation import Interpolation
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

PlatformController = Literal["own", "both", "left", "right"]
"""Which controller moves the platform: one of its own, that of both arms, or that of one arm."""
PLATFORM_CONTROLLERS: tuple[PlatformController, ...] = ("own", "both", "left", "right")
Column = Literal["position", "velocity", "acceleration"]
"""What a table of samples tells of each joint."""
COLUMNS: tuple[Column, ...] = ("position", "velocity", "acceleration")
LEAST_RATE, MAX_RATE = 0.001, 10_000.0
"""Sampling rates that are allowed [Hz]."""
MOST_SAMPLES = 250_000
"""Most samples of an export: a gigabyte of memory for fifteen joints."""
BOTH = "both_arms"
"""Name of the group of all arms."""
PLATFORM = "platform"
"""Name of the group of a platform with a controller of its own."""


@dataclass(frozen=True)
class ExportRequest:
    """A schedule and how it is exported."""

    schedule: Schedule
    """What is exported."""
    job: Job | None
    """Cell and tasks of the schedule; None where the format needs neither."""
    rate: float
    """Samples per second [1/s]."""
    interpolation: Interpolation = "cubic"
    """What the receiver makes of the samples of a JointTrajectory."""
    platform: PlatformController = "own"
    """Whose controller moves the platform."""
    columns: tuple[Column, ...] = COLUMNS
    """What the CSV tells of each joint."""
    uniform: bool = False
    """Whether a JointTrajectory has points at the rate only, and none at the schedule's knots."""

    def samples(self) -> Samples:
        """Returns samples of all joints at the rate."""
        return sampled(self.schedule, self.rate)

    def points(self, joints: Sequence[str]) -> Samples:
        """Returns the points of the JointTrajectory of some joints."""
        return sampled(self.schedule, self.rate, joints, knots=not self.uniform)

    def groups(self) -> dict[str, tuple[str, ...]]:
        """List the joints of each controller by the name of its group.

        Raises:
            UsageError: the schedule does not say which joints an arm has.
        """
        robot = self.schedule.robot
        for name, arm in robot.arms.items():
            if not arm.joints:
                raise UsageError(
                    f"robot.arms.{name}.joints: is missing in the schedule; a controller's joints are exported"
                )
        found: dict[str, tuple[str, ...]] = {}
        if len(robot.arms) > 1:
            found[BOTH] = tuple(joint for arm in robot.arms.values() for joint in arm.joints)
        found |= {name: arm.joints for name, arm in robot.arms.items()}
        if robot.platform:
            holder = {"own": PLATFORM, "both": BOTH}.get(self.platform, self.platform)
            if self.platform == "both" and BOTH not in found:
                holder = next(iter(robot.arms))
            found[holder] = (*robot.platform, *found.get(holder, ()))
        return found


def check_rate(rate: float, option: str = "rate") -> None:
    """Refuse a sampling rate [Hz] at which samples would mean nothing.

    Raises:
        UsageError: with what is allowed.
    """
    if not LEAST_RATE <= rate <= MAX_RATE:
        raise UsageError(
            f"{option} {rate:g}: must be at least {LEAST_RATE:g} and at most {MAX_RATE:g} Hz"
        )


def columns_named(names: Sequence[str], option: str = "columns") -> tuple[Column, ...]:
    """Returns columns by their names.

    Args:
        names: as somebody gave them.
        option: where.

    Raises:
        UsageError: there is none, one that there is not, or one that was named before.
    """
    known: dict[str, Column] = {name: name for name in COLUMNS}
    allowed = f"choose of {', '.join(COLUMNS)}"
    if not names:
        raise UsageError(f"{option}: names no column; {allowed}")
    for k, name in enumerate(names):
        if name not in known:
            raise UsageError(f"{option}: there is no column {name!r}; {allowed}")
        if name in names[:k]:
            raise UsageError(f"{option}: names {name!r} again; keep one")
    return tuple(known[name] for name in names)


def stamp(nanoseconds: int) -> dict[str, int]:
    """Returns a time as builtin_interfaces has it."""
    return {"sec": nanoseconds // NANO, "nanosec": nanoseconds % NANO}
