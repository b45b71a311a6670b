"""Arms without closed forms: numeric inverse kinematics, and proofs of reach."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.continuation import (
    CONTINUATION,
    Course,
    FlangeLines,
    LineFollowing,
    PointFollowing,
    moved_along,
)
from dualarm_cli.kinematics.numeric_inverse import least_distances, solve_poses
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.posture_source import Posture, PostureSource, ReachedPostures, ToolPose
from dualarm_cli.kinematics.serial_chain import SerialChain
from dualarm_cli.records import dataclass

CIRCLE_STEP = np.radians(6.0)
"""Spacing of points examined on the circle about the last axis [rad]."""
LINE_SAMPLES = 17
"""Samples of the line from a posture's pose to the start of a path."""
CANDIDATES = 6
"""Number of poses whose least distance is searched.

They are chosen by miss, and by distance from axis 1.
"""


@dataclass(frozen=True)
class GeneralArm(SerialChain, PostureSource):
    """An arm of n >= 6 joints without closed forms, in the frame that carries it."""

    reach_step = np.radians(10.0)
    solves_by_search = True

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts about closed forms, as `dualarm robot` has them: none."""
        return {}

    def postures(
        self, R: FloatArray, p: FloatArray, *, first_only: bool = False, thorough: bool = True
    ) -> ReachedPostures:
        """Solve for postures within limits that reach flange poses, see `solve_poses`.

        Args:
            R: flange rotations in the carried frame, shape (m, 3, 3).
            p: flange positions [m], shape (m, 3).
            first_only: whether the search of a pose ends with its first solution.
            thorough: whether many solutions are searched, or few.
        """
        return solve_poses(self, R, p, first_only=first_only, thorough=thorough)

    def follow_lines(
        self,
        start: FloatArray,
        lines: FlangeLines,
        drift: FloatArray,
        samples: int,
        skeleton: int = CONTINUATION.skeleton,
    ) -> Course:
        """Follow straight flange lines without rotation, see `LineFollowing`.

        Args:
            start: joints at the start of the lines [rad], shape (b, n).
            lines: lines of the flanges.
            drift: distance along the self-motion [rad], shape (b,); without effect if no joint is redundant.
            samples: number of equidistant samples.
            skeleton: largest number that is solved in sequence; the others are interpolated first.
        """
        return LineFollowing.of(self, start, lines, drift).by_newton(samples, skeleton)

    def neighbour(self, posture: Posture, R: FloatArray, p: FloatArray) -> FloatArray | None:
        """Solve for the joints next to a posture that reach a pose by Newton's method."""
        q, met = moved_along(self, posture.q[None], R[None], p[None], np.zeros(1))
        return q[0] if met[0] else None

    def follow_line(
        self, posture: Posture, pose: ToolPose, length: float, psi_end: float, samples: int
    ) -> FloatArray:
        """Follow a straight tool line by continuation; `psi_end` is along the self-motion."""
        # Continuity is checked at `skeleton` samples or more: the path is the same for any number of samples.
        finer = -(-(CONTINUATION.skeleton - 1) // (samples - 1))
        R, p, outward = (x[None] for x in pose)
        lines, drift = FlangeLines(R, p, outward * length), np.array([psi_end])
        course = self.follow_lines(posture.q[None], lines, drift, finer * (samples - 1) + 1)
        return course.q[::finer, 0]

    def follow_points(
        self, posture: Posture, R: FloatArray, p: FloatArray, drift: FloatArray, target: int
    ) -> tuple[FloatArray, bool]:
        """Follow flange poses of one rotation by continuation, from the target to both ends."""
        R_near, p_near = self.forward(posture.q[None])
        line = FlangeLines(R_near, p_near, p[target] - p_near)
        course = self.follow_lines(posture.q[None], line, np.zeros(1), LINE_SAMPLES)
        path, ok = PointFollowing.through(self, course.q[-1], R, p[target])
        ok &= bool(course.ok[0])
        q = np.empty((len(p), self.axes))
        for rows in (np.arange(target, len(p)), np.arange(target, -1, -1)):
            q[rows], followed = path.outward(p[rows], drift[rows])
            ok &= followed
        return q, ok

    def reached(self, R: FloatArray, p: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Flag poses that a posture within limits reaches, and measure the others' miss.

        The miss is the least distance found with the required rotation. If no pose is reached, it is searched for at
        the nearest candidates only, and infinite elsewhere.
        """
        R = np.broadcast_to(R, (*p.shape[:-1], 3, 3))
        flat_R, flat_p = R.reshape(-1, 3, 3), p.reshape(-1, 3)
        postures = self.postures(flat_R, flat_p, first_only=True)
        feasible = (postures.miss == 0.0).all(axis=1)
        miss = np.where(feasible, 0.0, postures.miss.sum(axis=1))
        if not feasible.any():
            far = norm(flat_p - self.p_parent_joint[0], axis=1)
            by_miss, by_distance = (np.argsort(x, kind="stable")[:CANDIDATES] for x in (miss, far))
            nearest = np.unique([*by_miss, *by_distance])
            miss = np.full(len(flat_p), np.inf)
            miss[nearest] = least_distances(self, flat_R[nearest], flat_p[nearest])
        return feasible.reshape(p.shape[:-1]), miss.reshape(p.shape[:-1])

    def why_missed(self, miss: float) -> str:
        """Return the refusal key of a miss [m], infinite without a met rotation."""
        return "flange_not_there" if np.isfinite(miss) else "point_not_turned"

    def fixed_point(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the last joint's origin [m], shape (..., 3), which that joint does not move."""
        R_last = product(R, self.R_last_flange.T)
        return np.asarray(p - product(R_last, self.p_last_flange))

    @property
    def lever(self) -> float:
        """Distance of the joint before the last one from the last [m]."""
        return float(norm(self.p_parent_joint[-1]))

    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the proven least distance of the last joint's origin beyond reach [m], shape (...).

        It is no farther from the first joint than all links together. The joint before it is on a circle about the last
        axis, the second joint on one about the first axis.
        """
        point = self.fixed_point(R, p)
        links = norm(self.p_parent_joint, axis=1)
        slides = list(self.slides)
        travel = np.maximum(np.abs(self.lower[slides]), np.abs(self.upper[slides])).sum()
        distance = norm(point - self.p_parent_joint[0], axis=-1) - links[1:].sum() - travel
        last = len(links) - 1
        if not {0, last} & set(slides):
            low, high = self._arc(last)
            angles = np.linspace(low, high, 2 + int((high - low) / CIRCLE_STEP))
            link = product(self.R_parent_joint[last].T, self.p_parent_joint[last])
            turned = product(rotation_z(-angles), link)
            R_last = product(R, self.R_last_flange.T)
            before = point[..., None, :] - np.einsum("...ij,gj->...gi", R_last, turned)
            step = 0.5 * (angles[1] - angles[0]) * float(norm(link[:2]))
            nearest = self._distance_to_second(before).min(axis=-1) - step
            distance = np.maximum(distance, nearest - links[2:last].sum() - travel)
        return np.maximum(0.0, distance)

    def _distance_to_second(self, point: FloatArray) -> FloatArray:
        """Compute the distance of points (..., 3) from the second joint's arc [m]."""
        v = product(point - self.p_parent_joint[0], self.R_parent_joint[0])
        x, y, z = self.p_parent_joint[1].tolist()
        low, high = self._arc(0)
        angle_off = arctan2(v[..., 1], v[..., 0]) - float(arctan2(y, x)) - 0.5 * (low + high)
        angle_off = np.abs(angle_off - TURN * np.round(angle_off / TURN))
        bend = np.maximum(0.0, angle_off - 0.5 * (high - low))
        radius, radial = float(norm(np.array([x, y]))), norm(v[..., :2], axis=-1)
        along = radial - radius * cos(bend)
        squared = np.square(along) + np.square(radius * sin(bend)) + np.square(v[..., 2] - z)
        return np.asarray(np.sqrt(squared))

    def _arc(self, joint: int) -> tuple[float, float]:
        """Return a joint's limits [rad], at most one whole turn."""
        low, high = float(self.lower[joint]), float(self.upper[joint])
        return (low, high) if high - low < TURN else (-np.pi, np.pi)


def numeric_form(arm: PostureSource) -> GeneralArm:
    """Return an arm with numeric inverse kinematics, without an arm angle.

    Raises:
        UnsupportedError: the arm is modelled in closed form over the arm angle.
    """
    if not isinstance(arm, GeneralArm):
        raise UnsupportedError(
            "numeric inverse kinematics needs an arm modelled as a general arm, not in closed form"
        )
    return arm
