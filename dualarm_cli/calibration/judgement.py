"""Quality of a calibration: residuals, spread of the points, and advice."""

from __future__ import annotations

import math

import numpy as np

from dualarm_cli.calibration.problem import CalibrationProblem, CalibrationSolution
from dualarm_cli.calibration.rigid import fit_rigid
from dualarm_cli.calibration.spread import (
    SPREAD,
    Spread,
    distances,
    explained,
    half_widths,
    measure_spread,
)
from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class JudgementSettings:
    """Levels at which readings count as contradictions."""

    outlier_level: float = 0.02
    """Significance level of the outlier test [fraction of sound files]."""
    scale_level: float = 0.01
    """Significance level of the scale test [fraction of sound files].

    With `outlier_level` and the 1 % of `explained`, a false alarm occurs in less than 5 of 100 sound files, for any
    number of points.
    """
    readings_level: float = 0.0025
    """Significance level of each of the two tests of a robot's own readings.

    Together they reject 1 % of sound files of two robots.
    """
    relevant: float = 1e-3
    """Minimum disagreement that is reported [m]."""
    same_point: float = 1e-4
    """Distance below which two points of both robots are the same point [m]."""
    mirrored: float = 1e-3
    """Root mean square residual from which points may be mirror images [m]."""
    turn_off: float = math.radians(0.5)
    """Uncertainty of rotation from which it is reported [rad]."""
    touch_noise: float = 0.5e-3
    """Upper bound on the standard deviation of a touched coordinate without stated noise [m]."""


LEVELS = JudgementSettings()

_note = NoteTable(
    "judgement",
    first_three="the frame method uses the first three points only; {others:*, }: checks. least_squares uses all",
    least_number="three points are the minimum, and a bad one may go undetected; touch 4 to 8 points, well spread in "
    "every direction",
    near_line="the points are nearly on one line: none is more than {left:.1f} mm (left) and {right:.1f} mm (right) "
    "off the line of {length:.0f} mm through {ends:* and }, so touching errors rotate the result about that line; "
    "touch a point at least {apart:.0f} mm off it",
    repeated="{first} and {second} are the same point (less than {distance:g} mm apart): this shows how repeatable "
    "the touching is, but adds nothing to the spread",
    scaled="the left robot's points span {scale:.4f} times what the right robot's points span; check units, tools "
    "and link lengths in the robot files",
    disagree="the robots disagree by {off:.1f} mm about the distance of {first} and {second}, more than {noise} "
    "explains, and no transform can correct it; touch them again, or check the tools and robot files",
    noisy="the residuals are larger than a noise of {noise:g} mm explains (it would take {needed:.2g} mm), so the "
    "intervals are too narrow; check single points, tools and robot files, or leave out `noise`",
    outlier="without {point} the others fit {factor:.3g} times better, and it is {off:.3g} mm from where they "
    "predict it: touch it again, or check that both robots touched the same point",
    mirrored="one robot's points are the mirror image of the other's: a reflection leaves {mirror:.3g} mm where the "
    "best motion leaves {plain:.3g} mm; check for a missing sign or a left-handed frame",
    noise_needed="the uncertainty of the frame method is known only if the noise is stated (`noise: 0.5 mm`)",
    no_surplus="there are as many unknowns as equations, so the uncertainty is not known; touch more points, or state "
    "the noise",
    loose_turn="the rotation is known to ±{turn:.2g} deg only (95 %), which is {shift:.0f} mm at a distance of 1 m; "
    "touch more points, farther apart in every direction",
)


@dataclass(frozen=True)
class Outlier:
    """Point that is inconsistent with the others."""

    point: int
    """Index of the point."""
    off: float
    """Distance from the position predicted by the other points [m]."""
    factor: float
    """Factor by which the other points fit better without it."""


@dataclass(frozen=True)
class Consistency:
    """Evidence that more than noise makes the robots' points differ."""

    too_much: bool
    """Flag of residuals larger than the stated noise, or `touch_noise`, explains."""
    outlier: Outlier | None
    """Point that is inconsistent with the others, or None."""
    scale: float | None
    """Scale of the left robot's points against the right's; None if noise explains it."""

    @property
    def contradicted(self) -> bool:
        """Flag of any contradiction."""
        return self.too_much or self.outlier is not None or self.scale is not None


def check_consistency(problem: CalibrationProblem, fitted: int = 0) -> Consistency:
    """Test the points for errors that noise does not explain.

    Args:
        problem: the points.
        fitted: number of tool coordinates fitted to the same residuals.
    """
    squares = least_squares(problem)
    degrees = 3 * len(problem.names) - 6 - fitted
    noise = LEVELS.touch_noise if problem.noise is None else problem.noise
    # A residual contains the noise of both robots.
    too_much = degrees > 0 and not explained(squares, degrees, 2.0 * noise**2)
    return Consistency(
        too_much, _outlier(problem, squares, fitted), _scale(problem, squares, fitted)
    )


