"""The continuous problem as one nonlinear program in CasADi, solved by IPOPT from a given plan."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.minimum_time.postures import Postures
from dualarm_cli.minimum_time.problem import ArmWork, SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.minimum_time.times import (
    Chain,
    Evaluated,
    evaluate,
    start_angle,
    start_joints,
)
from dualarm_cli.minimum_time.variables import Variables
from dualarm_cli.timing.rest_to_rest import RestToRest

LIMIT_MARGIN = 1e-4
"""What is kept free of position limits [rad]: the solver meets constraints to a millionth."""
LARGEST_MOVES = (0.3, 0.1, 0.02)
"""How far a variable may move from the plan so far, program after program [rad]; branches and whole turns stay."""
ITERATIONS = {"quick": 40, "normal": 120, "thorough": 400}
"""IPOPT's iterations by effort."""
SHORTEST = 0.02
"""Least time from which the program begins for a transfer or a line [s]: the reachable distance is flat below."""
LEAST_SHARE, MOST_SHARE = 0.4, 2.0
"""Range of a time, as shares of what it is in the given plan."""


def refine(
    problem: SequenceProblem, tables: tuple[StopTable, ...], start: Evaluated, effort: str
) -> Evaluated:
    """Returns a plan that is nowhere slower than the given one.

    Variables are the platform angles, the arm angles at the targets and at the outer ends of the lines, free yaws, and
    the times of all transfers and lines; joints follow from the closed-form inverse kinematics with the branches of the
    given plan. A move of d takes T if |d| <= D_j(T) for every joint, with D_j the distance reached from rest to rest:
    the closed form turned round, smooth but for its second derivative where a limit sets in. A line's time is that of
    its joints' displacements, times the factor that it has in the given plan. IPOPT finds a local optimum within a box,
    three times in ever smaller ones; it is evaluated exactly, and taken only if it is possible and faster.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        start: a possible plan.
        effort: one of ITERATIONS.
    """
    variables = Variables.of(problem)
    if not variables.count:
        return start
    best = start
    for largest in LARGEST_MOVES:
        step = _solve(problem, tables, variables, best, ITERATIONS[effort], largest)
        # A step that the lines' fixed factors make too long may be good in part.
        tried = [
            evaluate(problem, tables, variables.moved(best.decisions, share * step))
            for share in (1.0, 0.5, 0.25)
        ]
        best = min([best, *tried], key=lambda plan: plan.total)
    return best


def _solve(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    start: Evaluated,
    iterations: int,
    largest: float,
) -> FloatArray:
    """Returns the step of all variables to the program's optimum [rad]; zeros where IPOPT gives none."""
    import casadi as ca

    n, v = problem.stages, variables.count
    x = ca.MX.sym("x", v)
    stage = ca.MX.sym("stage", n + 1)
    unknown, first_guess = [x, stage], [np.zeros(v), np.append(start.stages, start.closing)]
    lower = [np.full(v, -largest), np.zeros(n + 1)]
    upper = [np.full(v, largest), np.full(n + 1, np.inf)]
    if problem.turns:
        low, high = problem.platform_range
        lower[0][variables.angle] = np.maximum(-largest, low - start.decisions.angle)
        upper[0][variables.angle] = np.minimum(largest, high - start.decisions.angle)
    below: list[Any] = []
    angle = [
        start.decisions.angle[k] + (x[int(variables.angle[k])] if problem.turns else 0.0)
        for k in range(n)
    ]
    begin_angle = angle[0] if problem.free_start else start_angle(problem, start.decisions.angle)

    def time(guess: float) -> Any:
        """Adds a time to the unknowns."""
        symbol = ca.MX.sym("t")
        unknown.append(symbol)
        guess = max(guess, SHORTEST)
        first_guess.append(np.array([guess]))
        lower.append(np.array([LEAST_SHARE * guess]))
        upper.append(np.array([MOST_SHARE * guess]))
        return symbol

    for a, work in enumerate(problem.arms):
        kinematics = _stop_function(work)
        chain, found = Chain.of(work), start.arms[a]
        q_from: Any = ca.DM(start_joints(problem, work, chain, found))
        begin = q_from
        for k in chain.active.tolist():
            q = _joints(ca, problem, tables, variables, start, kinematics, a, k, x)
            if problem.free_start and k == 0:
                begin = q[0]
                transfer = None
            else:
                before = angle[k - 1] if k else begin_angle
                transfer = time(_guess(work, problem, found, start, a, k))
                below += _within(ca, work.law, q[0] - q_from, transfer)
                if problem.platform_law is not None:
                    below += _within(
                        ca, problem.platform_law, ca.vertcat(angle[k] - before), transfer
                    )
            length = (transfer if transfer is not None else 0.0) + tables[a].dwell[k]
            for one, other, spent in ((q[0], q[1], found.approach), (q[1], q[2], found.retract)):
                asked = float(spent[k].max())
                if asked > 0.0:
                    line = time(asked / _factor(work, found, k, spent is found.approach))
                    below += _within(ca, work.law, other - one, line)
                    length = length + line * _factor(work, found, k, spent is found.approach)
            below.append(length - stage[k])
            below += _limits(ca, work, q)
            q_from = q[2]
        if problem.returns and len(chain.active):
            below += _within(ca, work.law, begin - q_from, stage[n])
    if problem.returns and problem.platform_law is not None:
        below += _within(ca, problem.platform_law, ca.vertcat(begin_angle - angle[-1]), stage[n])
    if not problem.returns:
        upper[1][n] = 0.0
    else:
        lower[1][n] = min(SHORTEST, max(start.closing, 1e-9))
    return _optimum(ca, unknown, first_guess, lower, upper, stage, below, v, iterations)


