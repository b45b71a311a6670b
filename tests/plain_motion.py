"""Joint motion of schedule.json as any reader has it who follows its page in the reference, without this program."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any, NamedTuple


class Knot(NamedTuple):
    """Time, and position, velocity and acceleration of each joint of a group."""

    time: float
    position: list[float]
    velocity: list[float]
    acceleration: list[float]


def knots(document: dict[str, Any], group: str) -> list[Knot]:
    """Returns the knots of a group, followed from anchor to anchor."""
    part = document["motion"][group]
    stated = {
        k: pair for k, *pair in zip(part["anchor"], part["position"], part["velocity"], strict=True)
    }
    found: list[Knot] = []
    for k, (t1, a) in enumerate(zip(part["time"], part["acceleration"], strict=True)):
        if k in stated:
            found.append(Knot(t1, *stated[k], a))
            continue
        t0, q0, v0, a0 = found[-1]
        h = t1 - t0
        v = [v0[i] + h * ((a0[i] + a[i]) / 2) for i in range(len(a))]
        q = [q0[i] + (h * v0[i] + h**2 * ((a0[i] + a0[i] + a[i]) / 6)) for i in range(len(a))]
        found.append(Knot(t1, q, v, a))
    return found


def positions(document: dict[str, Any], time: float) -> dict[str, float]:
    """Returns the position of each joint at an instant [s]: between knots accelerations are linear in time."""
    found = {}
    for group, joints in document["robot"]["groups"].items():
        rows = knots(document, group)
        k = bisect_right([row.time for row in rows], time) - 1
        t, q, v, a = rows[k]
        dt = time - t
        for i, joint in enumerate(joints):
            found[joint] = q[i]
            if k + 1 < len(rows):
                jerk = (rows[k + 1].acceleration[i] - a[i]) / (rows[k + 1].time - t)
                found[joint] = q[i] + v[i] * dt + a[i] * dt**2 / 2 + jerk * dt**3 / 6
    return found
