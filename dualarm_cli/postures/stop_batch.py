"""Stops of one arm in arrays: many problems that are solved by the same numpy calls."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.general_arm import GeneralArm, numeric_form
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs_arm import SrsArm, closed_form
from dualarm_cli.postures.problem import StopProblem
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ToolPoses:
    """Targets turned by yaws, as k flange poses."""

    row: IntArray
    """Which problem each belongs to, shape (k,)."""
    R: FloatArray
    """Flange rotations in the arm's base frame, shape (k, 3, 3)."""
    p: FloatArray
    """Flange positions [m], shape (k, 3)."""
    z: FloatArray
    """Directions of the tool, shape (k, 3)."""

    def take(self, index: IntArray) -> ToolPoses:
        """Returns some of the poses, in the order of the index."""
        return ToolPoses(self.row[index], self.R[index], self.p[index], self.z[index])


@dataclass(frozen=True)
class StopBatch:
    """b problems of one kind: same arm and limits, all with or all without lines, free yaw, given configurations."""

    problems: tuple[StopProblem, ...]
    """The problems, at least one."""

    @property
    def arm(self) -> SrsArm:
        """The arm of them all, where it has closed forms.

        Raises:
            UnsupportedError: it has none.
        """
        return closed_form(self.problems[0].arm)

    @property
    def numeric_arm(self) -> GeneralArm:
        """The arm of them all, where postures are solved for without an arm angle.

        Raises:
            UnsupportedError: it was measured in closed form over the arm angle.
        """
        return numeric_form(self.problems[0].arm)

    @property
    def free_yaw(self) -> bool:
        """Whether yaws between the tried ones will do as well."""
        return self.problems[0].free_yaw

    @property
    def refine(self) -> bool:
        """Whether postures are refined between the grid's arm angles."""
        return self.problems[0].refine

    @property
    def given(self) -> bool:
        """Whether the targets are configurations."""
        return self.problems[0].configurations is not None

    @cached_property
    def start(self) -> FloatArray:
        """Joints before [rad], shape (b, 7)."""
        return np.array([problem.start for problem in self.problems])

    @cached_property
    def waiting(self) -> FloatArray:
        """Time that each transfer takes in any case [s], shape (b,)."""
        return np.array([problem.waiting for problem in self.problems])

    @cached_property
    def length(self) -> FloatArray:
        """Lengths of approach and retract [m], shape (b, 2)."""
        return np.array([(problem.approach, problem.retract) for problem in self.problems])

    @cached_property
    def _first(self) -> IntArray:
        """Number of each problem's first target among all, shape (b,)."""
        counts = [len(problem.p_base_tool) for problem in self.problems]
        return np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.int64)

    @cached_property
    def _targets(self) -> tuple[FloatArray, FloatArray]:
        """Rotations and positions of the tool at all targets of all problems."""
        R = np.concatenate([problem.R_base_tool for problem in self.problems])
        p = np.concatenate([problem.p_base_tool for problem in self.problems])
        return R, p

    @cached_property
    def _configurations(self) -> FloatArray:
        """All given configurations of all problems [rad]."""
        given = [problem.configurations for problem in self.problems]
        return np.concatenate([q for q in given if q is not None])

    def configurations(self, row: IntArray, target: IntArray) -> FloatArray:
        """Returns given configurations [rad], shape (k, 7), of problems (k,) and their targets (k,)."""
        return self._configurations[self._first[row] + target]

    def poses(self, row: IntArray, target: IntArray, yaw: FloatArray) -> ToolPoses:
        """Returns targets turned by yaws.

        Args:
            row: problems, shape (k,).
            target: which of each problem's targets, shape (k,).
            yaw: turns about the tool's z axis [rad], shape (k,).
        """
        R_nominal, p_nominal = self._targets
        one, index = self.problems[0], self._first[row] + target
        R_tool = product(R_nominal[index], rotation_z(yaw))
        p = p_nominal[index] + product(R_tool, one.p_tool_flange)
        return ToolPoses(row, product(R_tool, one.R_tool_flange), p, R_tool[..., :, 2])

    def turned_targets(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Returns problem, target and yaw of every target of every problem under every yaw."""
        owner, target, yaw = [], [], []
        for row, problem in enumerate(self.problems):
            targets = len(problem.p_base_tool)
            owner.append(np.full(targets * len(problem.yaw), row, dtype=np.int64))
            target.append(np.repeat(np.arange(targets, dtype=np.int64), len(problem.yaw)))
            yaw.append(np.tile(problem.yaw, targets))
        return np.concatenate(owner), np.concatenate(target), np.concatenate(yaw)

    def take(self, rows: Sequence[int]) -> StopBatch:
        """Returns the batch of some of the problems."""
        return StopBatch(tuple(self.problems[row] for row in rows))


def batches(problems: Sequence[StopProblem]) -> list[tuple[IntArray, StopBatch]]:
    """Returns the problems by kind: their numbers in the given order, and a batch of each kind."""
    kinds: list[list[int]] = []
    for k, problem in enumerate(problems):
        for kind in kinds:
            if _alike(problems[kind[0]], problem):
                kind.append(k)
                break
        else:
            kinds.append([k])
    return [(np.array(kind), StopBatch(tuple(problems[k] for k in kind))) for kind in kinds]


def _alike(one: StopProblem, other: StopProblem) -> bool:
    """Returns whether two problems can be rows of one batch."""
    return (
        one.arm is other.arm
        and one.joint_times == other.joint_times
        and one.line_time == other.line_time
        and one.free_yaw == other.free_yaw
        and one.refine == other.refine
        and (one.configurations is None) == (other.configurations is None)
        and (one.approach + one.retract > 0.0) == (other.approach + other.retract > 0.0)
        and np.array_equal(one.R_tool_flange, other.R_tool_flange)
        and np.array_equal(one.p_tool_flange, other.p_tool_flange)
    )