def readings_apart(apart: FloatArray, noise: float | None, fitted: int) -> float | None:
    """Compute the largest discrepancy of two readings [m], or None within the noise.

    All points together and, by Bonferroni's bound, the worst point are compared with noise in both readings.

    Args:
        apart: the differences [m], shape (n, 3).
        noise: standard deviation of each coordinate [m]; None for `touch_noise`.
        fitted: number of quantities fitted to these differences.
    """
    squares = (apart**2).sum(axis=1)
    worst, degrees = float(squares.max()), apart.size - fitted
    if worst <= LEVELS.relevant**2 or degrees <= 0:
        return None
    variance = 2.0 * (LEVELS.touch_noise if noise is None else noise) ** 2
    all_explained = explained(float(squares.sum()), degrees, variance, LEVELS.readings_level)
    if all_explained and explained(worst, 3, variance, LEVELS.readings_level / len(squares)):
        return None
    return math.sqrt(worst)


def least_squares(problem: CalibrationProblem) -> float:
    """Compute the least sum of squared residuals [m^2] of any rigid motion."""
    R, t = fit_rigid(problem.left, problem.right)
    return float(((problem.left - problem.right @ R.T - t) ** 2).sum())


def _outlier(problem: CalibrationProblem, squares: float, fitted: int) -> Outlier | None:
    """Find the point without which the others fit better at level `outlier_level`, or None.

    Mean-shift test of each point, F(3, 3 n - 9) under noise of any size, with Bonferroni's bound on the most extreme of
    n points.
    """
    from scipy.special import fdtrc

    n = len(problem.names)
    degrees = 3 * n - 9 - fitted
    if degrees <= 0:
        return None
    subsets = np.array([[k for k in range(n) if k != out] for out in range(n)])
    left, right = problem.left[subsets], problem.right[subsets]
    R, t = fit_rigid(left, right)
    residuals = left - (right @ np.swapaxes(R, -1, -2) + t[:, None])
    without = (residuals**2).sum(axis=(1, 2))
    worst = int(np.argmin(without))
    least = max(float(without[worst]), 1e-30)
    off = float(np.linalg.norm(problem.left[worst] - R[worst] @ problem.right[worst] - t[worst]))
    F = (squares - least) / 3.0 * degrees / least
    if off < LEVELS.relevant or n * float(fdtrc(3, degrees, F)) >= LEVELS.outlier_level:
        return None
    return Outlier(worst, off, math.sqrt(squares / (degrees + 3) * degrees / least))


def _scale(problem: CalibrationProblem, squares: float, fitted: int) -> float | None:
    """Estimate the scale of the left robot's points against the right's, if significant.

    None if noise has as large an effect in `scale_level` of all files, or if distances differ by less than `relevant`.
    The scale of least squares ([Umeyama1991]) is a seventh unknown: F(1, 3 n - 7) under noise of any size.
    """
    from scipy.special import fdtrc

    degrees = 3 * len(problem.names) - 7 - fitted
    if degrees <= 0:
        return None
    R, _ = fit_rigid(problem.left, problem.right)
    left = problem.left - problem.left.mean(axis=0)
    turned = (problem.right - problem.right.mean(axis=0)) @ R.T
    size = float((turned**2).sum())
    scale = float((left * turned).sum()) / size
    least = max(squares - (scale - 1.0) ** 2 * size, 1e-30)
    F = (squares - least) * degrees / least
    off = abs(scale - 1.0) * float(np.linalg.norm(turned[:, None] - turned[None], axis=-1).max())
    if off < LEVELS.relevant or float(fdtrc(1, degrees, F)) >= LEVELS.scale_level:
        return None
    return scale


@dataclass(frozen=True)
class PairDistance:
    """Distance of two points, measured by both robots."""

    first: str
    """Name of the first point."""
    second: str
    """Name of the second point."""
    left: float
    """Distance for the left robot [m]."""
    right: float
    """Distance for the right robot [m]."""


@dataclass(frozen=True)
class Judgement:
    """Quality of a calibration."""

    residuals: FloatArray
    """Residuals, left minus transformed right [m], shape (n, 3)."""
    pairs: tuple[PairDistance, ...]
    """Distances of all pairs of points."""
    left: Spread
    """Spread of the left robot's points."""
    right: Spread
    """Spread of the right robot's points."""
    widths: FloatArray | None
    """Half widths of the 95 % intervals of translation [m] and rotation vector [rad], shape (6,)."""
    warnings: tuple[Note, ...]
    """Warnings with advice."""

    @property
    def distances(self) -> FloatArray:
        """Length of the residual at each point [m], shape (n,)."""
        return readonly(np.linalg.norm(self.residuals, axis=1))

    @property
    def rms(self) -> float:
        """Root mean square residual length [m]."""
        return float(np.sqrt((self.residuals**2).sum() / len(self.residuals)))


