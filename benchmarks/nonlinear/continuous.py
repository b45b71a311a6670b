"""The continuous problem as one nonlinear program in CasADi, solved by IPOPT from a given plan."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np

from benchmarks.nonlinear.program import NonlinearProgram
from benchmarks.nonlinear.program_kinematics import inverse, turned_pose
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import flange_poses, platform_positions
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.variables import FIELDS, Slopes, Variables, slopes

ITERATIONS, BOXES = 150, (0.3, 0.1, 0.03, 0.01)
"""Iterations of each program, and how far variables may be from the best plan so far, one after the other [rad]."""
LIMIT_MARGIN = 1e-4
"""What is kept free of position limits [rad]: the solver meets constraints to a millionth."""
SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of a program's step that are tried: lines are linear in it."""
NEAR_CRITICAL = 0.6
"""Share of a line's time from which on a joint's own time is watched."""


def refine(problem: SequenceProblem, start: Evaluated) -> Evaluated:
    """Returns a plan that is never slower than the given one.

    Variables are the platform angles, the arm angles at the targets and at the outer ends of the lines, free yaws, and
    the times of all transfers and lines; joints follow from the closed-form inverse kinematics with the branches of the
    given plan. A move of d takes T if |d| <= D_j(T) for every joint, with D_j the distance reached from rest to rest:
    the closed form turned round, once continuously differentiable, with a second derivative that jumps where a limit
    sets in. A line's time is linear in the variables, joint by joint, about the plan so far. IPOPT finds a local
    optimum within a box; shares of its step are timed exactly, as they are and combined stage by stage, and the fastest
    is taken. Then again, in smaller boxes.

    Args:
        problem: the sequence.
        start: a possible plan.
    """
    variables = Variables.of(problem)
    if not variables.count or not np.isfinite(start.total):
        return start
    best = start
    for box in BOXES:
        program = _AngleProgram.of(problem, best, box)
        values = program.solve(ITERATIONS)
        if values is None:
            continue
        step = program.step_of_all(variables, values)
        moved = [variables.moved(best.decisions, share * step) for share in SHARES]
        # Whole steps too: a combination keeps the start of a cycle that closes where it is.
        whole = [evaluate(problem, plan) for plan in moved]
        best = min([best, *whole], key=lambda plan: plan.total)
        best = best_combination(problem, best, moved)
    return best


@dataclass
class _AngleProgram(NonlinearProgram):
    """The program whose unknowns are a plan's own continuous decisions."""

    rates: tuple[Slopes, ...] = ()
    """What the lines' times do, by arm."""
    numbering: tuple[IntArray, ...] = ()
    """Which FIELDS are free, by arm: see `Variables`."""
    steps: dict[tuple[int, int, int], Any] = field(default_factory=dict)
    """Of arm, stage and FIELDS."""

    @classmethod
    def of(cls, problem: SequenceProblem, start: Evaluated, box: float) -> _AngleProgram:
        """Returns the program around a possible plan."""
        rates = tuple(slopes(problem, a, start.decisions, own) for a, own in enumerate(start.arms))
        program = cls(problem, start, box, rates=rates, numbering=Variables.of(problem).arms)
        program.write()
        return program

    def step_of_all(self, variables: Variables, values: FloatArray) -> FloatArray:
        """Returns the step of all variables for values of the unknowns [rad], shape (count,)."""
        step: list[Any] = [0.0] * variables.count
        for (a, k, column), symbol in self.steps.items():
            step[int(variables.arms[a][k, column])] = symbol
        if self.problem.turns:
            for k, place in enumerate(variables.angle.tolist()):
                step[place] = self.turn(k)
        return self.numbers(step, values)

    def turn(self, k: int) -> Any:
        """Returns how far the platform is from where the plan so far has it."""
        return self.angle[k] - float(self.start.decisions.angle[k])

    def step(self, a: int, k: int, column: int) -> Any:
        """Returns the step of one of an arm's FIELDS."""
        return self.steps.get((a, k, column), 0.0)

    def stop(self, a: int, k: int) -> tuple[Any, Any, Any]:
        """Returns the joints of one stop as functions of its decisions."""
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
        for column in np.flatnonzero(self.numbering[a][k] >= 0).tolist():
            bounds = np.array([-self.box]), np.array([self.box])
            self.steps[a, k, column] = self.variable(np.zeros(1), *bounds)
        turn = self.turn(k) if self.problem.turns and not carried else 0.0
        psi = float(row.psi_target[0]) + self.step(a, k, 0)
        ends = (
            (float(table.approach[k]), float(row.psi_approach[0]), 1, found.q_approach[k]),
            (0.0, 0.0, 0, found.q_target[k]),
            (float(table.retract[k]), float(row.psi_retract[0]), 2, found.q_retract[k]),
        )
        joints = []
        for depth, psi_end, column, near in ends:
            if carried and depth == 0.0:
                joints.append(near)
                continue
            arm_angle = psi
            if depth > 0.0:
                # Where there is no line the arm angle has nothing to vary along.
                arm_angle = psi_end + self.step(a, k, 0) + self.step(a, k, column)
            R_here, p_here = turned_pose(
                work,
                R,
                p - depth * z,
                turn,
                self.step(a, k, 3),
                slides=self.problem.platform.is_rail,
            )
            q = inverse(work.closed_form, R_here, p_here, arm_angle, int(row.branch[0]), near)
            joints.append(q)
            self._within_limits(work, q)
        return joints[0], joints[1], joints[2]

    def _within_limits(self, work: ArmWork, q: Any) -> None:
        """Adds the position limits of those joints that may come near them."""
        for joint in range(7):
            low, high = work.limits.lower[joint], work.limits.upper[joint]
            if np.isfinite(high):
                self.below.append(q[joint] - (high - LIMIT_MARGIN))
            if np.isfinite(low):
                self.below.append((low + LIMIT_MARGIN) - q[joint])

    def lines(self, a: int, k: int) -> Any:
        """Returns the time of both lines, each joint's linear in the stop's decisions [s]."""
        found, rates = self.start.arms[a], self.rates[a]
        row = self.start.decisions.arms[a].take(np.array([k]))
        table = self.problem.arms[a].stop_table
        carried = bool(table.carried[table.first[k] + row.target[0]])
        turn = self.turn(k) if self.problem.turns and not carried else 0.0
        steps = [turn, *(self.step(a, k, column) for column in range(len(FIELDS)))]
        total: Any = 0.0
        for spent, slope in (
            (found.approach[k], rates.approach[k]),
            (found.retract[k], rates.retract[k]),
        ):
            longest = float(spent.max())
            if longest <= 0.0:
                continue
            time = self.time(longest)
            for joint in np.flatnonzero(spent >= NEAR_CRITICAL * longest).tolist():
                change = sum(float(c) * step for c, step in zip(slope[joint], steps, strict=True))
                self.below.append(float(spent[joint]) + change - time)
            total = total + time
        return total
