"""Six-axis arms with closed-form inverse kinematics: branches, and turns within limits."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Self

import numpy as np

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.continuation import CONTINUATION, Course, FlangeLines, LineFollowing
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import INVERSE, polished
from dualarm_cli.kinematics.posture_source import PROVEN_MISS, Enclosure, ReachedPostures
from dualarm_cli.kinematics.serial_chain import LEAST_JOINTS, pose_error
from dualarm_cli.kinematics.srs import srs_limits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ClosedArmSettings:
    """Tolerances and branches of arms with a closed form."""

    exact: float = 1e-12
    """Deviation from the family below which no polish is needed [m, rad].

    It is the deviation of a geometry from its family.
    """
    branches: int = 8
    """Maximum number of postures of a pose, modulo whole turns."""
    singular: float = 1e-4
    """Singular value of the normalised Jacobian below which postures are unknown."""
    max_turns: int = 3
    """Number of turns within limits from which a joint may be anywhere."""
    spread: int = 8
    """Number of samples of a free joint."""
    aligned: float = 1e-12
    """Sine of the angle of a wrist's outer axes below which they are aligned."""
    slack: float = 1e-12
    """Rounding tolerance of a wrist's angle [rad]."""
    least_angle: float = 1e-6
    """Least sine of the angle of neighbouring wrist axes."""


CLOSED = ClosedArmSettings()


@dataclass(frozen=True)
class PoseSolutions:
    """Postures of flange poses, all branches."""

    q: FloatArray
    """Joints [rad] in (-pi, pi], shape (..., 8, 6), zeros out of reach."""
    reachable: BoolArray
    """Flags of branches that reach the pose, without joint limits, shape (..., 8)."""
    singular: BoolArray
    """Flags of postures with a free joint at its reference, shape (..., 8)."""


