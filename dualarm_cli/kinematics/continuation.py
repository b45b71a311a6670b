"""Continuation of general arms along lines of the flange, and to postures next to others."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.linear_systems import determinant, null_space, solve
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.numeric_inverse import INVERSE
from dualarm_cli.kinematics.posture_source import LARGEST_STEP
from dualarm_cli.kinematics.serial_chain import SerialChain, pose_error
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ContinuationSettings:
    """Settings of the following of lines."""

    newton_steps: int = 6
    """Maximum number of Newton steps for a sample of a line."""
    bend: float = 0.6
    """Largest deviation from the extrapolated sample, as a fraction of the step."""
    bend_slack: float = 0.02
    """Constant part of the largest deviation from the extrapolated sample [rad]. It adds to `bend`.

    A larger deviation
    is a jump."""
    least_pivot: float = 1e-5
    """Determinant below which a posture is singular [m and rad]."""
    points_in_sequence: int = 16
    """Maximum number of poses solved in sequence.

    The others are interpolated and solved at once.
    """
    skeleton: int = 17
    """Maximum number of samples solved in sequence; further ones are solved at once."""


CONTINUATION = ContinuationSettings()


@dataclass(frozen=True)
class Crossing:
    """Settings for lines straight through singularities."""

    miss: float = 1e-6
    """Largest error of a posture [m and rad], 2 % of the tolerance."""
    damping: float = 1e-3
    """Damping of steps near singularities [m and rad]."""
    false_positions: int = 8
    """Steps of false position to a singularity between two samples."""
    left: float = 1e-6
    """Fraction of the determinant's change below which a singularity is located."""


CROSSING = Crossing()


def spare_directions(arm: SerialChain, q: FloatArray) -> FloatArray:
    """Compute orthonormal directions of self-motion, shape (b, s, n), s redundant joints.

    The sign is such that the largest component is positive.

    Args:
        arm: the arm.
        q: joints [rad], shape (b, n).
    """
    if not arm.spare:
        return np.empty((len(q), 0, arm.axes))
    W = null_space(arm.jacobian(q))
    largest = np.take_along_axis(W, np.abs(W).argmax(axis=2)[..., None], axis=2)
    return W * np.where(largest < 0.0, -1.0, 1.0)


@dataclass(frozen=True)
class JointPlanes:
    """Planes W q = level through the joint space, which fix the self-motion of b postures."""

    W: FloatArray
    """Directions of self-motion, shape (b, s, n)."""
    level: FloatArray
    """Values of W q on the planes, shape (b, s)."""

    @classmethod
    def through(cls, W: FloatArray, q: FloatArray) -> JointPlanes:
        """Put a plane through each posture, shape (b, n)."""
        return cls(W, np.einsum("bsn,bn->bs", W, q))


@dataclass(frozen=True)
class Course:
    """Joint paths of b postures, with feasibility."""

    q: FloatArray
    """Joints at the samples [rad], the start first, shape (s, b, n)."""
    ok: BoolArray
    """Flags of paths that are feasible at every sample, shape (b,)."""
    singular: BoolArray
    """Flags of lines that only a singularity blocks, shape (b,)."""


@dataclass(frozen=True)
class FlangeLines:
    """Straight lines of b flanges that do not turn."""

    R: FloatArray
    """Flange rotations, shape (b, 3, 3)."""
    p: FloatArray
    """Flange positions at the beginning [m], shape (b, 3)."""
    shift: FloatArray
    """Vectors from start to end of the lines [m], shape (b, 3)."""

    def positions(self, samples: int) -> FloatArray:
        """Return flange positions at equidistant samples [m], shape (samples, b, 3)."""
        return self.p + np.linspace(0.0, 1.0, samples)[:, None, None] * self.shift


