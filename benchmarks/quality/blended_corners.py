"""Blended corners against an IPOPT optimum: a line, the transfer after it and the next line, in motion all the way.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.quality.blended_corners --line 0.08 0.04 0.02 --corners 50`,
and `--corners 0 --checked 10000` for limits alone.

Corners are pairs of random targets of an SDA10F arm within its room of `long_sequences.py`, postures as the planner
chooses them; those of the comparison stay MARGIN away from position limits on their lines.

The reference is the least time from rest at the first target to rest at the second: the path parameter of each line
with piecewise constant jerk, every joint of the transfer with piecewise constant jerk, all limits, all three durations
free, from our motion as a start. Limits are constraints at the ends and in the middle of each interval; by how much
they are exceeded between them is printed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.polynomial import chebyshev

from benchmarks.jobs.long_sequences import ROOMS, write_sequence
from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.effort import EFFORTS
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.motion.stop_motion import PATH_SAMPLES
from dualarm_cli.postures import NoPosture
from dualarm_cli.postures.arm_angle import choose_posture
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.postures.stop_lines import line_path
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.composition import concatenate
from dualarm_cli.timing.launch import reversed_in_time, solve_launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair, refined_pair
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import solve_moving_transfer
from dualarm_cli.verification.motion_checks import check_agreement, check_limits

MARGIN = 0.05
"""How far lines of the comparison stay away from position limits [rad]."""
WIDTHS = EFFORTS["normal"].widths
"""Widths of steps with which ways are refined."""
DEGREE = 12
"""Of the polynomials that lines are in joint space: they differ from the exact ones by less than 1e-9 rad."""
LINE, TRANSFER = 30, 60
"""Intervals of constant jerk in each line and in the transfer."""
WITHIN = (0.0, 0.5, 1.0)
"""Where in each of them limits are constraints, as shares of it."""
DENSE = 20
"""Instants per interval at which the reference's limits are looked at afterwards."""
JOINTS = 7


@dataclass(frozen=True)
class Corner:
    """Two lines and what is between them; joints in the direction of motion."""

    retract: FloatArray
    """Joints on the first line [rad], shape (m, 7)."""
    approach: FloatArray
    """Joints on the second line [rad], shape (m, 7)."""
    length: FloatArray
    """Way on either line [m], shape (m,)."""
    limits: JointLimits
    """Of the joints."""

    @property
    def margin(self) -> float:
        """How far the lines stay away from position limits [rad]."""
        both = np.concatenate([self.retract, self.approach])
        return float(min((both - self.limits.lower).min(), (self.limits.upper - both).min()))


@dataclass(frozen=True)
class Blend:
    """Our motion through a corner."""

    pieces: tuple[Trajectory, Trajectory, Trajectory]
    """Retract, transfer, approach."""
    rest: float
    """How long it takes from rest to rest [s]."""

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return sum(piece.duration for piece in self.pieces)


def random_corners(line: float, seed: int) -> Iterator[Corner]:
    """Yields corners between random targets of the left arm of an SDA10F, one after the other, without end.

    Args:
        line: length of the lines [m].
        seed: of the generator.
    """
    with TemporaryDirectory() as folder:
        write_sequence("sda10f", 2, 0, Path(folder))
        job = load_job(Path(folder) / "tasks.yaml")
    model, home = CellModel.from_cell(job.cell), np.asarray(job.cell.robot.postures["home"])
    template = stop_problems(model, job, home, job.stages()[0])["left"]
    arm = model.arms["left"]
    limits = job.cell.robot.limits.select(arm.arm.joints)
    base = pin.SE3(*model.carried_frame(home)).inverse()
    room, random = ROOMS["sda10f"], np.random.default_rng([seed, round(line * 1e6)])
    start, last = home[arm.columns], None
    while True:
        xyz, yaw = random.uniform(room.low, room.high), random.uniform(-room.yaw, room.yaw)
        pose = base * pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, yaw), xyz)
        problem = replace(
            template,
            R_base_tool=pose.rotation[None],
            p_base_tool=pose.translation[None],
            approach=line,
            retract=line,
            start=start,
            waiting=0.0,
        )
        posture = choose_posture(problem)
        if isinstance(posture, NoPosture):
            continue
        if last is not None:
            retract, length = line_path(*last, "retract", PATH_SAMPLES)
            approach, _ = line_path(problem, posture, "approach", PATH_SAMPLES)
            yield Corner(retract, approach, length, limits)
        last, start = (problem, posture), posture.q_retract


