"""Closed-form inverse kinematics, vectorised, against one pose at a time and against a library.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.speed.inverse_kinematics`. Everything is timed in one
process on the same arm (iiwa 14) and targets; quote the ratios, not the times. Every solution
counted is checked by forward kinematics, outside the timing.

The library's solver is a damped least-squares loop over pinocchio's Jacobians. It gives one posture
per pose, near its start; it is compared with our one branch per pose on the same poses, at once and
one call at a time. All eight branches over the arm angle are a job it does not do.

Six-axis arms with a spherical wrist are solved in closed form against our own numeric inverse (damped least squares
from many starts), on the same poses, eight branches each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.joint_axes import SrsGeometry
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.kinematics.wrist_arm import WristArm

HEIGHTS = (0.1575, 0.2025, 0.2045, 0.2155, 0.1845, 0.2155, 0.081)
"""Distances between the joint frames of an iiwa 14 [m]; the flange is 0.045 m above the last."""
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1.0]])
"""Its joint axes at q = 0."""
LIMITS = np.deg2rad([170, 120, 170, 120, 170, 120, 175])
"""Its joint limits, both sides [rad]."""
SHAPES = ((1, 10_000), (500, 72), (5_000, 1), (100, 1))
"""Numbers of targets and of arm angles per target."""
SINGLES = 300
"""Poses that are solved one at a time."""
EXACT = 1e-9
"""Largest error of a solution that counts, in m and of a rotation matrix's elements."""
DAMPING = 1e-6
ITERATIONS = 200
NEAR = 0.2
"""How far the library's solver starts from a solution, each joint [rad]."""

INDUSTRIAL = np.array(
    [
        [0, 0, 0.335],
        [0.35, 0, 0.335],
        [1.55, 0, 0.335],
        [2.6, 0, 0.335],
        [2.6, 0, 0.335],
        [2.6, 0, 0.335],
    ]
)
"""Points on the axes of an industrial arm of 1.2 and 1.05 m links, stretched forwards [m]."""
INDUSTRIAL_AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0.0]])
"""Its joint axes at q = 0; the flange is 0.1 m beyond the wrist."""
SKEW = np.array([0.3, 0.9, 0.3]) / np.linalg.norm([0.3, 0.9, 0.3])
"""A third axis that is not parallel to the second: postures by a quartic."""
WRIST_POSES, NUMERIC_POSES = 1_000, 100
"""Poses that are solved in closed form, and numerically."""


