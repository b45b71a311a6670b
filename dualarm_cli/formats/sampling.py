"""Samples of a schedule, and the loss of a receiver's interpolation between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.interpolation import Interpolation, extrema, interpolated
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

NANO = 1_000_000_000
"""Nanoseconds per second."""
BLOCK = 2_000
"""Number of polynomial pieces compared at once."""
NEAREST = 5_000
"""Minimum distance of a sample from a knot [ns]; a nearer sample is dropped."""
SLACK = 1e-4
"""Rounding tolerance: fraction of a limit, and position beyond one [rad].

Steps may be as short as microseconds.
"""


@dataclass(frozen=True)
class Samples:
    """Motion of a schedule at instants of whole nanoseconds."""

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    nanoseconds: np.ndarray
    """Instants since the start [ns], rising, int64, shape (m,)."""
    position: FloatArray
    """Joint positions [rad], shape (m, n)."""
    velocity: FloatArray
    """Joint velocities [rad/s], shape (m, n)."""
    acceleration: FloatArray
    """Joint accelerations [rad/s²], shape (m, n)."""

    @property
    def time(self) -> FloatArray:
        """Instants [s], shape (m,)."""
        return self.nanoseconds / NANO


def sampled(
    schedule: Schedule, rate: float, joints: Sequence[str] = (), *, knots: bool = False
) -> Samples:
    """Sample a schedule at a rate from the start, and at the end.

    The last step is between half a step and one and a half long: a shorter step would amplify rounding in derivatives.

    Args:
        schedule: what is sampled.
        rate: samples per second [1/s].
        joints: names; empty for all joints.
        knots: whether there are samples at the joints' knots as well, with which cubic interpolation is exact.
    """
    count = max(1, round(schedule.duration * rate))
    # Rounded up, so that the motion has ended at the last sample.
    end = max(1, int(np.ceil(schedule.duration * NANO - 1e-3)))
    trajectory = schedule.trajectory.select(joints or schedule.robot.limits.joints)
    instants = np.rint(np.arange(count) * (NANO / rate)).astype(np.int64)
    if knots:
        exact = distinct(np.rint(trajectory.time * NANO).astype(np.int64))
        exact = _spaced(exact[exact < end - NEAREST])
        after = np.searchsorted(exact, instants)
        near = np.minimum(
            np.abs(exact[np.minimum(after, len(exact) - 1)] - instants),
            np.abs(instants - exact[np.maximum(after - 1, 0)]),
        )
        instants = np.union1d(instants[near > NEAREST], exact)
    instants = np.append(instants[instants < end], end)
    return Samples(trajectory.joints, instants, *trajectory.clamped(instants / NANO))


def _spaced(instants: np.ndarray) -> np.ndarray:
    """Drop instants that follow a selected one too closely [ns]."""
    selected = [0]
    for instant in instants.tolist():
        if instant - selected[-1] > NEAREST:
            selected.append(instant)
    return np.array(selected, dtype=np.int64)


@dataclass(frozen=True)
class JointLoss:
    """Deviation of one joint between its samples under a receiver's interpolation."""

    joint: str
    """Name of the joint."""
    deviation: float
    """Largest distance from the schedule [rad]; m for a sliding joint."""
    time: float
    """Start of the piece of motion with the largest distance [s]."""
    velocity: float | None
    """Largest used fraction of the velocity limit; None without a limit."""
    acceleration: float | None
    """Largest used fraction of the acceleration limit; None without a limit.

    None also for linear interpolation, whose velocity jumps.
    """
    jerk: float | None
    """Largest used fraction of the jerk limit; None without a limit.

    None also for cubic interpolation, whose acceleration jumps.
    """
    beyond: float
    """Distance of the position beyond its limits [rad]."""

    @property
    def within_limits(self) -> bool:
        """Flag of a joint within all its limits."""
        shares = (self.velocity, self.acceleration, self.jerk)
        within = all(share is None or share <= 1.0 + SLACK for share in shares)
        return within and self.beyond <= SLACK


def losses(schedule: Schedule, samples: Samples, kind: Interpolation) -> list[JointLoss]:
    """Compute the loss of every joint between samples.

    Both motions are polynomials between the schedule's knots and the samples: the largest deviation of every piece is
    computed exactly.

    Args:
        schedule: the motion without loss, with the limits of its joints.
        samples: of it.
        kind: the receiver's interpolation.
    """
    time = samples.time
    motion = interpolated(kind, time, samples.position, samples.velocity, samples.acceleration)
    trajectory = schedule.trajectory.select(samples.joints)
    size = max(motion.coefficients.shape[1], 4)
    factorials = np.cumprod([1.0, *range(1, size)])[:, None]
    worst, where = np.zeros(len(samples.joints)), np.zeros(len(samples.joints))
    for start, length, exact in _exact_pieces(trajectory, time):
        difference = np.zeros((len(start), size, len(samples.joints)))
        difference[:, : motion.coefficients.shape[1]] = motion.derivatives(start)
        difference /= factorials
        difference[:, :4] -= exact
        low, high = extrema(difference, length)
        deviation = np.maximum(-low, high)
        k = np.argmax(deviation, axis=0)
        peak = np.take_along_axis(deviation, k[None], axis=0)[0]
        worst, where = np.maximum(worst, peak), np.where(peak > worst, start[k], where)
    limits = schedule.robot.limits.select(samples.joints)
    low, high = motion.extrema()
    beyond = np.maximum(np.maximum(limits.lower - low, high - limits.upper), 0.0)
    shares = [
        _shares(motion.peak(order), limit)
        for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1)
    ]
    rows = zip(samples.joints, worst, where, *shares, beyond, strict=True)
    return [JointLoss(j, float(d), float(t), v, a, k, float(b)) for j, d, t, v, a, k, b in rows]


def _exact_pieces(
    trajectory: Trajectory, time: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Yield the schedule's pieces between knots and samples.

    Starts (m,), lengths (m,) and polynomials (m, 4, n).
    """
    edges = np.union1d(trajectory.time, time)
    edges = edges[(edges >= time[0]) & (edges <= time[-1])]
    for k in range(0, len(edges) - 1, BLOCK):
        block = edges[k : k + BLOCK + 1]
        start, length = block[:-1], np.diff(block)
        # Taken inside the piece, because its end belongs to the next piece.
        q, v, a = trajectory.clamped(start)
        later = trajectory.clamped(start + 0.5 * length)[2]
        jerk = (later - a) / (0.5 * length)[:, None]
        yield start, length, np.stack([q, v, a / 2.0, jerk / 6.0], axis=1)


def _shares(peak: FloatArray | None, limit: FloatArray) -> list[float | None]:
    """Compute the used fractions of limits; None without a limit or a peak."""
    if peak is None:
        return [None] * len(limit)
    pairs = zip(peak.tolist(), limit.tolist(), strict=True)
    return [value / bound if np.isfinite(bound) else None for value, bound in pairs]
