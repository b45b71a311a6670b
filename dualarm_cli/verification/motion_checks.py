"""Checks of the joint motion alone: numbers, agreement, limits, rest."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.joint_motion import ALL, JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.measuring.criteria import judge, not_checked
from dualarm_cli.verification.measuring.tolerances import TOL


def check_finite(motion: JointMotion) -> Check:
    """Check that every number is finite."""
    names = ("time", "position", "velocity", "acceleration")
    bad = {
        name: sum(int((~np.isfinite(getattr(g, name))).sum()) for g in motion.groups.values())
        for name in names
    }
    count = sum(bad.values())
    where = ", ".join(f"{n} in {name}" for name, n in bad.items() if n)
    return judge("finite", count, 0, f"{where} not finite" if count else "every number")


def check_time(motion: JointMotion) -> Check:
    """Check that each joint group's time starts at 0 and never runs backwards."""
    for name, group in motion.groups.items():
        step = np.diff(group.time)
        if (step < 0.0).any():
            # Without a tolerance: while the robot stands still, no other check would show it.
            where = f"runs backwards at knot {int(np.argmin(step)) + 1}{_suffix(name)}"
            return judge("time", -float(step.min()), 0.0, where)
    starts = {name: float(group.time[0]) for name, group in motion.groups.items()}
    worst = max(starts, key=lambda name: abs(starts[name]))
    where = f"starts at {starts[worst]:g} s{_suffix(worst) if starts[worst] else ''}"
    return judge("time", abs(starts[worst]), TOL.same_time, where)


def _suffix(group: str) -> str:
    return "" if group == ALL else f" of {group}"


def check_agreement(trajectory: Trajectory, sliding: Collection[str] = ()) -> list[Check]:
    """Check that positions, velocities and accelerations agree for constant jerk.

    Args:
        trajectory: the motion.
        sliding: names of sliding joints.
    """
    by_position, by_velocity = [], []
    # Joint by joint, because the errors of all joints would take as much memory as the motion.
    for joint in trajectory.joints:
        motion = trajectory.select([joint])
        q, v, a = motion.position, motion.velocity, motion.acceleration
        dt = np.diff(motion.time)[:, None]
        error = q[1:] - (q[:-1] + dt * (v[:-1] + dt * (2.0 * a[:-1] + a[1:]) / 6.0))
        by_position.append(_worst_knot(_with_drift(error, motion.time, TOL.position_agreement)))
        error = v[1:] - (v[:-1] + dt * (a[:-1] + a[1:]) / 2.0)
        by_velocity.append(_worst_knot(_with_drift(error, motion.time, TOL.velocity_agreement)))
    return [
        _judge_knots(name, worst, allowed, trajectory, sliding)
        for name, worst, allowed in (
            ("position_agreement", by_position, TOL.position_agreement),
            ("velocity_agreement", by_velocity, TOL.velocity_agreement),
        )
    ]


def _worst_knot(error: FloatArray) -> tuple[float, int]:
    """Find the largest error of a joint, shape (k-1, 1), and its knot.

    A NaN is largest.
    """
    if error.size == 0:
        return 0.0, 0
    knot = int(np.argmax(error))
    return float(error[knot, 0]), knot + 1


def _with_drift(error: FloatArray, time: FloatArray, allowed: float) -> FloatArray:
    """Compute the size of each knot's error, or of sums of errors if all are allowed.

    Many knots within an instant may each agree and still move a joint together, so that errors are summed. Over a long
    time rounding of times adds up as well: the sums restart every `drift_time`.

    Args:
        error: of the knots but the first, shape (k-1, 1).
        time: of the knots [s], shape (k,).
        allowed: largest error of one knot.
    """
    size = np.abs(error)
    if size.max(initial=0.0) > allowed:
        return size
    total = np.concatenate([np.zeros((1, 1)), np.cumsum(error, axis=0)])
    interval_start = time[0] + TOL.drift_time * np.floor((time[1:] - time[0]) / TOL.drift_time)
    first = np.minimum(np.searchsorted(time, interval_start), np.arange(len(error)))
    return np.abs(total[1:] - total[first])


def check_limits(
    trajectory: Trajectory, limits: JointLimits, sliding: Collection[str] = ()
) -> list[Check]:
    """Check position, velocity, acceleration and jerk limits over the whole motion.

    Position is a cubic and velocity a parabola between knots: their extrema have closed forms.

    Args:
        trajectory: the motion.
        limits: of its joints, in its order; infinite if none is stated.
        sliding: names of sliding joints.
    """
    rows = []
    for joint in trajectory.joints:
        motion, limits_of_joint = trajectory.select([joint]), limits.select([joint])
        largest = np.abs(motion.acceleration).max(axis=0)
        rows.append(
            (
                *position_extrema(motion),
                velocity_extrema(motion),
                largest,
                jerk_fraction(motion, limits_of_joint),
            )
        )
    low, high, speed, acceleration, excess = np.array(rows)[:, :, 0].T
    beyond = np.maximum(limits.lower - low, high - limits.upper)
    nearest = np.minimum(np.abs(limits.lower), np.abs(limits.upper))
    return [
        _judge_positions(beyond, nearest, limits, sliding),
        _judge_fraction("velocity", speed / limits.velocity, limits.velocity, limits),
        _judge_fraction(
            "acceleration", acceleration / limits.acceleration, limits.acceleration, limits
        ),
        _judge_fraction("jerk", excess, limits.jerk, limits),
    ]