def main() -> None:
    """Prints the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7, help="best of so many runs")
    repeat = parser.parse_args().repeat
    arm, model = _arm(), _model()
    rng = np.random.default_rng(1)
    q = rng.uniform(-LIMITS, LIMITS, (5_000, 7))
    R, p = arm.forward(q)
    print(f"{'what':46} {'postures/s':>14} {'us per call':>12}")
    rates = [_vectorised(arm, R, p, n, m, repeat) for n, m in SHAPES]
    single = _one_at_a_time(arm, R, p, repeat)
    library = _library(model, arm, q, R, p)
    one = _one_branch(arm, q[:SINGLES], R[:SINGLES], p[:SINGLES], repeat)
    _one_branch(arm, q, R, p, repeat)
    call = _one_branch_singly(arm, q, R, p, repeat)
    seconds = _best(lambda: arm.feasible_arm_angles(R, p), repeat)
    per_target = 1e6 * seconds / len(q)
    print(f"{'feasible intervals, 8 branches, per target':46} {'':>14} {per_target:12.2f}")
    wrist = [_wrist(name, third, repeat) for name, third in (("parallel", None), ("skew", SKEW))]
    print(f"\nall branches: best vectorised / one pose at a time {max(rates) / single:12.0f}")
    print(f"all branches: 5,000 targets / one pose at a time   {rates[2] / single:12.0f}")
    print(f"one posture, same {SINGLES} poses: ours at once / library {one / library:12.0f}")
    print(f"one posture, same {SINGLES} poses: our calls / library    {call / library:12.2f}")
    print(f"spherical wrist: numeric / closed, us per pose     {wrist[0]:12.0f}")
    print(f"spherical wrist, axes 2 and 3 skew: the same       {wrist[1]:12.0f}")


def _arm() -> SrsArm:
    points = np.zeros((7, 3))
    points[:, 2] = np.cumsum(HEIGHTS)
    flange = np.array([0.0, 0.0, sum(HEIGHTS) + 0.045])
    return SrsArm(SrsGeometry.measure(AXES, points, np.eye(3), flange), -LIMITS, LIMITS)


def _model() -> pin.Model:
    model, parent = pin.Model(), 0
    for k, (height, axis) in enumerate(zip(HEIGHTS, AXES, strict=True)):
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        joint = pin.JointModelRevoluteUnaligned(*axis)
        parent = model.addJoint(parent, joint, placement, f"joint{k + 1}")
    flange = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.045]))
    model.addFrame(pin.Frame("flange", parent, flange, pin.FrameType.OP_FRAME))
    return model


def _wrist_arm(third: FloatArray | None) -> WristArm:
    """Returns the industrial arm, its third axis as it is or another one."""
    axes = INDUSTRIAL_AXES.copy()
    if third is not None:
        axes[2] = third
    model, parent, at = pin.Model(), 0, np.zeros(3)
    for k, (axis, point) in enumerate(zip(axes, INDUSTRIAL, strict=True)):
        joint = pin.JointModelRevoluteUnaligned(*axis)
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), point - at), f"joint{k + 1}")
        at = point
    flange = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    model.addFrame(pin.Frame("flange", parent, flange, pin.FrameType.OP_FRAME))
    names = [f"joint{k + 1}" for k in range(6)]
    limits = np.full(6, -np.pi), np.full(6, np.pi)
    return WristArm.of(GeneralArm.from_model(model, names, "flange", pin.SE3.Identity(), limits))


def _wrist(name: str, third: FloatArray | None, repeat: int) -> float:
    """Returns how many times quicker the closed forms of a spherical wrist are than the numeric inverse."""
    arm = _wrist_arm(third)
    q = np.random.default_rng(3).uniform(-3.0, 3.0, (WRIST_POSES, 6))
    R, p = arm.forward(q)
    found = arm.solve(R, p)
    pose, branch = np.nonzero(found.reachable)
    _check(arm, found.q[pose, branch], R[pose], p[pose])
    closed = _best(lambda: arm.solve(R, p), repeat) / WRIST_POSES
    what = f"wrist, axes 2, 3 {name}: closed, {WRIST_POSES} poses"
    _report(what, len(pose) / WRIST_POSES / closed, closed)
    general = GeneralArm(*(getattr(arm, field.name) for field in fields(GeneralArm)))
    R, p = R[:NUMERIC_POSES], p[:NUMERIC_POSES]
    theirs = general.postures(R, p)
    _check(arm, theirs.q, R[theirs.pose], p[theirs.pose])
    numeric = _best(lambda: general.postures(R, p), 1) / NUMERIC_POSES
    what = f"wrist, axes 2, 3 {name}: numeric, {NUMERIC_POSES} poses"
    _report(what, len(theirs.q) / NUMERIC_POSES / numeric, numeric)
    return numeric / closed


def _best(run: Callable[[], object], repeat: int) -> float:
    """Returns the shortest of several runs [s]; on a shared machine the least disturbed one."""
    run()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def _report(what: str, rate: float, seconds: float) -> float:
    print(f"{what:46} {rate:14,.0f} {seconds * 1e6:12.2f}")
    return rate


def _check(arm: SrsArm | GeneralArm, q: FloatArray, R: FloatArray, p: FloatArray) -> None:
    R_found, p_found = arm.forward(q)
    error = max(float(np.abs(R_found - R).max()), float(np.abs(p_found - p).max()))
    if error > EXACT:
        raise SystemExit(f"a solution misses its pose by {error:.2e}; {EXACT:.0e} is allowed")


def _vectorised(arm: SrsArm, R: FloatArray, p: FloatArray, n: int, m: int, repeat: int) -> float:
    psi = np.linspace(-np.pi, np.pi, m, endpoint=False)
    R, p = R[:n, None], p[:n, None]
    _check(arm, arm.solve(R, p, psi).q, R[:, :, None], p[:, :, None])
    seconds = _best(lambda: arm.solve(R, p, psi), repeat)
    return _report(f"all branches, {n} targets x {m} arm angles", 8 * n * m / seconds, seconds)


def _one_branch(arm: SrsArm, q: FloatArray, R: FloatArray, p: FloatArray, repeat: int) -> float:
    psi, branch = arm.arm_angle(q), arm.branch(q)
    _check(arm, arm.solve_branch(R, p, psi, branch)[0], R, p)
    seconds = _best(lambda: arm.solve_branch(R, p, psi, branch), repeat)
    return _report(f"one branch each, {len(q)} targets", len(q) / seconds, seconds)


def _one_at_a_time(arm: SrsArm, R: FloatArray, p: FloatArray, repeat: int) -> float:
    def run() -> None:
        for k in range(SINGLES):
            arm.solve(R[k], p[k], 0.3)

    seconds = _best(run, repeat) / SINGLES
    return _report("all branches, one pose at a time", 8 / seconds, seconds)


def _one_branch_singly(
    arm: SrsArm, q: FloatArray, R: FloatArray, p: FloatArray, repeat: int
) -> float:
    psi, branch = arm.arm_angle(q), arm.branch(q)

    def run() -> None:
        for k in range(SINGLES):
            arm.solve_branch(R[k], p[k], psi[k], branch[k])

    seconds = _best(run, repeat) / SINGLES
    return _report("one branch, one pose at a time", 1 / seconds, seconds)


def _library(model: pin.Model, arm: SrsArm, q: FloatArray, R: FloatArray, p: FloatArray) -> float:
    """Returns postures per second of the library's loop, its start NEAR a solution."""
    data, frame = model.createData(), model.getFrameId("flange")
    start = q[:SINGLES] + np.random.default_rng(2).uniform(-NEAR, NEAR, (SINGLES, 7))
    targets = [pin.SE3(R[k], p[k]) for k in range(SINGLES)]
    begin = time.perf_counter()
    found = [_clik(model, data, frame, targets[k], start[k]) for k in range(SINGLES)]
    seconds = (time.perf_counter() - begin) / SINGLES
    solved = [k for k in range(SINGLES) if found[k] is not None]
    _check(arm, np.array([found[k] for k in solved]), R[solved], p[solved])
    share = len(solved) / SINGLES
    name = f"pinocchio least squares, {len(solved)} of {SINGLES} solved"
    return _report(name, share / seconds, seconds)


def _clik(
    model: pin.Model, data: pin.Data, frame: int, target: pin.SE3, q: FloatArray
) -> FloatArray | None:
    """Returns joints at the target by damped least squares, or None after ITERATIONS."""
    for _ in range(ITERATIONS):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(target)).vector
        if np.abs(error).max() < 0.1 * EXACT:
            return q
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        q = q + J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), error)
    return None


if __name__ == "__main__":
    main()
