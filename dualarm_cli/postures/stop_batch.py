"""Batches of similar stops of one arm, solved by the same numpy calls."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.rotations import outward
from dualarm_cli.kinematics.general_arm import GeneralArm, numeric_form
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs_arm import SrsArm, closed_form
from dualarm_cli.postures.problem import StopProblem
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ToolPoses:
    """Flange poses of targets turned by yaws, k of them."""

    row: IntArray
    """Numbers of the problems, shape (k,)."""
    R: FloatArray
    """Flange rotations in the arm's base frame, shape (k, 3, 3)."""
    p: FloatArray
    """Flange positions [m], shape (k, 3)."""
    outward: FloatArray
    """Directions from the targets to the outer ends of approach and retract, shape (k, 2, 3)."""

    def take(self, index: IntArray) -> ToolPoses:
        """Select poses, in the order of the index."""
        return ToolPoses(self.row[index], self.R[index], self.p[index], self.outward[index])


@dataclass(frozen=True)
class StopBatch:
    """Batch of b problems with the same arm, limits and kinds of targets and lines."""

    problems: tuple[StopProblem, ...]
    """The problems, at least one."""

    @property
    def arm(self) -> SrsArm:
        """Common arm with closed forms.

        Raises:
            UnsupportedError: the arm has none.
        """
        return closed_form(self.problems[0].arm)

    @property
    def numeric_arm(self) -> GeneralArm:
        """Common arm without an arm angle.

        Raises:
            UnsupportedError: the arm is modelled in closed form over the arm angle.
        """
        return numeric_form(self.problems[0].arm)

    @property
    def free_yaw(self) -> bool:
        """Flag of free yaws."""
        return self.problems[0].free_yaw

    @property
    def refine(self) -> bool:
        """Flag of postures that are refined between the grid's arm angles."""
        return self.problems[0].refine

    @property
    def given(self) -> bool:
        """Flag of targets that are configurations."""
        return self.problems[0].configurations is not None

    @cached_property
    def start(self) -> FloatArray:
        """Joints before the transfers [rad], shape (b, 7)."""
        return np.array([problem.start for problem in self.problems])

    @cached_property
    def waiting(self) -> FloatArray:
        """Minimum times of the transfers [s], shape (b,)."""
        return np.array([problem.waiting for problem in self.problems])

    @cached_property
    def length(self) -> FloatArray:
        """Lengths of approach and retract [m], shape (b, 2)."""
        return np.array([(problem.approach, problem.retract) for problem in self.problems])

    @cached_property
    def directions(self) -> FloatArray:
        """Directions of lines outward, `StopProblem.directions`, shape (b, 2, 2, 3)."""
        return np.array([problem.directions for problem in self.problems])

    @property
    def alike_lines(self) -> bool:
        """Flag of approaches and retracts that are the same lines."""
        both = self.length, np.moveaxis(self.directions, 2, 1)
        return all(np.array_equal(line[:, 0], line[:, 1]) for line in both)

    @cached_property
    def _first(self) -> IntArray:
        """Number of each problem's first target among all, shape (b,)."""
        counts = [len(problem.p_base_tool) for problem in self.problems]
        return np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.int64)

    @cached_property
    def _targets(self) -> tuple[FloatArray, FloatArray]:
        """Rotations and positions of the tool at the targets of every problem."""
        R = np.concatenate([problem.R_base_tool for problem in self.problems])
        p = np.concatenate([problem.p_base_tool for problem in self.problems])
        return R, p

    @cached_property
    def _configurations(self) -> FloatArray:
        """Given configurations of every problem [rad]."""
        given = [problem.configurations for problem in self.problems]
        return np.concatenate([q for q in given if q is not None])

    def configurations(self, row: IntArray, target: IntArray) -> FloatArray:
        """Return the configurations [rad], (k, 7), of problems (k,) and targets (k,)."""
        return self._configurations[self._first[row] + target]

    def poses(self, row: IntArray, target: IntArray, yaw: FloatArray) -> ToolPoses:
        """Compute flange poses of targets turned by yaws.

        Args:
            row: numbers of the problems, shape (k,).
            target: numbers of the problems' targets, shape (k,).
            yaw: turns about the tool's z axis [rad], shape (k,).
        """
        R_nominal, p_nominal = self._targets
        first, index = self.problems[0], self._first[row] + target
        R_tool = product(R_nominal[index], rotation_z(yaw))
        p = p_nominal[index] + product(R_tool, first.p_tool_flange)
        away = outward(self.directions[row], R_tool, np.eye(3))
        return ToolPoses(row, product(R_tool, first.R_tool_flange), p, away)

    def turned_targets(self) -> tuple[IntArray, IntArray, FloatArray]:
        """List problem, target and yaw of every target of every problem at every yaw."""
        owner, target, yaw = [], [], []
        for row, problem in enumerate(self.problems):
            targets = len(problem.p_base_tool)
            owner.append(np.full(targets * len(problem.yaw), row, dtype=np.int64))
            target.append(np.repeat(np.arange(targets, dtype=np.int64), len(problem.yaw)))
            yaw.append(np.tile(problem.yaw, targets))
        return np.concatenate(owner), np.concatenate(target), np.concatenate(yaw)

    def take(self, rows: Sequence[int]) -> StopBatch:
        """Select problems of the batch."""
        return StopBatch(tuple(self.problems[row] for row in rows))


def batches(problems: Sequence[StopProblem]) -> list[tuple[IntArray, StopBatch]]:
    """Split problems into batches, each with the numbers of its problems."""
    kinds: list[list[int]] = []
    for k, problem in enumerate(problems):
        for kind in kinds:
            if _alike(problems[kind[0]], problem):
                kind.append(k)
                break
        else:
            kinds.append([k])
    return [(np.array(kind), StopBatch(tuple(problems[k] for k in kind))) for kind in kinds]


def _alike(first: StopProblem, second: StopProblem) -> bool:
    """Return whether two problems can be rows of one batch."""
    return (
        first.arm is second.arm
        and first.joint_times == second.joint_times
        and first.line_time == second.line_time
        and first.free_yaw == second.free_yaw
        and first.refine == second.refine
        and (first.configurations is None) == (second.configurations is None)
        and (first.approach + first.retract > 0.0) == (second.approach + second.retract > 0.0)
        and np.array_equal(first.R_tool_flange, second.R_tool_flange)
        and np.array_equal(first.p_tool_flange, second.p_tool_flange)
    )