def jerk_fraction(trajectory: Trajectory, limits: JointLimits) -> FloatArray:
    """Compute each joint's largest jerk as a fraction of its limit, shape (n,), 0 without one.

    Knots may be a nanosecond apart, where a quotient of differences means nothing: the change of acceleration is
    compared with jerk times time plus a millionth of the acceleration limit. Its excess over jerk times time is also
    summed over every run of knots, so that many small excesses count as one large one.

    Args:
        trajectory: the motion.
        limits: of its joints, in its order.
    """
    step = np.diff(trajectory.time)[:, None]
    if not len(step):
        return np.zeros(len(limits.joints))
    slack = TOL.jump_slack * np.where(np.isfinite(limits.acceleration), limits.acceleration, 1.0)
    limited = np.isfinite(limits.jerk)
    allowed = np.where(limited, limits.jerk, 0.0) * step + slack
    change = np.abs(np.diff(trajectory.acceleration, axis=0))
    fraction = (change / allowed).max(axis=0)
    total = np.cumsum(change - (allowed - slack), axis=0)
    total = np.vstack([np.zeros((1, total.shape[1])), total])
    run = (total - np.minimum.accumulate(total, axis=0)).max(axis=0)
    fraction = np.where(
        fraction > 1.0, fraction, np.maximum(fraction, run / (TOL.run_slack * slack))
    )
    return np.where(limited, fraction, 0.0)


def check_rest(trajectory: Trajectory, sliding: Collection[str] = ()) -> Check:
    """Check that the motion starts and ends at rest."""
    ends = [0, -1]
    rates = np.abs(np.stack([trajectory.velocity[ends], trajectory.acceleration[ends]]))
    _, end, joint = np.unravel_index(int(np.argmax(rates)), rates.shape)
    name = trajectory.joints[joint]
    where = f"{name} at the {('start', 'end')[end]}"
    return judge("rest", float(rates.max()), TOL.at_rest, where, slides=name in sliding)


def position_extrema(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Compute each joint's lowest and highest position [rad], each (n,)."""
    low, high = trajectory.position.min(axis=0), trajectory.position.max(axis=0)
    dt = np.diff(trajectory.time)[:, None]
    q, v, a = trajectory.position[:-1], trajectory.velocity[:-1], trajectory.acceleration[:-1]
    j = trajectory.jerk
    # v + a t + j t²/2 = 0, in the form that divides by neither a small j nor a small difference.
    root = np.sqrt(np.maximum(a * a - 2.0 * j * v, 0.0))
    large = -(a + np.where(a < 0, -root, root))
    for numerator, denominator in ((large, j), (2.0 * v, large)):
        t = np.divide(numerator, denominator, out=np.zeros_like(v), where=denominator != 0)
        t = np.where((t > 0) & (t < dt), t, 0.0)
        at = q + t * (v + t * (a / 2.0 + t * j / 6.0))
        if len(at):
            low, high = np.minimum(low, at.min(axis=0)), np.maximum(high, at.max(axis=0))
    return low, high


def velocity_extrema(trajectory: Trajectory) -> FloatArray:
    """Compute each joint's largest speed [rad/s], shape (n,)."""
    fastest: FloatArray = np.abs(trajectory.velocity).max(axis=0)
    a, j = trajectory.acceleration[:-1], trajectory.jerk
    turns = a * trajectory.acceleration[1:] < 0
    inside = trajectory.velocity[:-1] - np.divide(
        a * a, 2.0 * j, out=np.zeros_like(a), where=turns & (j != 0)
    )
    if len(inside):
        fastest = np.maximum(fastest, np.abs(np.where(turns, inside, 0.0)).max(axis=0))
    return fastest


def _judge_knots(
    name: str,
    worst: Sequence[tuple[float, int]],
    allowed: float,
    trajectory: Trajectory,
    sliding: Collection[str],
) -> Check:
    """Judge the largest errors of joints, each with its knot."""
    column = int(np.argmax([error for error, _ in worst]))
    (error, knot), joint = worst[column], trajectory.joints[column]
    where = f"{joint} at {trajectory.time[knot]:.6f} s" if knot else "one knot"
    return judge(name, error, allowed, where, slides=joint in sliding)


def _judge_positions(
    excess: FloatArray, stated: FloatArray, limits: JointLimits, sliding: Collection[str]
) -> Check:
    if not np.isfinite(stated).any():
        return not_checked("position")
    joint = int(np.argmax(excess))
    name = _name(joint, limits)
    beyond = max(0.0, float(excess[joint]))
    return judge("position", beyond, TOL.position_slack, name, slides=name in sliding)


def _judge_fraction(
    name: str, fraction: FloatArray, stated: FloatArray, limits: JointLimits
) -> Check:
    """Judge the largest fraction of a limit; unlimited joints count as 0."""
    if not np.isfinite(stated).any():
        return not_checked(name)
    joint = int(np.argmax(fraction))
    where = f"{_name(joint, limits)}, limit {stated[joint]:g}"
    unlimited = [limits.joints[k] for k in np.flatnonzero(~np.isfinite(stated))]
    if unlimited:
        where += f"; without such a limit: {', '.join(unlimited)}"
    return judge(name, float(fraction[joint]), 1.0 + TOL.rate_slack, where)


def _name(joint: int, limits: JointLimits) -> str:
    return limits.joints[joint]
