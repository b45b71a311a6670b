"""IPOPT on the joints themselves: what one writes in CasADi without knowing the arms' closed forms."""

from __future__ import annotations

from dataclasses import field, replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.nonlinear.program import NonlinearProgram, reachable_distance
from benchmarks.nonlinear.program_kinematics import chain_function, turned_pose
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import flange_poses, platform_positions
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination

ITERATIONS, BOXES = 300, (np.inf, 0.6, 0.3, 0.1)
"""Iterations of each program, and how far variables may be from the best plan so far, one after the other [rad]."""
LIMIT_MARGIN = 1e-5
"""What is kept free of position limits [rad]: IPOPT meets constraints to about a millionth."""
SHORT_LINE = 0.02
"""Least rest-to-rest time that a line's factors are taken from [s]."""
LITTLE = 1e-4
"""Share of the cycle time by which a program may be off and yet count as exact."""
FACTORS = (0.8, 2.5)
"""Range of these factors."""


def nonlinear_program(problem: SequenceProblem, start: Evaluated) -> Evaluated:
    """Returns IPOPT's local optimum; never slower than the start.

    Variables are the platform angles, free yaws, and the joints where lines and transfers end, all free within their
    limits. Forward kinematics is an equality constraint on each tool pose: three equations for the place and the three
    skew components of the rotation that is missing. A stage's length is an epigraph variable, and so is the time of
    every transfer and line: a displacement d is possible in T if |d| <= D(T) for every joint, which, other than T(d),
    is smooth at d = 0. D is once continuously differentiable; where a limit sets in, its second derivative jumps, which
    IPOPT has to live with. What a joint asks for on a line is the rest-to-rest time of its displacement times the
    factor that it has in the plan so far. Branches and arm angles are read back from the joints, and timed exactly: the
    first program has no box, the later ones stay nearer and nearer to the best plan so far.

    Args:
        problem: the sequence.
        start: a possible plan.
    """
    best = start
    for box in BOXES:
        program = _JointProgram(problem, best, box)
        program.write()
        values = program.solve(ITERATIONS)
        if values is None:
            continue
        promised = float(values[: problem.stages + 1].sum())
        found = program.decisions(values)
        best = min(best, evaluate(problem, found), key=lambda plan: plan.total)
        # A single line that is impossible after all need not spoil the other stages.
        best = best_combination(problem, best, [found])
        if abs(best.total - promised) < LITTLE * best.total:
            # The lines are as the program has them: a smaller box has nothing to repair.
            break
    return best


@dataclass
class _JointProgram(NonlinearProgram):
    """The program whose unknowns are joints."""

    yaw: dict[tuple[int, int], Any] = field(default_factory=dict)
    """Turns of the tool from where it is in the start, by arm and stage."""
    chains: dict[str, Any] = field(default_factory=dict)
    """Forward kinematics by arm."""

    def stop(self, a: int, k: int) -> tuple[Any, Any, Any]:
        """Returns new joints of one stop, at their poses."""
        work, found = self.problem.arms[a], self.start.arms[a]
        table = work.stop_table
        row = self.start.decisions.arms[a].take(np.array([k]))
        index = table.first[[k]] + row.target
        carried = bool(table.carried[index[0]])
        position = platform_positions(self.problem, self.start.decisions.angle[[k]])
        R, p, (away, _) = (
            value[0]
            for value in flange_poses(self.problem.platform, work, index, row.yaw, position)
        )
        z = -away
        stop = work.stops[k]
        yaw: Any = 0.0
        if stop is not None and stop.free_yaw and not carried:
            yaw = self.variable(np.zeros(1), np.full(1, -np.inf), np.full(1, np.inf))
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
        return ends[0], target, ends[1]

    def _posture(self, work: ArmWork, guess: FloatArray) -> Any:
        lower = np.maximum(work.limits.lower + LIMIT_MARGIN, guess - self.box)
        upper = np.minimum(work.limits.upper - LIMIT_MARGIN, guess + self.box)
        return self.variable(guess, lower, upper)

    def _at(self, work: ArmWork, q: Any, R: FloatArray, p: FloatArray, turn: Any, yaw: Any) -> None:
        """Adds the equations of one pose."""
        slides = self.problem.platform.is_rail
        R_target, p_target = turned_pose(work, R, p, turn, yaw, slides=slides)
        if work.name not in self.chains:
            self.chains[work.name] = chain_function(work.closed_form)
        R_here, p_here = self.chains[work.name](q)
        missing = ca.mtimes(R_target.T, R_here)
        self.zero += [p_here - p_target]
        self.zero += [missing[i, j] - missing[j, i] for i, j in ((2, 1), (0, 2), (1, 0))]

    def lines(self, a: int, k: int) -> Any:
        """Returns the time of both lines, by joint displacement [s]."""
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
            time = self.time(longest)
            straight = work.law.per_joint(other - found.q_target[k])
            factor = np.clip(spent / np.maximum(straight, SHORT_LINE), *FACTORS)
            for joint in range(7):
                moved = end[joint] - q[1][joint]
                reach = reachable_distance(work.law, joint, time / float(factor[joint]))
                self.below += [moved - reach, -moved - reach]
            total = total + time
        return total

    def decisions(self, values: FloatArray) -> Decisions:
        """Returns what the unknowns decide: branches and arm angles are read from the joints."""
        stops = list(self.joints)
        joints = [q for stop in stops for q in self.joints[stop]]
        asked = [*self.angle, *(self.yaw.get(stop, 0.0) for stop in stops), *joints]
        numbers = self.numbers(asked, values)
        n, m = self.problem.stages, len(stops)
        angle, yaw = numbers[:n], numbers[n : n + m]
        postures = numbers[n + m :].reshape(m, 3, 7)
        arms = list(self.start.decisions.arms)
        for (a, k), turned, q in zip(stops, yaw, postures, strict=True):
            row = np.array([k])
            work = self.problem.arms[a]
            arms[a] = arms[a].put(row, _read(work, arms[a].take(row), float(turned), q))
        return Decisions(angle, tuple(arms))


def _read(work: ArmWork, row: ArmDecisions, yaw: float, q: FloatArray) -> ArmDecisions:
    """Returns one stop's decisions from its joints (3, 7); arm angles at lines' ends next to the target's."""
    approach, target, retract = work.closed_form.arm_angle(q)
    outer = np.array([approach, retract])
    beside = target + np.remainder(outer - target + np.pi, 2.0 * np.pi) - np.pi
    return replace(
        row,
        yaw=row.yaw + yaw,
        branch=work.closed_form.branch(q[1:2]),
        psi_target=np.array([target]),
        psi_approach=beside[:1],
        psi_retract=beside[1:],
        near=q[1:2],
    )