def _optimum(
    ca: Any,
    unknown: list[Any],
    first_guess: list[FloatArray],
    lower: list[FloatArray],
    upper: list[FloatArray],
    stage: Any,
    below: list[Any],
    count: int,
    iterations: int,
) -> FloatArray:
    constraints = ca.vertcat(*below)
    program = {"x": ca.vertcat(*unknown), "f": ca.sum1(stage), "g": constraints}
    options = {
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "max_iter": iterations,
            "tol": 1e-6,
        },
    }
    solver = ca.nlpsol("sequence", "ipopt", program, options)
    solution = solver(
        x0=np.concatenate(first_guess),
        lbx=np.concatenate(lower),
        ubx=np.concatenate(upper),
        lbg=-np.inf,
        ubg=0.0,
    )
    step = np.array(solution["x"]).ravel()[:count]
    return step if np.isfinite(step).all() else np.zeros(count)


def _guess(
    work: ArmWork, problem: SequenceProblem, found: Postures, start: Evaluated, a: int, k: int
) -> float:
    """Returns how long the transfer into a stage takes in the given plan [s]."""
    chain = Chain.of(work)
    came = int(chain.previous[k])
    q_from = found.q_retract[came] if came >= 0 else start_joints(problem, work, chain, found)
    own = float(work.law.duration(found.q_approach[k] - q_from))
    if problem.platform_law is None:
        return own
    angle = start.decisions.angle
    before = angle[k - 1] if k else start_angle(problem, angle)
    return max(own, float(problem.platform_law.duration(np.array([angle[k] - before]))))


def _factor(work: ArmWork, found: Postures, k: int, approach: bool) -> float:
    """Returns the time of a line over the rest-to-rest time of its joints' displacements in the given plan."""
    spent = found.approach[k] if approach else found.retract[k]
    end = found.q_approach[k] if approach else found.q_retract[k]
    straight = float(work.law.duration(end - found.q_target[k]))
    return float(spent.max()) / max(straight, 1e-9)


def _within(ca: Any, law: RestToRest, moved: Any, time: Any) -> list[Any]:
    """Returns expressions that are not positive where every joint gets there in time: |d| - D_j(T)."""
    constraints = []
    for joint in range(len(law.velocity)):
        reach = _reachable(ca, law, joint, time)
        constraints += [moved[joint] - reach, -moved[joint] - reach]
    return constraints


def _reachable(ca: Any, law: RestToRest, joint: int, time: Any) -> Any:
    """Returns D(T) of one joint as `RestToRest.reachable_distance`, in CasADi."""
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


def _limits(ca: Any, work: ArmWork, q: list[Any]) -> list[Any]:
    """Returns expressions that are not positive where all joints keep their position limits."""
    constraints = []
    for joints in q:
        for joint in range(7):
            low, high = work.limits.lower[joint], work.limits.upper[joint]
            if np.isfinite(high):
                constraints.append(joints[joint] - (high - LIMIT_MARGIN))
            if np.isfinite(low):
                constraints.append((low + LIMIT_MARGIN) - joints[joint])
    return constraints


def _joints(
    ca: Any,
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    start: Evaluated,
    kinematics: Any,
    a: int,
    k: int,
    x: Any,
) -> list[Any]:
    """Returns joints at the approach's start, the target and the retract's end as expressions."""
    work, table, found = problem.arms[a], tables[a], start.arms[a]
    row = start.decisions.arms[a].take(np.array([k]))
    column = variables.arms[a][k]

    def moved(field: int) -> Any:
        return x[int(column[field])] if column[field] >= 0 else 0.0

    carried = bool(table.carried[table.first[k] + row.target[0]])
    position = platform_positions(problem, start.decisions.angle[[k]])
    R, p, z = (
        value[0]
        for value in flange_poses(
            problem.platform, work, table, table.first[[k]] + row.target, row.yaw, position
        )
    )
    turn = x[int(variables.angle[k])] if problem.turns and not carried else 0.0
    psi = float(row.psi_target[0]) + moved(0)

    def outer(length: float, psi_end: float, field: int) -> tuple[float, Any]:
        # Where there is no line the arm angle has nothing to vary along.
        swing = psi_end - float(row.psi_target[0]) + moved(field) if length > 0.0 else 0.0
        return length, psi + swing

    ends = (
        outer(float(table.approach[k]), float(row.psi_approach[0]), 1),
        (0.0, psi),
        outer(float(table.retract[k]), float(row.psi_retract[0]), 2),
    )
    near = (found.q_approach[k], found.q_target[k], found.q_retract[k])
    yaw = moved(3)
    results = []
    for (length, arm_angle), reference in zip(ends, near, strict=True):
        if carried and length == 0.0:
            results.append(ca.DM(reference))
            continue
        results.append(
            kinematics(R, p - length * z, turn, yaw, arm_angle, int(row.branch[0]), reference)
        )
    return results


