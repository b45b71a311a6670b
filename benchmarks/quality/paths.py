"""What following paths costs and gains: one step against plain numpy and a general library, and the papers' claims.

    python -m benchmarks.quality.paths [steps | springs | manipulability] [--starts 20]

Ratios within one run; the seconds depend on the machine. `steps` compares with Pink where it is installed (pin-pink).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pinocchio as pin

from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinds.path.context import PathClock, PathContext
from dualarm_cli.kinds.path.following import NoPath, PathMotion, PathProblem
from dualarm_cli.kinds.path.following.acceleration import (
    AccelerationStep,
    follow_manipulability,
    follow_min_acceleration,
)
from dualarm_cli.kinds.path.following.velocity import (
    Room,
    follow_min_norm,
    follow_spring,
    follow_spring_damped,
    make_step,
    spring_gradient,
)
from dualarm_cli.kinds.path.starts import path_starts
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.manipulability import manipulability, manipulability_rates

PAPERS = Path(__file__).parents[2] / "tasks" / "papers"
STEPS = 1500


def scenario(name: str) -> tuple[PathContext, PathProblem]:
    """Returns one of the papers' tasks as a problem from its best start."""
    job = load_job(PAPERS / name / "tasks.yaml")
    context = PathContext.of(CellModel.from_cell(job.cell), job)
    work = job.tasks[0].path
    assert work is not None
    home = np.array(job.cell.robot.postures["home"])
    clock = PathClock.of(work, 1.0, 2.0)
    for start in path_starts(context, work, home, 0).configurations:
        problem = context.problem(work, start, clock)
        if isinstance(follow_min_norm(problem), PathMotion):
            return context, problem
    raise SystemExit(f"{name}: no start")


def median_us(step: Callable[[int], object], count: int) -> float:
    """Returns the median time of a step [us]."""
    times = []
    for k in range(count):
        begin = perf_counter()
        step(k)
        times.append(perf_counter() - begin)
    return float(np.median(times)) * 1e6


def steps() -> None:
    """Prints the cost of one step of the spring (16 joints) and of the quadratic program (14)."""
    against = "/ numpy's pseudoinverse alone", "/ Pink"
    print_head("step of", "joints", "time", *against)
    context, problem = scenario("choi_circles")
    motion = follow_spring(problem)
    assert isinstance(motion, PathMotion)
    spring = make_step(problem, Room(problem), exact=True, pulled=True)
    q = motion.position
    _against_others("`virtual_spring`", context, problem, q, lambda k: spring(q[k], k + 1))
    context, problem = scenario("zhang_turn")
    motion = follow_manipulability(problem)
    assert isinstance(motion, PathMotion)
    _against_others(
        "`manipulability`", context, problem, motion.position, _program(problem, motion)
    )


def _program(problem: PathProblem, motion: PathMotion) -> Callable[[int], object]:
    """Returns a step of the quadratic program along a motion that it made."""
    q, weights = motion.position, problem.weights
    qd = np.gradient(q, problem.step, axis=0)
    qdd = np.gradient(qd, problem.step, axis=0)

    def wanted(S: np.ndarray, v: np.ndarray) -> np.ndarray:
        rates = manipulability_rates(problem.body, S, v)
        return weights.gain * rates.rate - weights.damping * (v - weights.gain * rates.gradient)

    program = AccelerationStep(problem, wanted)
    return lambda k: program.solve(q[k], qd[k], qdd[k], k)


def _against_others(
    what: str,
    context: PathContext,
    problem: PathProblem,
    q: np.ndarray,
    step: Callable[[int], object],
) -> None:
    """Prints the median time of a step, and of what others do instead along the same motion."""
    count = min(STEPS, problem.instants - 2)
    ours = median_us(step, count)
    plain = median_us(_plain(context, problem, q), count)
    general = _pink(context, problem, q)
    if general is None:
        tell("Pink is left out: it is not installed (pip install pin-pink)")
    pink = np.nan if general is None else median_us(general, min(count, 400))
    ratio = "" if general is None else f"{ours / pink:.1f}"
    print_row(what, q.shape[1], f"{ours:.0f} µs", f"{ours / plain:.1f}", ratio)


def _plain(context: PathContext, problem: PathProblem, q: np.ndarray) -> Callable[[int], object]:
    """Returns a step by pinocchio's frame Jacobians and numpy's pinv, as most scripts have it."""
    robot = context.job.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    order = [robot.joints.index(name) for name in list(model.names)[1:]]
    frames = [model.getFrameId(arm.flange) for arm in robot.arms]

    def step(k: int) -> object:
        pin.computeJointJacobians(model, data, q[k][order])
        pin.updateFramePlacements(model, data)
        J, way = [], []
        for a, frame in enumerate(frames):
            J.append(pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED))
            way.append(problem.p[k + 1, a] - problem.p[k, a])
            way.append(log_rotation(problem.R[k + 1, a] @ problem.R[k, a].T))
        return np.linalg.pinv(np.vstack(J)) @ np.concatenate(way)

    return step


