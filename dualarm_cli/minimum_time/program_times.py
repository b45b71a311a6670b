"""Rest-to-rest times as smooth constraints of a nonlinear program in CasADi."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.timing.rest_to_rest import RestToRest


def within_reach(law: RestToRest, moved: Any, time: Any) -> list[Any]:
    """Returns expressions that are not positive where every joint gets there in time: |d| - D_j(T).

    A least time T(d) bends at zero and has infinite slope there without a jerk limit; its inverse D(T) has neither.

    Args:
        law: of n joints.
        moved: displacements [rad], n of them.
        time: how long it may take [s].
    """
    constraints = []
    for joint in range(len(law.velocity)):
        reach = reachable_distance(law, joint, time)
        constraints += [moved[joint] - reach, -moved[joint] - reach]
    return constraints


def reachable_distance(law: RestToRest, joint: int, time: Any) -> Any:
    """Returns D(T) of one joint as `RestToRest.reachable_distance` has it.

    Once continuously differentiable; its second derivative jumps where a limit sets in.

    Args:
        law: of n joints.
        joint: which one.
        time: T [s], greater than 0.
    """
    import casadi as ca

    v, a, j = (float(x[joint]) for x in (law.velocity, law.acceleration, law.jerk))
    ramp = a / j
    reaches_a = v * j >= a * a
    t_v = v / a + ramp if reaches_a else 2.0 * np.sqrt(v / j)
    full = v * (time - t_v)
    middle = a * (0.5 * time - ramp) * 0.5 * time
    if np.isinf(j):
        return ca.if_else(time >= 2.0 * t_v, full, middle)
    short = j * time**3 / 32.0
    if not reaches_a:
        return ca.if_else(time >= 2.0 * t_v, full, short)
    slow = ca.if_else(time <= 4.0 * ramp, short, middle)
    return ca.if_else(time >= 2.0 * t_v, full, slow)