def blend(corner: Corner) -> Blend:
    """Returns our motion through a corner, from rest to rest where that is all."""
    limits, timing = corner.limits, TIMING_SOLVERS["ruckig"]
    first = LineProblem(limits.joints, corner.retract, corner.length, limits)
    second = replace(first, position=corner.approach[::-1])
    away, back = timing.line(first), timing.line(second)
    start, goal = corner.retract[-1], corner.approach[0]
    asked = TransferProblem(limits.joints, start, goal, limits)
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    rest = float(law.duration(goal - start))
    before = Passings.along(first, away.duration, away=True)
    after = Passings.along(second, back.duration, away=False)
    pair = quickest_pair(before, after, asked, rest)
    leave, come = refined_pair((before, after), pair, asked, WIDTHS)
    retract = away if leave is None else solve_launch(first, leave)
    outward = back if come is None else solve_launch(second, come)
    approach = reversed_in_time(outward)
    leaving = np.stack([retract.velocity[-1], retract.acceleration[-1]])
    arriving = np.stack([approach.velocity[0], approach.acceleration[0]])
    whole = away.duration + rest + back.duration
    transfer = solve_moving_transfer(replace(asked, leaving=leaving, arriving=arriving))
    if transfer is None:
        return Blend((away, timing.transfer(asked), reversed_in_time(back)), whole)
    return Blend((retract, transfer, approach), whole)


