"""Timing: closed forms against one ruckig call each, line profiles against toppra.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.speed.timing`. Everything is timed in one process on the
limits of an SDA10F arm; quote the ratios, not the times. Lines are the exact inverse kinematics of an
iiwa 14 over 80 mm, postures chosen at random among those that reach both ends; toppra's durations
are optimal without jerk limits, so the ratio of durations says what a double S costs there.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import ruckig

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.joint_axes import SrsGeometry
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.motion.joint_motion import merge
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.composition import concatenate, hold
from dualarm_cli.timing.line_profile import estimate_line_durations
from dualarm_cli.timing.problem import LineProblem, TransferProblem

JOINTS = ("s", "l", "e", "u", "r", "b", "t")
VELOCITY = np.deg2rad([170.0, 170, 170, 170, 200, 200, 400])
"""Speeds of the maker [rad/s]; accelerations reach them in 0.3 s, jerks those in 0.1 s."""
HEIGHTS = (0.1575, 0.2025, 0.2045, 0.2155, 0.1845, 0.2155, 0.081)
"""Distances between the joint frames of an iiwa 14 [m]; the flange is 0.045 m above the last."""
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1.0]])
REACH = np.deg2rad([170, 120, 170, 120, 170, 120, 175])
LENGTH, SAMPLES, COARSE = 0.08, 65, 9
MOVES, SINGLES, LINES, MANY = 20_000, 2_000, 40, 3_000
STAGES = (100, 1_000)


def main() -> None:
    """Prints the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7, help="best of so many runs")
    repeat = parser.parse_args().repeat
    limits = _limits(VELOCITY / 0.03)
    print(f"{'what':52} {'us each':>10}")
    _closed_forms(limits, repeat)
    _transfers(limits, repeat)
    _lines(limits, repeat)
    _composition(limits, repeat)


def _limits(jerk: FloatArray) -> JointLimits:
    acceleration = VELOCITY / 0.3
    return JointLimits(JOINTS, -REACH, REACH, VELOCITY, acceleration, jerk, ("assumed",) * 7)


def _best(run: Callable[[], object], repeat: int) -> float:
    """Returns the shortest of several runs [s]; on a shared machine the least disturbed one."""
    run()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def _report(what: str, seconds: float) -> float:
    print(f"{what:52} {seconds * 1e6:10.3f}")
    return seconds


def _closed_forms(limits: JointLimits, repeat: int) -> None:
    """Durations of moves of seven joints: all at once, and by ruckig one at a time."""
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    moves = np.random.default_rng(1).uniform(-2, 2, (MOVES, 7))
    ours = _report(
        f"closed-form duration, {MOVES} moves of 7 joints at once",
        _best(lambda: law.duration(moves), repeat) / MOVES,
    )
    otg, request = ruckig.Ruckig(7), ruckig.InputParameter(7)
    request.max_velocity, request.max_acceleration = limits.velocity, limits.acceleration
    request.max_jerk = limits.jerk
    targets, found = moves[:SINGLES].tolist(), np.zeros(SINGLES)
    trajectory = ruckig.Trajectory(7)

    def singly() -> None:
        for k, target in enumerate(targets):
            request.target_position = target
            otg.calculate(request, trajectory)
            found[k] = trajectory.duration

    theirs = _report("ruckig, duration of one move", _best(singly, repeat) / SINGLES)
    gap = float(np.abs(law.duration(moves[:SINGLES]) / found - 1).max())
    print(f"  ruckig / closed form: {theirs / ours:.0f} times; durations agree to {gap:.0e}")


def _transfers(limits: JointLimits, repeat: int) -> None:
    """Whole transfers with exact knots."""
    rng = np.random.default_rng(2)
    problems = [
        TransferProblem(JOINTS, *rng.uniform(-1.5, 1.5, (2, 7)), limits=limits) for _ in range(50)
    ]
    for name in ("ruckig", "trapezoid"):
        solve = TIMING_SOLVERS[name].transfer
        seconds = _best(lambda solve=solve: [solve(p) for p in problems], repeat) / 50  # type: ignore[misc]
        _report(f"transfer of 7 joints with its knots, {name}", seconds)


