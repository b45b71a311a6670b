"""Checks of the joint motion alone: numbers, agreement, limits, rest."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol

NO_TASKS = "no task file was given (--tasks)"
"""Why something of a job is not checked."""


def check_finite(trajectory: Trajectory) -> Check:
    """Checks that every number is finite."""
    arrays = {
        "time": trajectory.time,
        "position": trajectory.position,
        "velocity": trajectory.velocity,
        "acceleration": trajectory.acceleration,
    }
    bad = {name: int((~np.isfinite(values)).sum()) for name, values in arrays.items()}
    count = sum(bad.values())
    where = ", ".join(f"{n} in {name}" for name, n in bad.items() if n)
    return judge("finite", count, 0, "", f"{where} not finite" if count else "every number")


def check_time(trajectory: Trajectory) -> Check:
    """Checks that time starts at 0 and never runs backwards."""
    time = trajectory.time
    step = np.diff(time)
    backwards = float(max(0.0, -step.min())) if step.size else 0.0
    if backwards > 0:
        # Not by any tolerance: where the robot stands still, nothing else would show it.
        where = f"runs backwards at knot {int(np.argmin(step)) + 1}"
        return judge("time", backwards, 0.0, "s", where)
    return judge("time", abs(float(time[0])), tol.SAME_TIME, "s", f"starts at {time[0]:g} s")


def check_agreement(trajectory: Trajectory, sliding: Collection[str] = ()) -> list[Check]:
    """Checks that position, velocity and acceleration agree for constant jerk between knots.

    Args:
        trajectory: the motion.
        sliding: names of joints that slide.
    """
    q, v, a = trajectory.position, trajectory.velocity, trajectory.acceleration
    dt = np.diff(trajectory.time)[:, None]
    by_velocity = v[:-1] + dt * (a[:-1] + a[1:]) / 2.0
    by_position = q[:-1] + dt * (v[:-1] + dt * (2.0 * a[:-1] + a[1:]) / 6.0)
    return [
        _judge_knots(
            "position_agreement",
            _with_drift(q[1:] - by_position, tol.POSITION_AGREEMENT),
            tol.POSITION_AGREEMENT,
            "rad",
            trajectory,
            sliding,
        ),
        _judge_knots(
            "velocity_agreement",
            _with_drift(v[1:] - by_velocity, tol.VELOCITY_AGREEMENT),
            tol.VELOCITY_AGREEMENT,
            "rad/s",
            trajectory,
            sliding,
        ),
    ]


def _with_drift(error: FloatArray, allowed: float) -> FloatArray:
    """Returns the size of each knot's error or, where all are allowed, of all errors up to it.

    Any number of knots may stand within an instant: each by itself agrees, together they would move a joint.
    """
    size = np.abs(error)
    return size if size.max(initial=0.0) > allowed else np.abs(np.cumsum(error, axis=0))


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
    low, high = position_extrema(trajectory)
    beyond = np.maximum(limits.lower - low, high - limits.upper)
    nearest = np.minimum(np.abs(limits.lower), np.abs(limits.upper))
    speed = velocity_extrema(trajectory)
    strength = np.abs(trajectory.acceleration).max(axis=0)
    excess = jerk_share(trajectory, limits)
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
    slack = tol.JUMP_SLACK * np.where(np.isfinite(limits.acceleration), limits.acceleration, 1.0)
    limited = np.isfinite(limits.jerk)
    allowed = np.where(limited, limits.jerk, 0.0) * step + slack
    change = np.abs(np.diff(trajectory.acceleration, axis=0))
    share = (change / allowed).max(axis=0)
    total = np.cumsum(change - (allowed - slack), axis=0)
    total = np.vstack([np.zeros((1, total.shape[1])), total])
    run = (total - np.minimum.accumulate(total, axis=0)).max(axis=0)
    share = np.where(share > 1.0, share, np.maximum(share, run / (tol.RUN_SLACK * slack)))
    return np.where(limited, share, 0.0)


def check_rest(trajectory: Trajectory, sliding: Collection[str] = ()) -> Check:
    """Checks that the motion starts and ends at rest; some joints may slide."""
    ends = [0, -1]
    rates = np.abs(np.stack([trajectory.velocity[ends], trajectory.acceleration[ends]]))
    _, end, joint = np.unravel_index(int(np.argmax(rates)), rates.shape)
    name = trajectory.joints[joint]
    unit = unit_of(name, "rad/s, rad/s²", sliding)
    where = f"{name} at the {('start', 'end')[end]}"
    return judge("rest", float(rates.max()), tol.AT_REST, unit, where)


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


def unit_of(joint: str, unit: str, sliding: Collection[str]) -> str:
    """Returns the unit of a joint's position or rates: rad is m for one that slides."""
    return unit.replace("rad", "m") if joint in sliding else unit


def judge(name: str, measured: float, allowed: float, unit: str, where: str) -> Check:
    """Returns a check that passes if `measured` is at most `allowed`; a NaN fails."""
    passed = bool(measured <= allowed)
    value = float(measured) if np.isfinite(measured) else None
    return Check(name, "passed" if passed else "failed", value, float(allowed), unit, where)


def not_checked(name: str, why: str) -> Check:
    """Returns a check that was not made, with the reason."""
    return Check(name, "not checked", None, None, "", why)


def _judge_knots(
    name: str,
    error: FloatArray,
    allowed: float,
    unit: str,
    trajectory: Trajectory,
    sliding: Collection[str],
) -> Check:
    if error.size == 0:
        return judge(name, 0.0, allowed, unit, "one knot")
    knot, joint = np.unravel_index(int(np.argmax(error)), error.shape)
    unit = unit_of(trajectory.joints[joint], unit, sliding)
    where = f"{trajectory.joints[joint]} at {trajectory.time[knot + 1]:.6f} s"
    return judge(name, float(error.max()), allowed, unit, where)


def _judge_positions(
    excess: FloatArray, stated: FloatArray, limits: JointLimits, sliding: Collection[str]
) -> Check:
    if not np.isfinite(stated).any():
        return not_checked("position", "the schedule states no such limit")
    joint = int(np.argmax(excess))
    name = _named(joint, limits)
    unit = unit_of(name, "rad", sliding)
    return judge("position", max(0.0, float(excess[joint])), tol.POSITION_SLACK, unit, name)


def _judge_share(name: str, share: FloatArray, stated: FloatArray, limits: JointLimits) -> Check:
    """Judges the largest share of a limit that is used; unlimited joints use none."""
    if not np.isfinite(stated).any():
        return not_checked(name, "no joint has such a limit")
    joint = int(np.argmax(share))
    unit = "share of the limit"
    where = f"{_named(joint, limits)}, limit {stated[joint]:g}"
    unlimited = [limits.joints[k] for k in np.flatnonzero(~np.isfinite(stated))]
    if unlimited:
        where += f"; without such a limit: {', '.join(unlimited)}"
    return judge(name, float(share[joint]), 1.0 + tol.RATE_SLACK, unit, where)


def _named(joint: int, limits: JointLimits) -> str:
    return limits.joints[joint]
