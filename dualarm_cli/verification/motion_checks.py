"""Checks of the joint motion alone: numbers, agreement, limits, rest."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.joint_motion import ALL, JointMotion
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.criteria import judge, not_checked
from dualarm_cli.verification.tolerances import TOL


def check_finite(motion: JointMotion) -> Check:
    """Checks that every number is finite."""
    names = ("time", "position", "velocity", "acceleration")
    bad = {
        name: sum(int((~np.isfinite(getattr(g, name))).sum()) for g in motion.groups.values())
        for name in names
    }
    count = sum(bad.values())
    where = ", ".join(f"{n} in {name}" for name, n in bad.items() if n)
    return judge("finite", count, 0, f"{where} not finite" if count else "every number")


def check_time(motion: JointMotion) -> Check:
    """Checks that the time of every joint group starts at 0 and never runs backwards."""
    for name, group in motion.groups.items():
        step = np.diff(group.time)
        if (step < 0.0).any():
            # Not by any tolerance: where the robot stands still, nothing else would show it.
            where = f"runs backwards at knot {int(np.argmin(step)) + 1}{_of(name)}"
            return judge("time", -float(step.min()), 0.0, where)
    starts = {name: float(group.time[0]) for name, group in motion.groups.items()}
    worst = max(starts, key=lambda name: abs(starts[name]))
    where = f"starts at {starts[worst]:g} s{_of(worst) if starts[worst] else ''}"
    return judge("time", abs(starts[worst]), TOL.same_time, where)


def _of(group: str) -> str:
    return "" if group == ALL else f" of {group}"


def check_agreement(trajectory: Trajectory, sliding: Collection[str] = ()) -> list[Check]:
    """Checks that position, velocity and acceleration agree for constant jerk between knots.

    Args:
        trajectory: the motion.
        sliding: names of joints that slide.
    """
    by_position, by_velocity = [], []
    # Joint by joint, as all errors of a long motion at once would take as much memory as the motion.
    for joint in trajectory.joints:
        one = trajectory.select([joint])
        q, v, a = one.position, one.velocity, one.acceleration
        dt = np.diff(one.time)[:, None]
        off = q[1:] - (q[:-1] + dt * (v[:-1] + dt * (2.0 * a[:-1] + a[1:]) / 6.0))
        by_position.append(_worst_knot(_with_drift(off, one.time, TOL.position_agreement)))
        off = v[1:] - (v[:-1] + dt * (a[:-1] + a[1:]) / 2.0)
        by_velocity.append(_worst_knot(_with_drift(off, one.time, TOL.velocity_agreement)))
    return [
        _judge_knots(name, worst, allowed, trajectory, sliding)
        for name, worst, allowed in (
            ("position_agreement", by_position, TOL.position_agreement),
            ("velocity_agreement", by_velocity, TOL.velocity_agreement),
        )
    ]


def _worst_knot(error: FloatArray) -> tuple[float, int]:
    """Returns the largest error of a joint, shape (k-1, 1), and the knot that it is at; a NaN is the largest."""
    if error.size == 0:
        return 0.0, 0
    knot = int(np.argmax(error))
    return float(error[knot, 0]), knot + 1


def _with_drift(error: FloatArray, time: FloatArray, allowed: float) -> FloatArray:
    """Returns the size of each knot's error or, where all are allowed, of all errors up to it since a while ago.

    Any number of knots may stand within an instant: each by itself agrees, together they would move a joint. Over a
    long time rounding of times adds up as well, the more the later it is: the sums begin anew every DRIFT_TIME.

    Args:
        error: of the knots but the first, shape (k-1, 1).
        time: of the knots [s], shape (k,).
        allowed: largest error of one knot.
    """
    size = np.abs(error)
    if size.max(initial=0.0) > allowed:
        return size
    total = np.concatenate([np.zeros((1, 1)), np.cumsum(error, axis=0)])
    begun = time[0] + TOL.drift_time * np.floor((time[1:] - time[0]) / TOL.drift_time)
    first = np.minimum(np.searchsorted(time, begun), np.arange(len(error)))
    return np.abs(total[1:] - total[first])


def check_limits(
    trajectory: Trajectory, limits: JointLimits, sliding: Collection[str] = ()
) -> list[Check]:
    """Checks position, velocity, acceleration and jerk of the whole motion, not of knots alone.

    Position is a cubic and velocity a parabola between knots: their extrema are found in closed form.

    Args:
        trajectory: the motion.
        limits: of its joints, in its order; infinite where none is stated.
        sliding: names of joints that slide.
    """
    rows = []
    for joint in trajectory.joints:
        one, own = trajectory.select([joint]), limits.select([joint])
        largest = np.abs(one.acceleration).max(axis=0)
        rows.append((*position_extrema(one), velocity_extrema(one), largest, jerk_share(one, own)))
    low, high, speed, strength, excess = np.array(rows)[:, :, 0].T
    beyond = np.maximum(limits.lower - low, high - limits.upper)
    nearest = np.minimum(np.abs(limits.lower), np.abs(limits.upper))
    return [
        _judge_positions(beyond, nearest, limits, sliding),
        _judge_share("velocity", speed / limits.velocity, limits.velocity, limits),
        _judge_share("acceleration", strength / limits.acceleration, limits.acceleration, limits),
        _judge_share("jerk", excess, limits.jerk, limits),
    ]


def jerk_share(trajectory: Trajectory, limits: JointLimits) -> FloatArray:
    """Returns the largest share of its jerk limit that each joint uses, shape (n,); 0 without one.

    Knots may be a nanosecond apart, where a quotient of differences means nothing: the change of acceleration is
    measured against jerk times time and a millionth of the acceleration limit. What it exceeds jerk times time by
    is also summed up over every run of knots, so that many small excesses are one large one.

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
    share = (change / allowed).max(axis=0)
    total = np.cumsum(change - (allowed - slack), axis=0)
    total = np.vstack([np.zeros((1, total.shape[1])), total])
    run = (total - np.minimum.accumulate(total, axis=0)).max(axis=0)
    share = np.where(share > 1.0, share, np.maximum(share, run / (TOL.run_slack * slack)))
    return np.where(limited, share, 0.0)