def _stop_function(work: ArmWork) -> Any:
    """Returns a CasADi function of (R, p, platform turn, yaw, arm angle, branch, reference) -> joints."""
    import casadi as ca

    geometry, canonical = work.kinematics.geometry, work.kinematics.canonical
    R0, p0 = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3)
    turn, yaw, psi = (ca.SX.sym(name) for name in ("turn", "yaw", "psi"))
    branch, near = ca.SX.sym("branch"), ca.SX.sym("near", 7)
    # The tool turns about its own z axis through its centre point, then everything with the platform, backwards.
    tool = ca.DM(work.R_tool_flange)
    spin = ca.mtimes([tool.T, _rotation(ca, yaw), tool])
    tcp = -ca.mtimes(tool.T, ca.DM(work.p_tool_flange))
    R_yawed = ca.mtimes(R0, spin)
    p_yawed = p0 + ca.mtimes(R0, tcp) - ca.mtimes(R_yawed, tcp)
    back = _rotation(ca, -turn)
    R, p = ca.mtimes(back, R_yawed), ca.mtimes(back, p_yawed)
    B, C = ca.DM(canonical.B), ca.DM(canonical.C)
    wrist = p + ca.mtimes(R, ca.DM(geometry.p_flange_wrist))
    w = ca.mtimes(B.T, wrist - ca.DM(geometry.shoulder))
    R7 = ca.mtimes([B.T, R, C.T])
    shoulder, fore, bend = _arm_plane(ca, w, psi, geometry.upper, geometry.fore)
    outer = ca.mtimes(fore, R7)
    elbow = ca.floor(branch / 4)
    flip = ca.floor(branch / 2) - 2 * elbow
    wrist_bit = branch - 4 * elbow - 2 * flip
    theta: list[Any] = [None] * 7
    for first, triple, mine in ((0, shoulder, flip), (4, outer, wrist_bit)):
        sign = 1 - 2 * mine
        theta[first] = ca.atan2(sign * triple[1, 2], sign * triple[0, 2])
        size = ca.sqrt(triple[0, 2] ** 2 + triple[1, 2] ** 2)
        theta[first + 1] = sign * ca.atan2(size, triple[2, 2])
        theta[first + 2] = ca.atan2(sign * triple[2, 1], -sign * triple[2, 0])
    theta[2] = theta[2] + np.pi * elbow
    theta[4] = theta[4] + np.pi * elbow
    theta[3] = (1 - 2 * elbow) * bend
    q = []
    for joint in range(7):
        raw = canonical.sign[joint] * (theta[joint] - canonical.offset[joint])
        gap = raw - near[joint]
        # On the turn of the reference, without a jump where it crosses half a turn.
        q.append(near[joint] + ca.atan2(ca.sin(gap), ca.cos(gap)))
    return ca.Function("stop", [R0, p0, turn, yaw, psi, branch, near], [ca.vertcat(*q)])


def _arm_plane(ca: Any, w: Any, psi: Any, upper: float, fore: float) -> tuple[Any, Any, Any]:
    """Returns the shoulder triple, the transposed frame of the forearm, and the bend; see `ArmPlane`."""
    d = ca.sqrt(ca.dot(w, w))
    u = w / d
    cos_bend = (d * d - upper**2 - fore**2) / (2.0 * upper * fore)
    bend = ca.acos(ca.fmin(ca.fmax(cos_bend, -1.0 + 1e-12), 1.0 - 1e-12))
    a = ca.atan2(fore * ca.sin(bend), upper + fore * ca.cos(bend))
    f = bend - a
    # reference_directions without its division: v c² = x²/(1+z), v c s = x y/(1+z).
    x, y, z = u[0], u[1], u[2]
    r = ca.vertcat(1 - x * x / (1 + z), -x * y / (1 + z), -x)
    t = ca.vertcat(-x * y / (1 + z), 1 - y * y / (1 + z), -y)
    h, m = r * ca.cos(psi) + t * ca.sin(psi), t * ca.cos(psi) - r * ca.sin(psi)
    shoulder = ca.horzcat(ca.sin(a) * u - ca.cos(a) * h, -m, ca.cos(a) * u + ca.sin(a) * h)
    forearm = ca.vertcat(
        (-ca.cos(f) * h - ca.sin(f) * u).T, -m.T, (ca.cos(f) * u - ca.sin(f) * h).T
    )
    return shoulder, forearm, bend


def _rotation(ca: Any, angle: Any) -> Any:
    """Returns a rotation about z."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