@dataclass(frozen=True)
class ClosedArm(GeneralArm):
    """Six-axis arm with up to eight postures of a pose in closed form."""

    solves_by_search = False

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            UnsupportedError: the arm does not have six revolute axes of this family.
        """
        super().__post_init__()
        if self.axes != LEAST_JOINTS:
            problem = f"it has {self.axes} axes instead of {LEAST_JOINTS}"
        elif self.slides:
            problem = f"joint {self.slides[0] + 1} slides"
        else:
            problem = self._problem()
        if problem:
            raise UnsupportedError(
                f"there are no closed forms for this arm: {problem}; use numeric inverse kinematics"
            )

    @classmethod
    def of(cls, arm: GeneralArm) -> Self:
        """Create the closed forms of an arm.

        Args:
            arm: a six-axis arm of this family.

        Raises:
            UnsupportedError: the arm is not of this family.
        """
        return cls(*(getattr(arm, field.name) for field in fields(GeneralArm)))

    @abstractmethod
    def _problem(self) -> str:
        """Explain why the axes have no closed forms of this family, or return ''."""

    @property
    @abstractmethod
    def exact(self) -> bool:
        """Flag of closed forms that need no polish."""

    @abstractmethod
    def _postures(self, R: FloatArray, p: FloatArray, reference: FloatArray) -> PoseSolutions:
        """Compute all branches before polishing; out of reach joints are arbitrary.

        Args:
            R: flange rotations in the frame that carries the arm, shape (b, 3, 3).
            p: flange positions [m], shape (b, 3).
            reference: values of free joints [rad], shape (b, 6).
        """

    @abstractmethod
    def _miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the miss of poses without posture, distance [m] and angle [rad], (b, 2)."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """Solver and number of branches, as `dualarm robot` has them."""
        return {"inverse_kinematics": "closed_form", "branches": CLOSED.branches}

    def solve(
        self, R: FloatArray, p: FloatArray, reference: FloatArray | None = None
    ) -> PoseSolutions:
        """Solve for all eight branches of flange poses.

        Args:
            R: flange rotations in the frame that carries the arm, shape (..., 3, 3).
            p: flange positions [m], shape (..., 3), broadcast against R.
            reference: values of free joints [rad], shape (..., 6), broadcast with the poses; None takes the middle of
                the limits.
        """
        R, p = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
        free = self.middle if reference is None else np.asarray(reference, dtype=np.float64)
        shape = np.broadcast_shapes(R.shape[:-2], p.shape[:-1], free.shape[:-1])
        R = np.broadcast_to(R, (*shape, 3, 3)).reshape(-1, 3, 3)
        p = np.broadcast_to(p, (*shape, 3)).reshape(-1, 3)
        free = np.broadcast_to(free, (*shape, 6)).reshape(-1, 6)
        solutions = self._postures(R, p, free)
        reachable = solutions.reachable
        q = np.where(reachable[..., None], solutions.q, 0.0)
        if not self.exact:
            q, reachable = self._polish(q, reachable, R, p)
        return PoseSolutions(
            q.reshape(*shape, CLOSED.branches, 6),
            reachable.reshape(*shape, CLOSED.branches),
            (solutions.singular & reachable).reshape(*shape, CLOSED.branches),
        )

    def _polish(
        self, q: FloatArray, reachable: BoolArray, R: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Polish postures (b, 8, 6) by Newton steps, and drop misses.

        A miss does not reach its pose.

        Right at a singularity rounding decides whether a posture exists.
        """
        row, branch = np.nonzero(reachable)
        joints = q[row, branch]
        R_now, p_now = self.forward(joints)
        error = np.abs(pose_error(R_now, p_now, R[row], p[row])).max(axis=1)
        inexact = np.flatnonzero(error > CLOSED.exact)
        if not len(inexact):
            return q, reachable
        row, branch = row[inexact], branch[inexact]
        better, error_left = polished(self.without_limits, R[row], p[row], joints[inexact])
        met = np.asarray((error_left <= INVERSE.residual).all(axis=1))
        polished_q, reached = q.copy(), reachable.copy()
        polished_q[row, branch] = np.where(met[:, None], srs_limits.wrap(better), 0.0)
        reached[row, branch] = met
        return polished_q, reached

    def branch(self, q: FloatArray) -> IntArray:
        """Find the branch of postures (..., 6), shape (...)."""
        q = np.asarray(q, dtype=np.float64)
        solutions = self.solve(*self.forward(q), reference=q)
        distance = np.abs(srs_limits.wrap(solutions.q - q[..., None, :])).max(axis=-1)
        return np.asarray(
            np.where(solutions.reachable, distance, np.inf).argmin(axis=-1), dtype=np.int64
        )

    def postures(
        self, R: FloatArray, p: FloatArray, *, first_only: bool = False, thorough: bool = True
    ) -> ReachedPostures:
        """Compute all postures within limits that reach poses, with samples of free joints.

        Poses beyond reach have a measured miss only in a thorough search; it takes longer than the postures.
        """
        solutions = self.solve(R, p)
        q = self.nearest_turns(solutions.q, self.middle)
        is_valid = solutions.reachable & self.within_limits(q)
        pose, branch = np.nonzero(is_valid)
        parts = [(pose, branch, q[pose, branch])]
        free = np.flatnonzero(solutions.singular.any(axis=1))
        if len(free):
            parts.append(self._spread(R[free], p[free], free))
        pose, branch, joints = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.lexsort((branch, pose))
        miss = np.zeros((len(p), 2))
        missed = np.flatnonzero(np.bincount(pose, minlength=len(p)) == 0)
        if thorough and len(missed):
            miss[missed] = self._miss(R[missed], p[missed])
        return ReachedPostures(pose[order], joints[order], branch[order], miss)

    def follow_lines(
        self,
        start: FloatArray,
        lines: FlangeLines,
        drift: FloatArray,
        samples: int,
        skeleton: int = CONTINUATION.skeleton,
    ) -> Course:
        """Follow flanges along straight lines on the branches of all samples."""
        postures = self.solve(lines.R, lines.positions(samples), start)
        following = LineFollowing.of(self, start, lines, drift)
        return following.by_branches(postures.q, postures.reachable)

    def enclosure(
        self, R: FloatArray, p: FloatArray, slack: float, free_last: bool
    ) -> Enclosure | None:
        """Compute boxes about all postures of a pose, or None near a singularity."""
        postures = self.solve(R, p)
        branch = np.flatnonzero(postures.reachable)
        q = postures.q[branch]
        if not len(q) or postures.singular.any():
            return None
        J = self.jacobian(q)
        J[:, :3] /= self.length
        if singular_values(J)[:, -1].min() < CLOSED.singular:
            return None
        low, high = q - slack, q + slack
        for joint in range(self.axes):
            bottom, top = self.lower[joint], self.upper[joint]
            wide = not top - bottom < CLOSED.max_turns * TURN
            if wide or (free_last and joint == self.axes - 1):
                low[:, joint], high[:, joint] = bottom, top
                continue
            first = np.ceil((bottom - high[:, joint]) / TURN)
            count = (np.floor((top - low[:, joint]) / TURN) - first + 1).astype(np.int64)
            rows = np.repeat(np.arange(len(low)), np.maximum(count, 0))
            place = np.arange(len(rows)) - np.searchsorted(rows, rows)
            branch, low, high = branch[rows], low[rows], high[rows]
            shift = TURN * (first[rows] + place)
            low[:, joint] += shift
            high[:, joint] += shift
        return (branch, low, high) if len(low) else None

    def proven_miss(self, R: FloatArray, p: FloatArray) -> tuple[float, float] | None:
        """Compute the least miss of poses, or None if reached or singular."""
        # Of a free joint only samples are known, which prove nothing.
        if self.solve(R, p).singular.any():
            return None
        miss = self.postures(R, p).miss
        distance, angle = miss[int(np.argmin(miss.sum(axis=1)))].tolist()
        return (distance, angle) if distance + angle > PROVEN_MISS else None

    def _spread(
        self, R: FloatArray, p: FloatArray, pose: IntArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Sample postures with free joints over their limits: poses, branches, joints."""
        low = np.maximum(self.lower, self.middle - np.pi)
        high = np.minimum(self.upper, self.middle + np.pi)
        fraction = ((np.arange(CLOSED.spread) + 0.5) / CLOSED.spread)[:, None, None]
        solutions = self.solve(R, p, low + fraction * (high - low))
        q = self.nearest_turns(solutions.q, self.middle)
        is_valid: BoolArray = np.logical_and(solutions.singular, self.within_limits(q))
        _, row, branch = np.nonzero(is_valid)
        return pose[row], branch, q[is_valid]

    def _clipped_miss(
        self, q: FloatArray, candidates: BoolArray, R: FloatArray, p: FloatArray
    ) -> FloatArray:
        """Compute the least miss of clipped branches (b, 8, 6), shape (b, 2).

        Branches are clipped to their limits.
        """
        R_now, p_now = self.forward(np.clip(q, self.lower, self.upper))
        e = pose_error(R_now, p_now, R[:, None], p[:, None])
        error = np.stack([norm(e[..., :3], axis=-1), norm(e[..., 3:], axis=-1)], axis=-1)
        best = np.where(candidates, error.sum(axis=-1), np.inf).argmin(axis=1)
        return np.asarray(error[np.arange(len(p)), best])


def with_closed_forms(family: type[ClosedArm], arm: GeneralArm) -> GeneralArm:
    """Give an arm the closed forms of a family if it has them.

    Args:
        family: family of closed forms.
        arm: any arm.
    """
    try:
        return family.of(arm)
    except UnsupportedError:
        return arm
