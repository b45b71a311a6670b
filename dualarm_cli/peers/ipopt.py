"""IPOPT on the joints themselves: what one writes in CasADi without knowing the arms' closed forms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.minimum_time.corridor import best_combination
from dualarm_cli.minimum_time.problem import ArmDecisions, ArmWork, Decisions, SequenceProblem
from dualarm_cli.minimum_time.program_kinematics import forward, turned_pose
from dualarm_cli.minimum_time.program_times import reachable_distance, within_reach
from dualarm_cli.minimum_time.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.minimum_time.times import Chain, Evaluated, start_angle, start_joints

ITERATIONS = {"quick": 100, "normal": 300, "thorough": 1500}
"""IPOPT's iterations in each program, by effort."""
BOXES = {
    "quick": (np.inf, 0.3),
    "normal": (np.inf, 0.6, 0.3, 0.1),
    "thorough": (np.inf, 0.6, 0.6, 0.3, 0.3, 0.1, 0.1, 0.03),
}
"""How far joints may be from the best plan so far, program after program, by effort [rad]."""
LIMIT_MARGIN = 1e-5
"""What is kept free of position limits [rad]: IPOPT meets constraints to about a millionth."""
SHORTEST = 0.01
"""Least time of a transfer or a line [s]: the reachable distance is flat below."""
SHORT_LINE = 0.02
"""Least rest-to-rest time that a line's factors are taken from [s]."""
FACTORS = (0.8, 2.5)
"""Range of these factors."""


def nonlinear_program(
    problem: SequenceProblem, tables: tuple[StopTable, ...], start: Evaluated, effort: str
) -> Evaluated:
    """Returns IPOPT's local optimum; never slower than the start.

    Variables are the platform angles, free yaws, and the joints where lines and transfers end, all free within their
    limits. Forward kinematics is an equality constraint on each tool pose: three equations for the place and the three
    skew components of the rotation that is missing. A stage's length is an epigraph variable, and so is the time of
    every transfer and line: a displacement d is possible in T if |d| <= D(T) for every joint, which, other than T(d), is
    smooth at d = 0. D is once continuously differentiable; where a limit sets in, its second derivative jumps, which
    IPOPT has to live with. A line's time is the rest-to-rest time of its joints' displacements times the factor that it
    has in the plan so far. Decisions are read back from the joints, and timed exactly.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        start: a possible plan.
        effort: one of ITERATIONS.
    """
    best = start
    for box in BOXES[effort]:
        program = _Program.of(problem, tables, best, box)
        values = program.solve(ITERATIONS[effort])
        if values is None:
            continue
        # A single line that is impossible after all need not spoil the other stages.
        best = best_combination(problem, tables, best, [program.decisions(values)])
    return best