@dataclass(frozen=True)
class LineFollowing:
    """Following of b straight flange lines without rotation, from given postures.

    With redundant joints the flange's pose at a fraction u of the line leaves the self-motion open. Planes decide it:
    W (q(u) - q(0)) = (u drift, 0, ...), W the directions of self-motion at the start. So joints depend on the start
    alone, not on the sampling of the line; drift [rad] is the distance along the self-motion over the whole line, as
    the change of the arm angle is for an SRS arm. Our own derivation.

    Continuity is checked: a line is dropped if Newton's method from the extrapolated sample does not converge, if its
    result is far from that in relation to the step, if the determinant of the system changes its sign or nearly
    vanishes (a singularity), or if a limit is passed. An arm with closed forms takes the posture next to the
    extrapolated sample in place of Newton's method. A line that only a singularity blocks is followed straight through
    it if possible (`_crossed`).
    """

    arm: SerialChain
    """Kinematics and limits."""
    start: FloatArray
    """Joints at the start of the lines [rad], shape (b, n)."""
    lines: FlangeLines
    """Lines of the flanges."""
    W: FloatArray
    """Directions of self-motion at the start, shape (b, s, n)."""
    ahead: FloatArray
    """Coordinates along the directions at the ends of the lines [rad], shape (b, s)."""

    @classmethod
    def of(
        cls, arm: SerialChain, start: FloatArray, lines: FlangeLines, drift: FloatArray
    ) -> LineFollowing:
        """Prepare the following of lines.

        Args:
            arm: kinematics and limits.
            start: joints at the start of the lines [rad], shape (b, n).
            lines: lines of the flanges.
            drift: distance along the self-motion [rad], shape (b,); without effect if no joint is redundant.
        """
        ahead = np.zeros((len(start), arm.spare))
        ahead[:, :1] = drift[:, None]
        return cls(arm, start, lines, spare_directions(arm, start), ahead)

    def by_newton(self, samples: int, skeleton: int) -> Course:
        """Follow the lines by Newton's method at equidistant shares.

        Args:
            samples: number of samples.
            skeleton: largest number that is solved in sequence; the others are interpolated first.
        """
        course = self._solve_in_sequence(min(samples, skeleton))
        if samples > skeleton:
            course = self._refine_samples(course, samples)
        return self._crossed(course)

    def by_branches(self, postures: FloatArray, reachable: BoolArray) -> Course:
        """Follow the lines on given postures, the nearest to each extrapolated sample.

        Args:
            postures: at equidistant samples [rad], shape (samples, b, k, n).
            reachable: flags of postures that exist, shape (samples, b, k).
        """
        arm, samples = self.arm, len(postures)
        q = np.empty((samples, *self.start.shape))
        q[0] = self.start
        ok, sign = self._start_state()
        every = np.arange(len(ok))
        for k in range(1, samples):
            guess = 2.0 * q[k - 1] - q[k - 2] if k > 1 else q[0]
            off = arm.less_turns(postures[k] - guess[:, None])
            distance = np.where(reachable[k], np.abs(off).max(axis=2), np.inf)
            best = distance.argmin(axis=1)
            joints = guess + off[every, best]
            step = np.abs(joints - q[k - 1]).max(axis=1)
            ok &= (step <= LARGEST_STEP) & np.isfinite(distance[every, best])
            if k > 1:
                ok &= distance[every, best] <= CONTINUATION.bend * step + CONTINUATION.bend_slack
            q[k] = np.where(ok[:, None], joints, q[k - 1])
        _, _, J = arm.linearised(q[1:].reshape(-1, arm.axes))
        det = determinant(J).reshape(samples - 1, -1)
        same = _same_side(det, sign).all(axis=0)
        ok &= arm.within_limits(q).all(axis=0)
        return self._crossed(Course(q, ok & same, ok & ~same))

    def _solve_in_sequence(self, samples: int) -> Course:
        """Solve for the joints sample by sample, starting from extrapolated guesses."""
        q = np.empty((samples, *self.start.shape))
        q[0] = self.start
        ok, sign = self._start_state()
        singular, every = np.zeros_like(ok), np.arange(len(ok))
        for k, progress in enumerate(np.linspace(0.0, 1.0, samples)[1:], start=1):
            guess = 2.0 * q[k - 1] - q[k - 2] if k > 1 else q[0]
            solved, good, det = self._solve_samples(guess, np.full(len(guess), progress), every)
            step = np.abs(solved - q[k - 1]).max(axis=1)
            ok &= good & (step <= LARGEST_STEP)
            if k > 1:
                ok &= (
                    np.abs(solved - guess).max(axis=1)
                    <= CONTINUATION.bend * step + CONTINUATION.bend_slack
                )
            same = _same_side(det, sign)
            singular |= ok & ~same
            ok &= same
            q[k] = np.where(ok[:, None], solved, q[k - 1])
        return Course(q, ok, singular)

    def _refine_samples(self, course: Course, samples: int) -> Course:
        """Solve for further samples at once, from guesses between those of a course."""
        coarse, b = len(course.q) - 1, len(self.start)
        shares = np.linspace(0.0, 1.0, samples)
        interval = np.minimum((shares * coarse).astype(np.int64), coarse - 1)
        fraction = (shares * coarse - interval)[:, None, None]
        guess = (1.0 - fraction) * course.q[interval] + fraction * course.q[interval + 1]
        _, sign = self._start_state()
        row = np.tile(np.arange(b), samples)
        progress = np.repeat(shares, b)
        solved, good, det = self._solve_samples(guess.reshape(-1, self.arm.axes), progress, row)
        good &= _same_side(det, sign[row])
        q = solved.reshape(samples, b, -1)
        q[0] = self.start
        # Samples lie between those of the course: one on another branch is farther away than these from each other.
        width = np.abs(np.diff(course.q, axis=0)).max(axis=2)[interval]
        is_near = (
            np.abs(q - guess).max(axis=2) <= CONTINUATION.bend * width + CONTINUATION.bend_slack
        )
        ok = course.ok & (good.reshape(samples, b) & is_near).all(axis=0)
        return Course(q, ok, course.singular)

    def _crossed(self, course: Course) -> Course:
        """Follow singular lines straight through their singularities if possible.

        A path passes a singularity smoothly if the line meets it exactly: the determinant changes its sign and no joint
        jumps. Damped steps find the samples on both sides. A line that passes near a singularity would have to turn a
        joint at once: at the zero of the determinant it has a miss, and is dropped.
        """
        if not course.singular.any():
            return course
        rows, samples = np.flatnonzero(course.singular), len(course.q)
        finer = -(-(CONTINUATION.skeleton - 1) // (samples - 1))
        shares = np.linspace(0.0, 1.0, finer * (samples - 1) + 1)
        q, det = (
            np.empty((len(shares), len(rows), self.arm.axes)),
            np.zeros((len(shares), len(rows))),
        )
        q[0], ok = self.start[rows], np.ones(len(rows), dtype=np.bool_)
        for k, progress in enumerate(shares.tolist()):
            before = q[max(k - 1, 0)]
            guess = 2.0 * before - q[k - 2] if k > 1 else before
            solved, good, det[k] = self._solve_samples(
                guess, np.full(len(rows), progress), rows, CROSSING
            )
            step = np.abs(solved - before).max(axis=1)
            ok &= good & (step <= LARGEST_STEP)
            if k > 1:
                ok &= (
                    np.abs(solved - guess).max(axis=1)
                    <= CONTINUATION.bend * step + CONTINUATION.bend_slack
                )
            q[k] = np.where(ok[:, None], solved, before)
        for k in range(len(shares) - 1):
            crossing = np.flatnonzero(ok & (det[k] * det[k + 1] < 0.0))
            if len(crossing):
                part = slice(k, k + 2), crossing
                ok[crossing] = self._locate_singularities(
                    q[part], det[part], shares[k : k + 2], rows[crossing]
                )
        path, good = np.array(course.q), np.array(course.ok)
        path[:, rows], good[rows] = q[::finer], ok
        return Course(path, good, course.singular)

    def _locate_singularities(
        self, q: FloatArray, det: FloatArray, shares: FloatArray, row: IntArray
    ) -> BoolArray:
        """Locate singularities between samples by false position; return whether met, shape (l,).

        Args:
            q: joints at both samples [rad], shape (2, l, n).
            det: determinants there, of opposite signs, shape (2, l).
            shares: of both samples, shape (2,).
            row: the lines, shape (l,).
        """
        progress, change, every = (
            np.tile(shares[:, None], len(row)),
            np.ptp(det, axis=0),
            np.arange(len(row)),
        )
        for _ in range(CROSSING.false_positions):
            part = det[0] / (det[0] - det[1])
            zero = progress[0] + part * (progress[1] - progress[0])
            solved, good, d = self._solve_samples(
                q[0] + part[:, None] * (q[1] - q[0]), zero, row, CROSSING
            )
            end = (det[0] * d <= 0.0).astype(np.int64)
            q[end, every], det[end, every], progress[end, every] = solved, d, zero
        return good & (np.abs(d) <= CROSSING.left * change)

    def _start_state(self) -> tuple[BoolArray, FloatArray]:
        """Flag lines that begin within limits, and return the signs of their determinants."""
        _, _, J = self.arm.linearised(self.start)
        return self.arm.within_limits(self.start), np.sign(_determinant(J, self.W))

    def _solve_samples(
        self, guess: FloatArray, share: FloatArray, row: IntArray, through: Crossing | None = None
    ) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Solve for joints of lines (rows) at shares, with flags and determinants."""
        planes = JointPlanes.through(self.W[row], self.start[row])
        planes.level[...] += share[:, None] * self.ahead[row]
        p = self.lines.p[row] + share[:, None] * self.lines.shift[row]
        q, met, det = newton(self.arm, guess, self.lines.R[row], p, planes, through)
        return q, met & self.arm.within_limits(q), det


def _same_side(det: FloatArray, sign: FloatArray) -> BoolArray:
    """Select determinants that have a given sign and are clear of 0."""
    return np.asarray((np.sign(det) == sign) & (np.abs(det) > CONTINUATION.least_pivot))


def moved_along(
    arm: SerialChain,
    start: FloatArray,
    R: FloatArray,
    p: FloatArray,
    along: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Move postures along the self-motion to given poses, and flag those that arrive.

    Args:
        arm: the arm.
        start: postures that reach nearly the same poses [rad], shape (b, n).
        R: flange rotations, shape (b, 3, 3).
        p: flange positions [m], shape (b, 3).
        along: distances along the self-motion [rad], shape (b,).
    """
    W = spare_directions(arm, start)
    planes = JointPlanes.through(W, start)
    planes.level[:, :1] += along[:, None]
    guess = start + (W[:, 0] * along[:, None] if arm.spare else 0.0)
    q, met, det = newton(arm, guess, R, p, planes)
    near = np.abs(q - start).max(axis=1) <= LARGEST_STEP
    return q, met & near & arm.within_limits(q) & (np.abs(det) > CONTINUATION.least_pivot)


def newton(
    arm: SerialChain,
    guess: FloatArray,
    R: FloatArray,
    p: FloatArray,
    planes: JointPlanes,
    through: Crossing | None = None,
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Solve for postures at poses and on planes of the joint space.

    With `through`, lines may cross singularities: steps are damped and a miss is allowed.
    """
    q, W, det = guess, planes.W, np.zeros(len(guess))
    met = np.zeros(len(guess), dtype=np.bool_)
    for k in range(CONTINUATION.newton_steps):
        R_now, p_now, J = arm.linearised(q)
        e = pose_error(R_now, p_now, R, p)
        off = planes.level - np.einsum("bsn,bn->bs", W, q)
        met = (np.abs(e).max(axis=1) <= 0.1 * INVERSE.residual) & (np.abs(off) <= 1e-9).all(axis=1)
        A, left = np.concatenate([J, W], axis=1), np.concatenate([e, off], axis=1)
        if met.all() or k == CONTINUATION.newton_steps - 1:
            det = _determinant(J, W)
            break
        diagonal = range(arm.axes)
        if through is None:
            A[:, diagonal, diagonal] += 1e-14
            step = solve(A, left[..., None])[..., 0]
        else:
            gram = np.einsum("bij,bkj->bik", A, A)
            gram[:, diagonal, diagonal] += through.damping * through.damping
            step = np.einsum("bij,bi->bj", A, solve(gram, left[..., None])[..., 0])
        # A longer step leaves the neighbourhood; a posture whose steps are cut does not converge and is dropped.
        longest = np.abs(step).max(axis=1, keepdims=True)
        q = q + step * np.minimum(1.0, 1.0 / np.maximum(longest, 1e-300))
    if through is not None:
        met = np.abs(left).max(axis=1) <= through.miss
    return q, met, det


def _determinant(J: FloatArray, W: FloatArray) -> FloatArray:
    return determinant(np.concatenate([J, W], axis=1))


@dataclass(frozen=True)
class PointFollowing:
    """Flange poses of one rotation along any curve, followed by Newton's method.

    A plane through the joint space fixes the self-motion, as in `LineFollowing`.
    """

    arm: SerialChain
    """Kinematics and limits."""
    R: FloatArray
    """Constant rotation of the flange, shape (3, 3)."""
    W: FloatArray
    """Directions of self-motion at the target, shape (s, n)."""
    start: FloatArray
    """Joints at the target [rad], shape (n,)."""
    sign: float
    """Sign of the determinant; it changes at a singularity."""

    @classmethod
    def through(
        cls, arm: SerialChain, guess: FloatArray, R: FloatArray, target: FloatArray
    ) -> tuple[PointFollowing, bool]:
        """Solve for the posture at a target, and return whether that is reached.

        Args:
            arm: kinematics and limits.
            guess: posture near there [rad], shape (1, n).
            R: rotation of the flange, shape (3, 3).
            target: position of the flange [m], shape (3,).
        """
        W = spare_directions(arm, guess)
        planes = JointPlanes.through(W, guess)
        q, met, det = newton(arm, guess, R[None], target[None], planes)
        return cls(arm, R, W[0], q[0], float(np.sign(det[0]))), bool(met.all())

    def outward(self, points: FloatArray, drift: FloatArray) -> tuple[FloatArray, bool]:
        """Solve for joints (m, n) [rad] along flange positions, beginning at the target.

        The flag is True if they are continuous and within limits.

        Args:
            points: positions of the flange [m], the first one the target, shape (m, 3).
            drift: distances along the self-motion [rad], shape (m,).
        """
        q = np.tile(self.start, (len(points), 1))
        last = len(points) - 1
        count = min(last, CONTINUATION.points_in_sequence) + 1
        few = distinct(np.linspace(0, last, count).round().astype(np.int64))
        ok = True
        for k in range(1, len(few)):
            back, here = q[few[k - 1]], few[k : k + 1]
            ratio = (few[k] - few[k - 1]) / (few[k - 1] - few[k - 2]) if k > 1 else 0.0
            guess = back + ratio * (back - q[few[k - 2]]) if k > 1 else back
            joints, good = self._solve_points(points[here], drift[here], guess[None])
            ok &= good and bool(np.abs(joints[0] - back).max() <= LARGEST_STEP)
            q[few[k]] = joints[0]
        between = np.setdiff1d(np.arange(last + 1), few)
        if ok and len(between):
            guess = np.column_stack([np.interp(between, few, column) for column in q[few].T])
            q[between], good = self._solve_points(points[between], drift[between], guess)
            ok &= good and bool(np.abs(np.diff(q, axis=0)).max() <= LARGEST_STEP)
        return q, ok

    def _solve_points(
        self, points: FloatArray, drift: FloatArray, guess: FloatArray
    ) -> tuple[FloatArray, bool]:
        """Solve for joints at flange positions from guesses.

        The flag is True if all of them are on the branch and within limits.
        """
        ahead = np.zeros((len(points), self.arm.spare))
        ahead[:, :1] = drift[:, None]
        W = np.broadcast_to(self.W, (len(points), *self.W.shape))
        planes = JointPlanes(W, ahead + product(self.W, self.start))
        turned = np.broadcast_to(self.R, (len(points), 3, 3))
        q, met, det = newton(self.arm, guess, turned, points, planes)
        same = (np.sign(det) == self.sign) & (np.abs(det) > CONTINUATION.least_pivot)
        return q, bool((met & same & self.arm.within_limits(q)).all())