def _lines(limits: JointLimits, repeat: int) -> None:
    """Lines with and without jerk limits, and the estimate of many."""
    paths = _paths()
    length = np.linspace(0.0, LENGTH, SAMPLES)
    free = _limits(np.full(7, np.inf))
    problems = [LineProblem(JOINTS, path, length, limits) for path in paths]
    without = [replace(problem, limits=free) for problem in problems]
    ours, toppra = TIMING_SOLVERS["ruckig"].line, TIMING_SOLVERS["toppra"].line
    seconds = [
        _report("line profile under jerk limits", _time_each(ours, problems, repeat)),
        _report("line profile without jerk limits", _time_each(ours, without, repeat)),
        _report("toppra without jerk limits", _time_each(toppra, without, repeat)),
    ]
    ratio = np.array([ours(p).duration / toppra(p).duration for p in without])
    print(f"  toppra / line profile: {seconds[2] / seconds[1]:.1f} times as long to compute")
    print(f"  motions last {ratio.mean():.3f} ({ratio.min():.3f} to {ratio.max():.3f}) of toppra's")
    coarse = np.linspace(0, SAMPLES - 1, COARSE).astype(int)
    many = np.tile(np.stack(paths)[:, coarse], (MANY // LINES + 1, 1, 1))[:MANY]
    share = length[coarse]
    each = _report(
        f"estimated duration, {MANY} lines at once",
        _best(lambda: estimate_line_durations(many, share, limits), repeat) / MANY,
    )
    estimate = estimate_line_durations(many[:LINES], share, limits)
    gap = estimate / np.array([ours(p).duration for p in problems])
    print(f"  line profile / estimate: {seconds[0] / each:.0f} times as long to compute")
    print(
        f"  estimates are {gap.mean():.3f} ({gap.min():.3f} to {gap.max():.3f}) of the solved line"
    )


def _time_each(
    solve: Callable[[LineProblem], object], problems: list[LineProblem], repeat: int
) -> float:
    return _best(lambda: [solve(problem) for problem in problems], repeat) / len(problems)


def _paths() -> list[FloatArray]:
    """Returns joint paths of straight lines that stay inside the limits on one branch."""
    points = np.zeros((7, 3))
    points[:, 2] = np.cumsum(HEIGHTS)
    flange = np.array([0.0, 0.0, sum(HEIGHTS) + 0.045])
    arm = SrsArm(SrsGeometry.measure(AXES, points, np.eye(3), flange), -REACH, REACH)
    rng = np.random.default_rng(3)
    paths: list[FloatArray] = []
    while len(paths) < LINES:
        q = rng.uniform(-0.8 * REACH, 0.8 * REACH, 7)
        direction = rng.normal(size=3)
        R, p = arm.forward(q)
        way = np.linspace(0.0, LENGTH, SAMPLES)[:, None] * direction / np.linalg.norm(direction)
        psi, branch = arm.arm_angle(q), arm.branch(q)
        path, valid = arm.solve_branch(R, p + way, np.full(SAMPLES, psi), np.full(SAMPLES, branch))
        # Close to a singularity or where a joint wraps a line has no smooth joint path.
        if np.all(valid) and np.abs(np.diff(path, axis=0)).max() < 0.03:
            paths.append(path)
    return paths


def _composition(limits: JointLimits, repeat: int) -> None:
    """Stages put together: time must grow with their number and no faster."""
    names = JOINTS[:3], JOINTS[3:]
    pieces = []
    for group in names:
        own, n = limits.select(group), len(group)
        solve = TIMING_SOLVERS["ruckig"].transfer
        there = solve(TransferProblem(group, np.zeros(n), np.ones(n), own, 2.0))
        back = solve(TransferProblem(group, np.ones(n), np.zeros(n), own, 2.0))
        pieces.append([there, hold(group, np.ones(n), 0.5), back])
    each = []
    for stages in STAGES:
        seconds = _best(
            lambda n=stages: merge([concatenate(p * n) for p in pieces], JOINTS),  # type: ignore[misc]
            repeat,
        )
        each.append(_report(f"{stages} stages put together, each", seconds / stages))
    print(f"  a stage among {STAGES[1]} / among {STAGES[0]}: {each[1] / each[0]:.2f}")


if __name__ == "__main__":
    main()