class Reference:
    """The corner as a nonlinear program, for any corner of the same joints."""

    def __init__(self, limits: JointLimits) -> None:
        """Builds the program."""
        self._limits = limits
        self.line_rates = line_rates()
        size = JOINTS * (DEGREE + 1)
        lines = ca.SX.sym("lines", 2 * size)
        T = ca.SX.sym("T", 3)
        states = [ca.SX.sym(f"line{k}", 3, LINE + 1) for k in range(2)]
        jerks = [ca.SX.sym(f"jerk{k}", LINE) for k in range(2)]
        Q, J = ca.SX.sym("Q", 3 * JOINTS, TRANSFER + 1), ca.SX.sym("J", JOINTS, TRANSFER)
        terms: list[tuple[Any, float, float]] = []
        ends = []
        for k, (X, U) in enumerate(zip(states, jerks, strict=True)):
            coefficients = lines[k * size : (k + 1) * size]
            terms += [(X[:, 0], 0.0, 0.0), (X[0, -1], 1.0, 1.0), (X[1, 1:], 0.0, np.inf)]
            h = T[k] / LINE
            for i in range(LINE):
                terms.append((after(X[:, i], U[i], h) - X[:, i + 1], 0.0, 0.0))
                for share in WITHIN:
                    at = after(X[:, i], U[i], share * h)
                    _, *rates = self.line_rates(coefficients, at, U[i])
                    scales = limits.velocity, limits.acceleration, limits.jerk
                    terms += [(x / m, -1.0, 1.0) for x, m in zip(rates, scales, strict=True)]
            q, v, a, _ = self.line_rates(coefficients, X[:, -1], U[-1])
            ends.append(ca.vertcat(q, -v if k else v, a))
        terms += [(Q[:, 0] - ends[0], 0.0, 0.0), (Q[:, -1] - ends[1], 0.0, 0.0)]
        h = T[2] / TRANSFER
        for i in range(TRANSFER):
            jerk = J[:, i] * limits.jerk
            terms.append((after(Q[:, i], jerk, h) - Q[:, i + 1], 0.0, 0.0))
            middle = after(Q[:, i], jerk, h / 2.0)
            terms.append((middle[JOINTS : 2 * JOINTS] / limits.velocity, -1.0, 1.0))
        unknowns = [T, *(ca.vec(x) for x in (*states, *jerks, Q, J))]
        high = np.concatenate([limits.upper, limits.velocity, limits.acceleration])
        low = np.concatenate([limits.lower, -limits.velocity, -limits.acceleration])
        free = np.full(2 * (4 * LINE + 3), np.inf)
        unit, times = np.ones(JOINTS * TRANSFER), np.full(3, np.inf)
        self._bounds = {
            "lbx": np.concatenate([np.full(3, 1e-3), -free, np.tile(low, TRANSFER + 1), -unit]),
            "ubx": np.concatenate([times, free, np.tile(high, TRANSFER + 1), unit]),
            "lbg": np.concatenate([np.full(g.numel(), low) for g, low, _ in terms]),
            "ubg": np.concatenate([np.full(g.numel(), high) for g, _, high in terms]),
        }
        program = {
            "x": ca.vertcat(*unknowns),
            "p": lines,
            "f": ca.sum1(T),
            "g": ca.vertcat(*(ca.vec(g) for g, _, _ in terms)),
        }
        ipopt = {"print_level": 0, "sb": "yes", "max_iter": 600, "tol": 1e-6}
        options = {"print_time": False, "ipopt": ipopt | {"mu_strategy": "adaptive"}}
        self._solve = ca.nlpsol("corner", "ipopt", program, options)

    def solve(self, corner: Corner, start: Blend) -> tuple[float, float]:
        """Returns the least time [s] and the largest share of a limit used between constraints.

        Args:
            corner: the corner.
            start: any motion through it.

        Raises:
            RuntimeError: IPOPT has not converged.
        """
        outward = corner.retract, corner.approach[::-1]
        lines = [polynomials(path) for path in outward]
        found = self._solve(
            x0=self._start(outward, start),
            p=np.concatenate([line.ravel() for line in lines]),
            **self._bounds,
        )
        if not self._solve.stats()["success"]:
            raise RuntimeError(self._solve.stats()["return_status"])
        return float(found["f"]), self._excess(np.array(found["x"]).ravel(), lines)

    def _start(self, outward: tuple[FloatArray, FloatArray], start: Blend) -> FloatArray:
        """Returns all unknowns of a motion."""
        retract, transfer, approach = start.pieces
        states, jerks = [], []
        both = zip(outward, (retract, reversed_in_time(approach)), strict=True)
        for path, motion in both:
            times = np.linspace(0.0, motion.duration, LINE + 1)
            way = _shares(path, motion.at(times)[0])
            speed = np.gradient(way, times)
            rise = np.gradient(speed, times)
            speed[0] = rise[0] = 0.0
            states.append(np.column_stack([way, speed, rise]).ravel())
            jerks.append(np.diff(rise) / times[1])
        times = np.linspace(0.0, transfer.duration, TRANSFER + 1)
        q, v, a = transfer.at(times)
        jerk = np.clip(np.diff(a, axis=0) / times[1] / self._limits.jerk, -1.0, 1.0)
        durations = [retract.duration, approach.duration, transfer.duration]
        joints = np.column_stack([q, v, a]).ravel()
        return np.concatenate([durations, *states, *jerks, joints, jerk.ravel()])

    def _excess(self, x: FloatArray, lines: list[FloatArray]) -> float:
        """Returns the largest share of a limit that is used anywhere."""
        T, rest = x[:3], x[3:]
        sizes = [3 * (LINE + 1)] * 2 + [LINE] * 2 + [3 * JOINTS * (TRANSFER + 1)]
        *pieces, jerk = np.split(rest, np.cumsum(sizes))
        limits, worst = self._limits, 0.0
        scales = limits.velocity, limits.acceleration, limits.jerk
        for k, line in enumerate(lines):
            states, jerks = pieces[k].reshape(LINE + 1, 3), pieces[2 + k]
            for i in range(LINE):
                for h in np.linspace(0.0, T[k] / LINE, DENSE):
                    at = after(ca.DM(states[i]), ca.DM(jerks[i]), h)
                    _, *rates = self.line_rates(ca.DM(line.ravel()), at, jerks[i])
                    used = [
                        np.abs(np.array(x).ravel() / m) for x, m in zip(rates, scales, strict=True)
                    ]
                    worst = max(worst, float(np.max(used)))
        states, jerks = pieces[4].reshape(TRANSFER + 1, 3 * JOINTS), jerk.reshape(TRANSFER, JOINTS)
        for h in np.linspace(0.0, T[2] / TRANSFER, DENSE):
            v = states[:-1, JOINTS : 2 * JOINTS] + h * (
                states[:-1, 2 * JOINTS :] + h * jerks * limits.jerk / 2.0
            )
            worst = max(worst, float((np.abs(v) / limits.velocity).max()))
        return worst


def after(state: Any, jerk: Any, h: Any) -> Any:
    """Returns positions, speeds and accelerations after a time [s] of constant jerk, all in one column."""
    n = state.numel() // 3
    q, v, a = state[:n], state[n : 2 * n], state[2 * n :]
    return ca.vertcat(
        q + h * (v + h * (a / 2.0 + h * jerk / 6.0)), v + h * (a + h * jerk / 2.0), a + h * jerk
    )


def line_rates() -> Any:
    """Returns a function from a line's coefficients, path parameter's state and jerk to the joints' q, v, a and j."""
    coefficients = ca.SX.sym("c", JOINTS * (DEGREE + 1))
    state, jerk = ca.SX.sym("x", 3), ca.SX.sym("u")
    series = [ca.reshape(coefficients, JOINTS, DEGREE + 1)]
    for _ in range(3):
        n = series[-1].shape[1]
        # From [-1, 1] to [0, 1] a derivative doubles.
        derivative = 2.0 * np.column_stack([chebyshev.chebder(row) for row in np.eye(n)[1:]])
        series.append(series[-1][:, 1:] @ ca.DM(derivative).T)
    s, p, r = state[0], state[1], state[2]
    q, first, second, third = (_clenshaw(c, 2.0 * s - 1.0) for c in series)
    rates = [
        q,
        first * p,
        first * r + second * p**2,
        first * jerk + 3.0 * second * p * r + third * p**3,
    ]
    return ca.Function("on_line", [coefficients, state, jerk], rates)


