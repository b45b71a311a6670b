"""A sequence as a nonlinear program in CasADi: stages, transfers, return; the unknowns of a stop are left open."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import field
from typing import Any

import casadi as ca
import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, TransferChain, start_angle, start_joints


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


SHORTEST = 0.01
"""Least time of a transfer or a line [s]: the reachable distance is flat below."""


@dataclass
class NonlinearProgram(ABC):
    """A nonlinear program while it is being written.

    Lengths of stages are epigraph variables, and so are the times of transfers and lines: a displacement d is possible
    in T if |d| <= D(T) for every joint, which, other than T(d), is smooth at d = 0.
    """

    problem: SequenceProblem
    start: Evaluated
    """A possible plan: first guess, and middle of the box."""
    box: float
    """How far variables may be from it [rad]."""
    angle: list[Any] = field(default_factory=list)
    """Platform angle of each stage."""
    joints: dict[tuple[int, int], tuple[Any, Any, Any]] = field(default_factory=dict)
    """At the approach's start, the target and the retract's end, by arm and stage."""
    met: dict[int, list[tuple[Any, Any]]] = field(default_factory=dict)
    """By hand-over's stage the times of each arm's transfer, and of its lines and dwell [s]."""
    length: Any = None
    """Lengths of the stages and of the return [s], shape (n + 1,)."""
    below: list[Any] = field(default_factory=list)
    """Expressions that must not be positive."""
    zero: list[Any] = field(default_factory=list)
    """Expressions that must be zero."""
    unknown: list[Any] = field(default_factory=list)
    guess: list[FloatArray] = field(default_factory=list)
    lower: list[FloatArray] = field(default_factory=list)
    upper: list[FloatArray] = field(default_factory=list)

    @abstractmethod
    def stop(self, a: int, k: int) -> tuple[Any, Any, Any]:
        """Returns the joints of arm a in stage k: at the approach's start, the target and the retract's end."""

    @abstractmethod
    def lines(self, a: int, k: int) -> Any:
        """Returns the time of both lines of arm a in stage k [s]."""

    def write(self) -> None:
        """Writes everything down."""
        n, decided = self.problem.stages, self.start.decisions
        guess = np.append(self.start.stages, self.start.closing)
        self.length = self.variable(guess, np.zeros(n + 1), np.full(n + 1, np.inf))
        low, high = self.problem.platform_range
        for here in decided.angle.tolist():
            if not self.problem.turns:
                self.angle.append(here)
                continue
            bounds = max(low, here - self.box), min(high, here + self.box)
            self.angle.append(self.variable(*(np.array([x]) for x in (here, *bounds))))
        for a in range(len(self.problem.arms)):
            self._arm(a)
        for k, arms in self.met.items():
            work = sum(own for _, own in arms)
            self.below += [transfer + work - self.length[k] for transfer, _ in arms]

    def variable(self, guess: FloatArray, lower: FloatArray, upper: FloatArray) -> Any:
        """Returns new unknowns within bounds."""
        symbol = ca.SX.sym(f"x{len(self.unknown)}", len(guess))
        self.unknown.append(symbol)
        self.guess.append(np.clip(guess, lower, upper))
        self.lower.append(lower)
        self.upper.append(upper)
        return symbol

    def time(self, guess: float) -> Any:
        """Returns a new time [s]."""
        return self.variable(np.array([guess]), np.array([SHORTEST]), np.array([np.inf]))

    def _arm(self, a: int) -> None:
        """Adds one arm's stops, transfers, lines and return."""
        problem, arm, found = self.problem, self.problem.arms[a], self.start.arms[a]
        chain = TransferChain.of(arm)
        if not len(chain.active):
            return
        for k in chain.active.tolist():
            self.joints[a, k] = self.stop(a, k)
        began = start_joints(problem, arm, chain, found)
        starts_here = problem.free_start and chain.active[0] == 0
        begin = self.joints[a, 0][0] if starts_here else began
        first = self.angle[0]
        if not problem.free_start:
            first = start_angle(problem, self.start.decisions.angle)
        angles = first, *self.angle
        came, came_guess = begin, began
        for k in chain.active.tolist():
            q = self.joints[a, k]
            work, transfer = self.lines(a, k) + arm.stop_table.dwell[k], 0.0
            if not (problem.free_start and k == 0):
                guess = float(arm.law.duration(found.q_approach[k] - came_guess))
                transfer = self.time(guess)
                self.below += within_reach(arm.law, q[0] - came, transfer)
                self._platform(angles[k + 1] - angles[k], transfer)
            if k in problem.handover_stages:
                self.met.setdefault(k, []).append((transfer, work))
            else:
                self.below.append(transfer + work - self.length[k])
            came, came_guess = q[2], found.q_retract[k]
        if problem.returns:
            closing = self.length[problem.stages]
            self.below += within_reach(arm.law, begin - came, closing)
            self._platform(first - angles[-1], closing)

    def _platform(self, moved: Any, time: Any) -> None:
        law = self.problem.platform_law
        if law is not None:
            self.below += within_reach(law, ca.vertcat(moved), time)

    def solve(self, iterations: int) -> FloatArray | None:
        """Returns IPOPT's values of the unknowns, None where it gives none; the lengths come first.

        Args:
            iterations: how many at most.
        """
        below, zero = ca.vertcat(*self.below), ca.vertcat(*self.zero)
        program = {
            "x": ca.vertcat(*self.unknown),
            "f": ca.sum1(self.length),
            "g": ca.vertcat(below, zero),
        }
        options: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": iterations,
                "tol": 1e-5,
                "mu_strategy": "adaptive",
            },
        }
        solution = ca.nlpsol("sequence", "ipopt", program, options)(
            x0=np.concatenate(self.guess),
            lbx=np.concatenate(self.lower),
            ubx=np.concatenate(self.upper),
            lbg=np.concatenate([np.full(below.numel(), -np.inf), np.zeros(zero.numel())]),
            ubg=0.0,
        )
        values = np.array(solution["x"]).ravel()
        return values if np.isfinite(values).all() else None

    def numbers(self, expressions: list[Any], values: FloatArray) -> FloatArray:
        """Returns what expressions come to [as theirs], one after the other, for values of the unknowns."""
        asked = ca.vertcat(*(ca.SX(expression) for expression in expressions))
        read = ca.Function("read", [ca.vertcat(*self.unknown)], [asked])
        return np.array(read(values)).ravel()