@dataclass
class _Program:
    """A nonlinear program while it is being written."""

    problem: SequenceProblem
    tables: tuple[StopTable, ...]
    start: Evaluated
    box: float
    unknown: list[Any] = field(default_factory=list)
    guess: list[FloatArray] = field(default_factory=list)
    lower: list[FloatArray] = field(default_factory=list)
    upper: list[FloatArray] = field(default_factory=list)
    below: list[Any] = field(default_factory=list)
    """Expressions that must not be positive."""
    zero: list[Any] = field(default_factory=list)
    """Expressions that must be zero."""
    angle: list[Any] = field(default_factory=list)
    """Platform angles."""
    yaw: dict[tuple[int, int], Any] = field(default_factory=dict)
    """Turns of the tool from where it is in the start, by arm and stage."""
    joints: dict[tuple[int, int], tuple[Any, Any, Any]] = field(default_factory=dict)
    """At the approach's start, the target and the retract's end, by arm and stage."""
    length: Any = None
    """Lengths of the stages and of the return."""

    @classmethod
    def of(
        cls,
        problem: SequenceProblem,
        tables: tuple[StopTable, ...],
        start: Evaluated,
        box: float,
    ) -> _Program:
        """Returns the program around a possible plan."""
        program = cls(problem, tables, start, box)
        n = problem.stages
        infinite = np.full(n + 1, np.inf)
        guess = np.append(start.stages, start.closing)
        program.length = program._variable(guess, np.zeros(n + 1), infinite)
        for k in range(n):
            here = start.decisions.angle[k : k + 1]
            low, high = (np.array([end]) for end in problem.platform_range)
            program.angle.append(
                program._variable(here, low, high) if problem.turns else float(here[0])
            )
        for a in range(len(problem.arms)):
            program._arm(a)
        return program

    def _variable(self, guess: FloatArray, lower: FloatArray, upper: FloatArray) -> Any:
        """Returns new unknowns."""
        import casadi as ca

        symbol = ca.SX.sym(f"x{len(self.unknown)}", len(guess))
        self.unknown.append(symbol)
        self.guess.append(np.clip(guess, lower, upper))
        self.lower.append(lower)
        self.upper.append(upper)
        return symbol

    def _time(self, guess: float) -> Any:
        low = np.array([SHORTEST])
        return self._variable(np.array([guess]), low, np.full(1, np.inf))

    def _arm(self, a: int) -> None:
        """Adds one arm: its postures, its transfers and lines, its return."""
        problem, work, found = self.problem, self.problem.arms[a], self.start.arms[a]
        chain = Chain.of(work)
        if not len(chain.active):
            return
        for k in chain.active.tolist():
            self._stop(a, k)
        began = start_joints(problem, work, chain, found)
        free = problem.free_start and chain.active[0] == 0
        begin = self.joints[a, 0][0] if free else began
        angles = self._angle_before(0), *self.angle
        came, guess_from = begin, began
        for k in chain.active.tolist():
            q = self.joints[a, k]
            length = self._lines(a, k) + self.tables[a].dwell[k]
            if not (problem.free_start and k == 0):
                moved = found.q_approach[k] - guess_from
                transfer = self._time(float(work.law.duration(moved)))
                self.below += within_reach(work.law, q[0] - came, transfer)
                self._platform(angles[k + 1] - angles[k], transfer)
                length = length + transfer
            self.below.append(length - self.length[k])
            came, guess_from = q[2], found.q_retract[k]
        if problem.returns:
            closing = self.length[problem.stages]
            self.below += within_reach(work.law, begin - came, closing)
            self._platform(angles[0] - angles[-1], closing)

    def _angle_before(self, k: int) -> Any:
        """Returns the platform angle before a stage."""
        if k or self.problem.free_start:
            return self.angle[max(k - 1, 0)]
        return start_angle(self.problem, self.start.decisions.angle)

    def _platform(self, moved: Any, time: Any) -> None:
        law = self.problem.platform_law
        if law is not None:
            import casadi as ca

            self.below += within_reach(law, ca.vertcat(moved), time)

    def _stop(self, a: int, k: int) -> None:
        """Adds the joints of one stop, at their poses."""
        work, table, found = self.problem.arms[a], self.tables[a], self.start.arms[a]
        row = self.start.decisions.arms[a].take(np.array([k]))
        index = table.first[[k]] + row.target
        carried = bool(table.carried[index[0]])
        position = platform_positions(self.problem, self.start.decisions.angle[[k]])
        R, p, z = (
            value[0]
            for value in flange_poses(
                self.problem.platform, work, table, index, row.yaw, position
            )
        )
        stop = work.stops[k]
        yaw: Any = 0.0
        if stop is not None and stop.free_yaw and not carried:
            yaw = self._variable(np.zeros(1), np.full(1, -np.inf), np.full(1, np.inf))
            self.yaw[a, k] = yaw
        turn = 0.0 if carried else self.angle[k] - float(self.start.decisions.angle[k])
        # Joint targets stay; their lines may end in any posture.
        target = found.q_target[k] if carried else self._posture(work, found.q_target[k])
        if not carried:
            self._at(work, target, R, p, turn, yaw)
        ends = []
        for depth, near in (
            (float(table.approach[k]), found.q_approach[k]),
            (float(table.retract[k]), found.q_retract[k]),
        ):
            end = target
            if depth > 0.0:
                end = self._posture(work, near)
                self._at(work, end, R, p - depth * z, turn, yaw)
            ends.append(end)
        self.joints[a, k] = ends[0], target, ends[1]

    def _posture(self, work: ArmWork, guess: FloatArray) -> Any:
        lower = np.maximum(work.limits.lower + LIMIT_MARGIN, guess - self.box)
        upper = np.minimum(work.limits.upper - LIMIT_MARGIN, guess + self.box)
        return self._variable(guess, lower, upper)

    def _at(
        self, work: ArmWork, q: Any, R: FloatArray, p: FloatArray, turn: Any, yaw: Any
    ) -> None:
        """Adds the equations of one pose."""
        import casadi as ca

        R_target, p_target = turned_pose(work, R, p, turn, yaw)
        R_here, p_here = forward(work.kinematics, q)
        missing = ca.mtimes(R_target.T, R_here)
        self.zero += [p_here - p_target]
        self.zero += [missing[i, j] - missing[j, i] for i, j in ((2, 1), (0, 2), (1, 0))]

    def _lines(self, a: int, k: int) -> Any:
        """Adds the times of a stop's lines; returns their sum."""
        work, found = self.problem.arms[a], self.start.arms[a]
        q = self.joints[a, k]
        total: Any = 0.0
        for end, spent, other in (
            (q[0], found.approach[k], found.q_approach[k]),
            (q[2], found.retract[k], found.q_retract[k]),
        ):
            longest = float(spent.max())
            if longest <= 0.0:
                continue
            time = self._time(longest)
            straight = work.law.per_joint(other - found.q_target[k])
            factor = np.clip(spent / np.maximum(straight, SHORT_LINE), *FACTORS)
            for joint in range(7):
                moved = end[joint] - q[1][joint]
                reach = reachable_distance(work.law, joint, time / float(factor[joint]))
                self.below += [moved - reach, -moved - reach]
            total = total + time
        return total

    def solve(self, iterations: int) -> FloatArray | None:
        """Returns the optimum's unknowns, None where IPOPT gives none."""
        import casadi as ca

        below, zero = ca.vertcat(*self.below), ca.vertcat(*self.zero)
        solver = ca.nlpsol(
            "sequence",
            "ipopt",
            {
                "x": ca.vertcat(*self.unknown),
                "f": ca.sum1(self.length),
                "g": ca.vertcat(below, zero),
            },
            {
                "print_time": False,
                "error_on_fail": False,
                "show_eval_warnings": False,
                "ipopt": {"print_level": 0, "sb": "yes", "max_iter": iterations, "tol": 1e-5, "mu_strategy": "adaptive"},
            },
        )
        solution = solver(
            x0=np.concatenate(self.guess),
            lbx=np.concatenate(self.lower),
            ubx=np.concatenate(self.upper),
            lbg=np.concatenate([np.full(below.numel(), -np.inf), np.zeros(zero.numel())]),
            ubg=0.0,
        )
        values = np.array(solution["x"]).ravel()
        return values if np.isfinite(values).all() else None

    def decisions(self, values: FloatArray) -> Decisions:
        """Returns what the unknowns decide: branches and arm angles are read from the joints."""
        import casadi as ca

        unknown = ca.vertcat(*self.unknown)

        def number(expression: Any) -> FloatArray:
            asked = ca.Function("value", [unknown], [ca.SX(expression)])
            return np.array(asked(values)).ravel()

        before = self.start.decisions
        angle = number(ca.vertcat(*self.angle)) if self.problem.turns else before.angle
        arms = list(before.arms)
        for (a, k), q in self.joints.items():
            q_approach, q_target, q_retract = (number(joints) for joints in q)
            yaw = number(self.yaw[a, k]) if (a, k) in self.yaw else np.zeros(1)
            row = arms[a].take(np.array([k]))
            read = _read(self.problem.arms[a], row, yaw, q_approach, q_target, q_retract)
            arms[a] = arms[a].put(np.array([k]), read)
        return Decisions(angle, tuple(arms))


def _read(
    work: ArmWork,
    row: ArmDecisions,
    yaw: FloatArray,
    q_approach: FloatArray,
    q_target: FloatArray,
    q_retract: FloatArray,
) -> ArmDecisions:
    """Returns one stop's decisions from its joints; arm angles at lines' ends on the turn next to the target's."""
    kinematics = work.kinematics
    psi, psi_approach, psi_retract = (
        kinematics.arm_angle(q[None]) for q in (q_target, q_approach, q_retract)
    )

    def beside(end: FloatArray) -> FloatArray:
        return psi + np.remainder(end - psi + np.pi, 2.0 * np.pi) - np.pi

    return replace(
        row,
        yaw=row.yaw + yaw,
        branch=kinematics.branch(q_target[None]),
        psi_target=psi,
        psi_approach=beside(psi_approach),
        psi_retract=beside(psi_retract),
        near=q_target[None],
    )