def _pink(
    context: PathContext, problem: PathProblem, q: np.ndarray
) -> Callable[[int], object] | None:
    """Returns a step by Pink, or None where it is not installed."""
    try:
        import pink
        from pink.tasks import FrameTask
    except ImportError:
        return None
    robot = context.job.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    order = [robot.joints.index(name) for name in list(model.names)[1:]]
    tasks = [FrameTask(arm.flange, position_cost=1.0, orientation_cost=1.0) for arm in robot.arms]
    T = [context.job.cell.tools[arm.name].tcp.inverse() for arm in robot.arms]

    def step(k: int) -> object:
        configuration = pink.Configuration(model, data, q[k][order])
        for a, task in enumerate(tasks):
            goal = pin.SE3(problem.R[k + 1, a], problem.p[k + 1, a]) * T[a]
            task.set_target(goal)
        return pink.solve_ik(configuration, tasks, problem.step, solver="piqp", safety_break=False)

    return step


def springs() -> None:
    """Prints what [Choi2020] claims: the same tools, elbows nearer to their critical points."""
    _, problem = scenario("choi_circles")
    body = problem.body
    shoulders, upper = body.shoulders()
    least = np.abs(np.linalg.norm(shoulders - problem.spring.points, axis=1) - upper).mean()
    plain = follow_min_norm(problem)
    assert isinstance(plain, PathMotion)
    base = _elbows(problem, plain) - least
    tell(
        f"least norm: elbows {1e3 * (base + least):.1f} mm, of any posture at least {1e3 * least:.1f} mm"
    )
    what = (
        "elbows nearer to their points",
        "tools differ by",
        "share of a speed limit",
        "waist turns",
    )
    print_head("K", "form", *what)
    for stiffness in (2.0, 5.0, 10.0, 15.0):
        one = replace(problem, spring=replace(problem.spring, gain=2.0 * stiffness**2))
        for name, follow in (("exact", follow_spring), ("as printed", follow_spring_damped)):
            motion = follow(one)
            if isinstance(motion, NoPath):
                tell(f"K = {stiffness:g}, {name}: {motion.reason}")
                continue
            above = _elbows(one, motion) - least
            apart = max(
                float(np.abs(body.tools(a)[1] - body.tools(b)[1]).max())
                for a, b in zip(plain.position[::5], motion.position[::5], strict=True)
            )
            speed = np.abs(np.diff(motion.position, axis=0)).max(axis=0) / one.step
            share = float((speed / one.limits.velocity).max())
            waist = float(np.ptp(motion.position[:, :2], axis=0).max())
            print_row(
                f"{stiffness:g}",
                name,
                f"{1.0 - above / base:.0%}",
                f"{apart:.1e} m",
                f"{share:.0%}",
                f"{np.rad2deg(waist):.1f}°",
            )


def _elbows(problem: PathProblem, motion: PathMotion) -> float:
    body = problem.body
    return float(
        np.mean(
            [spring_gradient(body, body.at(q), problem.spring)[1] for q in motion.position[::10]]
        )
    )


def study(starts: int) -> None:
    """Prints what [Zhang2024] claims: more manipulability than both baselines, from many starts."""
    context, problem = scenario("zhang_turn")
    work = context.job.tasks[0].path
    assert work is not None
    stride, limits = 2, context.limits
    problem = replace(
        problem,
        step=problem.step * stride,
        R=problem.R[::stride],
        p=problem.p[::stride],
        share=problem.share[::stride],
        pace=problem.pace[::stride],
    )
    random = np.random.default_rng(0)
    rows, refused = [], 0
    while len(rows) < starts:
        near = random.uniform(limits.lower, limits.upper) * 0.7
        robot = replace(context.job.cell.robot, postures={"home": near, "here": near})
        cell = replace(context.job.cell, robot=robot)
        there = replace(context, job=replace(context.job, cell=cell))
        for start in path_starts(there, replace(work, posture="here"), near, 0).configurations:
            one = replace(problem, start=start)
            baselines = [follow_min_norm(one), follow_min_acceleration(one)]
            if any(isinstance(motion, NoPath) for motion in baselines):
                continue
            ours = follow_manipulability(one)
            if isinstance(ours, NoPath):
                refused += 1
                continue
            M = _measure(one, ours)
            row = []
            for motion in baselines:
                assert isinstance(motion, PathMotion)
                B = _measure(one, motion)
                row += [M.mean() / B.mean() - 1.0, (M / B).min() - 1.0]
            rows.append(row)
    found = np.array(rows)
    print_head("manipulability against", "starts", "mean over time", "least at an instant")
    for k, name in enumerate(("Eq. 8, least velocity", "Eq. 9, least acceleration")):
        mean, worst = found[:, 2 * k], found[:, 2 * k + 1]
        span = f"{np.median(mean):+.1%} ({mean.min():+.1%} to {mean.max():+.1%})"
        print_row(name, len(found), span, f"{worst.min():+.1%}")
    tell(f"starts that both baselines follow and ours does not: {refused}")


def _measure(problem: PathProblem, motion: PathMotion) -> np.ndarray:
    return np.array([manipulability(problem.body.at(q).J) for q in motion.position[::10]])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="?", choices=["steps", "springs", "manipulability"])
    parser.add_argument("--starts", type=int, default=20)
    arguments = parser.parse_args()
    if arguments.what in (None, "steps"):
        steps()
    if arguments.what in (None, "springs"):
        springs()
    if arguments.what in (None, "manipulability"):
        study(arguments.starts)