def judge(
    problem: CalibrationProblem, solution: CalibrationSolution, method: str, fitted: int = 0
) -> Judgement:
    """Assess a calibration: residuals, distances, spread, uncertainty and warnings.

    Args:
        problem: the points.
        solution: of the method.
        method: name of the method.
        fitted: number of tool coordinates fitted to the same residuals.
    """
    residuals = solution.residuals(problem.left, problem.right)
    left, right = measure_spread(problem.left), measure_spread(problem.right)
    spacing = distances(problem.left), distances(problem.right)
    n = len(problem.names)
    pairs = tuple(
        PairDistance(
            problem.names[i], problem.names[j], float(spacing[0][i, j]), float(spacing[1][i, j])
        )
        for i in range(n)
        for j in range(i + 1, n)
    )
    widths = None
    if solution.covariance is not None:
        widths = readonly(half_widths(solution.covariance, solution.degrees))
    consistency = check_consistency(problem, fitted)
    warnings = [
        *_few(problem, method),
        *_near_line(problem, left, right),
        *_repeated(pairs),
        *_disagreement(problem, pairs, consistency, fitted),
        *mirrored(problem),
        *_uncertain(widths, method),
    ]
    return Judgement(readonly(residuals), pairs, left, right, widths, tuple(warnings))


def _few(problem: CalibrationProblem, method: str) -> list[Note]:
    """Warn about three points, or about points that the frame method ignores."""
    n = len(problem.names)
    if method == "frame" and n > 3:
        return [_note("first_three", others=problem.names[3:])]
    return [_note("least_number")] if n <= 3 else []


def _near_line(problem: CalibrationProblem, left: Spread, right: Spread) -> list[Note]:
    """Warn about points nearly on a line."""
    worst = min(left, right, key=lambda spread: spread.ratio)
    if worst.ratio >= SPREAD.nearly_a_line:
        return []
    return [
        _note(
            "near_line",
            left=left.height * 1000,
            right=right.height * 1000,
            length=worst.length * 1000,
            ends=[problem.names[k] for k in worst.ends],
            apart=worst.length * 500,
        )
    ]


def _repeated(pairs: tuple[PairDistance, ...]) -> list[Note]:
    """Warn about repeated points."""
    return [
        _note("repeated", first=pair.first, second=pair.second, distance=LEVELS.same_point * 1000)
        for pair in pairs
        if max(pair.left, pair.right) < LEVELS.same_point
    ]


def _disagreement(
    problem: CalibrationProblem,
    pairs: tuple[PairDistance, ...],
    consistency: Consistency,
    fitted: int,
) -> list[Note]:
    """Warn about discrepancies between the robots that exceed noise."""
    warnings = []
    if consistency.scale is not None:
        warnings.append(_note("scaled", scale=consistency.scale))
    if problem.noise is None and consistency.contradicted:
        worst = max(pairs, key=lambda pair: abs(pair.left - pair.right))
        touches = f"a noise of {LEVELS.touch_noise * 1000:g} mm"
        noise = touches if consistency.too_much else "their noise"
        off = abs(worst.left - worst.right) * 1000
        warnings.append(
            _note("disagree", off=off, first=worst.first, second=worst.second, noise=noise)
        )
    elif consistency.too_much and problem.noise is not None:
        degrees = 3 * len(problem.names) - 6 - fitted
        needed = math.sqrt(least_squares(problem) / degrees / 2.0) * 1000
        warnings.append(_note("noisy", noise=problem.noise * 1000, needed=needed))
    if consistency.outlier is not None:
        outlier, point = consistency.outlier, problem.names[consistency.outlier.point]
        warnings.append(
            _note("outlier", point=point, factor=outlier.factor, off=outlier.off * 1000)
        )
    return warnings


def mirrored(problem: CalibrationProblem) -> list[Note]:
    """Warn about mirrored points: a reflection fits far better, so a sign is lost."""
    flipped = CalibrationProblem(problem.left, -problem.right, problem.names)
    plain, mirror = (math.sqrt(least_squares(p) / len(p.names)) for p in (problem, flipped))
    if plain < LEVELS.mirrored or mirror > plain / 3.0:
        return []
    return [_note("mirrored", mirror=mirror * 1000, plain=plain * 1000)]


def _uncertain(widths: FloatArray | None, method: str) -> list[Note]:
    """Warn about a large or unknown uncertainty."""
    if widths is None:
        return [_note("noise_needed" if method == "frame" else "no_surplus")]
    turn = float(widths[3:].max())
    if turn < LEVELS.turn_off:
        return []
    shift = math.tan(min(turn, 1.5)) * 1000
    return [_note("loose_turn", turn=math.degrees(turn), shift=shift)]