def check_rest(trajectory: Trajectory, sliding: Collection[str] = ()) -> Check:
    """Checks that the motion starts and ends at rest; some joints may slide."""
    ends = [0, -1]
    rates = np.abs(np.stack([trajectory.velocity[ends], trajectory.acceleration[ends]]))
    _, end, joint = np.unravel_index(int(np.argmax(rates)), rates.shape)
    name = trajectory.joints[joint]
    where = f"{name} at the {('start', 'end')[end]}"
    return judge("rest", float(rates.max()), TOL.at_rest, where, slides=name in sliding)


def position_extrema(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Returns each joint's lowest and highest position over the whole motion [rad], each (n,)."""
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
    """Returns each joint's largest speed over the whole motion [rad/s], shape (n,)."""
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
    """Judges the largest error of each joint and the knot that it is at."""
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
    name = _named(joint, limits)
    beyond = max(0.0, float(excess[joint]))
    return judge("position", beyond, TOL.position_slack, name, slides=name in sliding)


def _judge_share(name: str, share: FloatArray, stated: FloatArray, limits: JointLimits) -> Check:
    """Judges the largest share of a limit that is used; unlimited joints use none."""
    if not np.isfinite(stated).any():
        return not_checked(name)
    joint = int(np.argmax(share))
    where = f"{_named(joint, limits)}, limit {stated[joint]:g}"
    unlimited = [limits.joints[k] for k in np.flatnonzero(~np.isfinite(stated))]
    if unlimited:
        where += f"; without such a limit: {', '.join(unlimited)}"
    return judge(name, float(share[joint]), 1.0 + TOL.rate_slack, where)


def _named(joint: int, limits: JointLimits) -> str:
    return limits.joints[joint]
