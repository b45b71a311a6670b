"""How fast seams can be: a nominal pose of the part, the best still one, the part moving too; and a part in the cell.

    python -m benchmarks.quality.seams [still-and-moving | platform] [--effort normal] [--seed 0]

The cell is that of tasks/10_seam (SDA10F, acceleration and jerk limits assumed). Every seam may be as fast as the
joints allow at a steady speed; times are of whole seams with their ramps, chain closed and all limits kept. The nominal
pose is the one nearest to the middle in front of the robot from which inverse kinematics by steps of least norm works
the seam.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
import pinocchio as pin

from benchmarks.tables import print_head, print_row
from dualarm_cli.effort import EFFORTS
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam, SeamMotion, SeamProblem
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.closed_chain.posture_paths import steady_time
from dualarm_cli.kinds.seam.closed_chain.starts import beyond_limits, seam_starts
from dualarm_cli.kinds.seam.motion import timed_seam
from dualarm_cli.kinds.seam.path import SeamPath
from dualarm_cli.model.curves.contours import Contour, Ellipse, LineContour, Saddle, SphereArc
from dualarm_cli.model.curves.feature_curve import FeatureCurve
from dualarm_cli.model.curves.point_spline import PointSpline
from dualarm_cli.model.job import Job
from dualarm_cli.model.process_work import SeamTool, SeamWork

TASKS = Path(__file__).parents[2] / "tasks" / "10_seam" / "tasks.yaml"
MIDDLE = np.array([0.5, 0.0, 1.0])
"""The middle in front of the robot [m]."""
FAST = 5.0
"""Speed that no seam comes to [m/s]."""
TURN = 2.0 * np.pi
WAVE = np.array(
    [[0.0, 0.0, 0.0], [0.05, 0.03, 0.01], [0.1, 0.0, 0.0], [0.15, -0.03, 0.01], [0.2, 0.0, 0.0]]
)
SUITE: dict[str, tuple[Contour, SeamTool]] = {
    "saddle 50/45": (
        Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, TURN),
        SeamTool(0.002, free_spin=True),
    ),
    "saddle 50/45, tilt 10": (
        Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, TURN),
        SeamTool(0.002, free_spin=True, tilt=np.deg2rad(10.0)),
    ),
    "saddle 60/35, 60 deg": (
        Saddle(0.06, 0.035, np.pi / 3, 0.01, 0.0, TURN),
        SeamTool(0.002, free_spin=True),
    ),
    "half saddle, spin fixed": (
        Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, np.pi),
        SeamTool(0.002),
    ),
    "arc on a ball 50/20": (
        SphereArc(0.05, 0.02, 0.0, 0.0, 0.0, TURN),
        SeamTool(0.002, free_spin=True),
    ),
    "arc on a ball 100/80": (
        SphereArc(0.1, 0.08, 0.0, 0.0, 0.0, TURN),
        SeamTool(0.002, free_spin=True),
    ),
    "ellipse 80 x 50": (Ellipse((0.08, 0.05), 0.0, TURN), SeamTool(0.002, free_spin=True)),
    "line of 300 mm": (
        LineContour(np.zeros(3), np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
        SeamTool(0.002, free_spin=True),
    ),
    "wave of 200 mm": (
        PointSpline(WAVE, np.array([0.0, 0.0, 1.0])),
        SeamTool(0.002, work_angle=0.5, free_spin=True),
    ),
}
"""Seams: contour and tool."""


def still_and_moving(job: Job, base: SeamWork, effort: str, seed: int) -> None:
    """Prints times of seams by nominal pose, best still pose and moving part."""
    still_gains, moving_gains = [], []
    times = "nominal pose", "best still pose", "moving part"
    print_head("seam on a held part", *times, "nominal / still", "still / moving")
    for name, (contour, tool) in SUITE.items():
        work = replace(base, curve=FeatureCurve(contour, pin.SE3.Identity()), tool=tool)
        problem = _problem(job, work, effort, seed)
        nominal = _whole(problem, _nominal(problem))
        still = _whole(problem, SEAM_SOLVERS["still"].solve(problem))
        # As the planner does where a seam may be as fast as it can.
        moving = min(still, _whole(problem, SEAM_SOLVERS["moving"].solve(problem)))
        still_gains.append(nominal / still)
        moving_gains.append(still / moving)
        print_row(
            name,
            *map(told, (nominal, still, moving)),
            *map(share, (nominal / still, still / moving)),
        )
    print_row("median", "", "", "", *map(share, (median(still_gains), median(moving_gains))))


def told(seconds: float) -> str:
    """Returns a time as the table has it."""
    return f"{seconds:.3f} s" if np.isfinite(seconds) else "none"


def share(ratio: float) -> str:
    """Returns a ratio as the table has it."""
    return f"{ratio:.2f}" if np.isfinite(ratio) else ""


def platform(job: Job, base: SeamWork, effort: str, seed: int) -> None:
    """Prints times of seams on a part that stands in the cell, platform still and turning."""
    gains = []
    print_head("seam on a part in the cell", "at", "platform still", "turning", "still / turning")
    for name, (contour, tool) in SUITE.items():
        for x, y in ((0.6, -0.3), (0.8, 0.0)):
            T = pin.SE3(
                pin.rpy.rpyToMatrix(0.0, -np.pi / 2 if "saddle" in name else 0.0, 0.0),
                np.array([x, y, 0.9]),
            )
            curve = FeatureCurve(contour, pin.SE3.Identity())
            work = replace(base, master=None, part=T, curve=curve, tool=tool, touches=())
            problem = _problem(job, work, effort, seed)
            still = _whole(problem, SEAM_SOLVERS["still"].solve(problem))
            turning = min(still, _whole(problem, SEAM_SOLVERS["moving"].solve(problem)))
            if np.isfinite(still):
                gains.append(still / turning)
                place = f"{1e3 * x:g} mm, {1e3 * y:g} mm"
                print_row(name, place, told(still), told(turning), share(still / turning))
    print_row("median", "", "", "", share(median(gains)))


def _problem(job: Job, work: SeamWork, effort: str, seed: int) -> SeamProblem:
    robot = job.cell.robot
    return SeamProblem(
        chain=Chain(job.cell, work),
        limits=robot.limits,
        start=np.array(robot.postures["home"]),
        reference=None,
        begin=None,
        time=work.length / FAST,
        samples=EFFORTS[effort].seam_samples,
        improved_starts=EFFORTS[effort].seam_starts,
        seed=seed,
        transfer_times=None,
        can_continue=None,
        is_free=None,
    )


def _nominal(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Returns the way with the part nearest to the middle in front of the robot."""
    starts = seam_starts(problem)
    good = [way for way in starts.position if beyond_limits(problem, way).max() == 0.0]
    if not good:
        return NoSeam("none", 0.0)
    places = problem.chain.bodies(np.array([way[0] for way in good])).p_part
    nearest = good[int(np.argmin(np.linalg.norm(places - MIDDLE, axis=1)))]
    return SeamMotion(nearest, steady_time(nearest, problem.limits))


def _whole(problem: SeamProblem, motion: SeamMotion | NoSeam) -> float:
    """Returns how long a whole seam takes with its ramps [s]."""
    if isinstance(motion, NoSeam):
        return float("inf")
    path = SeamPath.of(problem, motion)
    if path is None:
        return float("inf")
    found = timed_seam(path, problem.chain.work, problem.limits, 1.0, trapezoid=False)
    return float("inf") if isinstance(found, str) else found.trajectory.duration


def main() -> None:
    """Runs what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("which", nargs="?", choices=["still-and-moving", "platform"])
    parser.add_argument("--effort", default="normal", choices=list(EFFORTS))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    job = load_job(TASKS)
    work = job.tasks[0].seam
    assert work is not None
    base = replace(work, speed=FAST, slower=True)
    if options.which != "platform":
        still_and_moving(job, base, options.effort, options.seed)
    if options.which != "still-and-moving":
        platform(job, base, options.effort, options.seed)


if __name__ == "__main__":
    main()