def _clenshaw(series: Any, x: Any) -> Any:
    """Returns Chebyshev series (n, k) at x in [-1, 1]."""
    one = two = ca.SX.zeros(series.shape[0])
    for k in range(series.shape[1] - 1, 0, -1):
        one, two = 2.0 * x * one - two + series[:, k], one
    return x * one - two + series[:, 0]


def polynomials(path: FloatArray) -> FloatArray:
    """Returns Chebyshev coefficients of a line's joints, shape (DEGREE + 1, 7)."""
    x = np.linspace(-1.0, 1.0, len(path))
    found: FloatArray = chebyshev.chebfit(x, path, DEGREE)
    assert np.abs(chebyshev.chebval(x, found).T - path).max() < 1e-9
    return found


def _shares(path: FloatArray, q: FloatArray) -> FloatArray:
    """Returns the shares of a line at which postures on it are."""
    fine = np.linspace(0.0, 1.0, 2001)
    grid = np.linspace(0.0, 1.0, len(path))
    joints = np.column_stack([np.interp(fine, grid, column) for column in path.T])
    found = fine[((q[:, None] - joints) ** 2).sum(axis=2).argmin(axis=1)]
    found[[0, -1]] = 0.0, 1.0
    return found


def broken_limits(corner: Corner, found: Blend) -> list[str]:
    """Returns what the verifier finds wrong with a motion through a corner, if anything."""
    whole = concatenate(found.pieces)
    checks = [*check_limits(whole, corner.limits), *check_agreement(whole)]
    return [f"{c.name}: {c.measured} {c.detail}" for c in checks if c.verdict == "failed"]


def compare(line: float, seed: int, count: int) -> FloatArray:
    """Returns our durations over the reference's, and over those from rest to rest, shape (count, 2)."""
    rows, reference, worst, seconds = [], None, 0.0, 0.0
    for corner in random_corners(line, seed):
        if len(rows) == count:
            break
        if corner.margin < MARGIN:
            continue
        reference = reference or Reference(corner.limits)
        ours = blend(corner)
        begin = time.process_time()
        least, used = reference.solve(corner, ours)
        seconds += time.process_time() - begin
        worst = max(worst, used)
        rows.append((ours.duration / least, ours.duration / ours.rest))
    tell(f"reference: {seconds / count:.2f} s each, at most {worst:.4f} of a limit anywhere")
    return np.array(rows)


def main() -> None:
    """Prints the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    lengths = {"type": float, "nargs": "+", "default": [0.08, 0.04, 0.02]}
    parser.add_argument("--line", **lengths, help="lengths of the lines [m]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corners", type=int, default=50, help="how many are compared")
    parser.add_argument("--checked", type=int, default=0, help="of how many limits are checked")
    asked = parser.parse_args()
    if asked.corners:
        print_head(
            "corners", "lines", "/ optimum, median", "worst", "/ with stops, median", "worst"
        )
    for length in asked.line if asked.corners else ():
        ratios = compare(length, asked.seed, asked.corners)
        cells = (f"{f(column):.3f}" for column in ratios.T for f in (np.median, np.max))
        print_row(asked.corners, f"{1e3 * length:g} mm", *cells)
    if asked.checked:
        print_head("checked", "lines", "beyond a limit", "slower than with stops", "each")
    for length in asked.line if asked.checked else ():
        print_row(asked.checked, f"{1e3 * length:g} mm", *checked(length, asked))


def checked(length: float, asked: argparse.Namespace) -> tuple[int, int, str]:
    """Returns how many corners break a limit, how many are slower than with stops, and the time of each."""
    broken, slower, seconds = 0, 0, 0.0
    for corner in islice(random_corners(length, asked.seed + 1), asked.checked):
        begin = time.process_time()
        ours = blend(corner)
        seconds += time.process_time() - begin
        wrong = broken_limits(corner, ours)
        for line in wrong:
            tell(line)
        broken += bool(wrong)
        slower += ours.duration > (1.0 + 1e-9) * ours.rest
    return broken, slower, f"{1e3 * seconds / asked.checked:.1f} ms"


if __name__ == "__main__":
    main()
