"""Export request: schedule, rate, interpolation and groups of joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Literal

from dualarm_cli.errors import UsageError
from dualarm_cli.formats.sampling import NANO, JointLoss, Samples, losses, sampled
from dualarm_cli.geometry.interpolation import Interpolation
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

PlatformController = Literal["own", "both", "left", "right"]
"""Controller of the platform: its own, both arms', or a single arm's."""
Column = Literal["position", "velocity", "acceleration"]
"""Quantity of each joint in a table of samples."""
COLUMNS: tuple[Column, ...] = ("position", "velocity", "acceleration")
MIN_RATE, MAX_RATE = 0.001, 10_000.0
"""Minimum and maximum sampling rate [Hz]."""
BOTH = "both_arms"
"""Name of the group of all arms."""
PLATFORM = "platform"
"""Name of the group of a platform with its own controller."""


@dataclass(frozen=True)
class FileParts:
    """Content of a file in parts, made anew whenever it is read."""

    make: Callable[[], Iterator[bytes]]
    """Function that yields the parts from the start."""

    def __iter__(self) -> Iterator[bytes]:
        """Yield the parts."""
        return self.make()


@dataclass(frozen=True)
class ExportRequest:
    """Schedule and its export options."""

    schedule: Schedule
    """Exported schedule."""
    job: Job | None
    """Cell and tasks of the schedule; None if the format needs neither."""
    rate: float
    """Sampling rate [Hz]."""
    interpolation: Interpolation = "cubic"
    """Interpolation of the receiver between JointTrajectory points."""
    platform: PlatformController = "own"
    """Controller that moves the platform."""
    columns: tuple[Column, ...] = COLUMNS
    """Quantities of each joint in the CSV."""
    uniform: bool = False
    """Flag to place JointTrajectory points at the rate only, not at knots."""

    def samples(self) -> Samples:
        """Sample all joints at the rate."""
        return sampled(self.schedule, self.rate)

    def points(self, joints: Sequence[str]) -> Samples:
        """Sample the JointTrajectory points of the given joints."""
        return sampled(self.schedule, self.rate, joints, knots=not self.uniform)

    def groups(self) -> dict[str, tuple[str, ...]]:
        """List the joints of each controller by the name of its group."""
        robot = self.schedule.robot
        columns: dict[str, tuple[str, ...]] = {}
        if len(robot.arms) > 1:
            columns[BOTH] = tuple(joint for arm in robot.arms.values() for joint in arm.joints)
        columns |= {name: arm.joints for name, arm in robot.arms.items()}
        if robot.platform:
            holder = {"own": PLATFORM, "both": BOTH}.get(self.platform, self.platform)
            if self.platform == "both" and BOTH not in columns:
                holder = next(iter(robot.arms))
            columns[holder] = (*robot.platform, *columns.get(holder, ()))
        return columns


@dataclass(frozen=True)
class ExportLoss:
    """Loss of motion between samples under one interpolation."""

    interpolation: Interpolation
    """Interpolation of the receiver."""
    samples: Mapping[str, int]
    """Number of samples by the controller's group; of all joints together under `all`."""
    joints: Mapping[str, Sequence[JointLoss]]
    """Loss of each joint, by the same names."""

    @classmethod
    def of(cls, motion: str, request: ExportRequest) -> ExportLoss:
        """Measure what a format loses between its samples.

        Args:
            motion: what the format holds of the motion: trajectories, samples or frames.
            request: what is exported.
        """
        # Viewers turn and shift frames linearly between samples.
        kind: Interpolation = "linear" if motion == "frames" else request.interpolation
        samples = {"all": request.samples()}
        if motion == "trajectories":
            samples = {group: request.points(joints) for group, joints in request.groups().items()}
        return cls(
            kind,
            {group: len(rows.nanoseconds) for group, rows in samples.items()},
            {group: losses(request.schedule, rows, kind) for group, rows in samples.items()},
        )

    def worst(self) -> list[JointLoss]:
        """Select for each joint the group in which it exceeds limits, or else deviates most."""
        worst: dict[str, JointLoss] = {}
        for row in (row for rows in self.joints.values() for row in rows):
            first = worst.setdefault(row.joint, row)
            if (not row.within_limits, row.deviation) > (not first.within_limits, first.deviation):
                worst[row.joint] = row
        return list(worst.values())


def check_rate(rate: float, option: str = "rate") -> None:
    """Refuse a sampling rate [Hz] outside the allowed range.

    Raises:
        UsageError: with what is allowed.
    """
    if not MIN_RATE <= rate <= MAX_RATE:
        raise UsageError(
            f"{option} {rate:g}: must be at least {MIN_RATE:g} and at most {MAX_RATE:g} Hz"
        )


def columns_named(names: Sequence[str], option: str = "columns") -> tuple[Column, ...]:
    """Parse the names of columns.

    Args:
        names: requested columns.
        option: name of the option, for messages.

    Raises:
        UsageError: no name is given, or one is unknown or repeated.
    """
    columns: dict[str, Column] = {name: name for name in COLUMNS}
    allowed = f"choose of {', '.join(COLUMNS)}"
    if not names:
        raise UsageError(f"{option}: names no column; {allowed}")
    for k, name in enumerate(names):
        if name not in columns:
            raise UsageError(f"{option}: there is no column {name!r}; {allowed}")
        if name in names[:k]:
            raise UsageError(f"{option}: names {name!r} again; keep one")
    return tuple(columns[name] for name in names)


def stamp(nanoseconds: int) -> dict[str, int]:
    """Convert a time to builtin_interfaces/Time."""
    return {"sec": nanoseconds // NANO, "nanosec": nanoseconds % NANO}
