"""Planner of one seam: its joints, timing, approach and retract."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.linear_systems import solve
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam, SeamMotion, SeamProblem
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.closed_chain.closing import all_equations
from dualarm_cli.kinds.seam.closed_chain.starts import seam_starts
from dualarm_cli.kinds.seam.messages import seam_refusal, where_it_fails
from dualarm_cli.kinds.seam.motion import is_too_fast, timed_seam
from dualarm_cli.kinds.seam.path import SeamPath
from dualarm_cli.kinds.seam.record import PlannedSeam, quicker_seam
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.process_work import SeamWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.motion.torque_limits import least_slowing
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem


@dataclass(frozen=True)
class SeamPlanSettings:
    """Settings of the planning of a seam."""

    seam_line_samples: int = 65
    """Number of places along a line at which joints are solved."""
    steps: int = 6
    """Newton steps from one place to the next."""
    exact: float = 1e-9
    """Residual below which an equation counts as solved [m and rad]."""
    knots: tuple[int, ...] = (24, 48, 96, 192, 384)
    """Numbers of knots, tried until the tool is near enough to its line."""
    near: float = 5e-5
    """Tolerance of the tool's line [m] and orientation [rad]: half of the verified one."""
    looked_at: float = 0.01
    """Time between the postures of a seam that are tested for collisions [s]."""
    rounds: int = 3
    """Number of draws of starts that are tried in turn."""
    enough_refusals: int = 2
    """Number of refusals for too high speed after which no more starts are tried."""
    steady_share: float = 0.8
    """Approximate fraction of a given duration at steady speed. Solvers ignore ramps."""
    closed: float = 2e-7
    """Largest residual of a closed chain at the start of a seam [m, rad].

    It covers the rounding of files.
    """
    slowed: float = 1.0005
    """Ratio of times or speeds above which a seam misses its requirement."""
    kept_at_nodes: float = SLACK / 2.0
    """Distance kept beyond the required clearance at a seam's nodes [m]."""
    kept_between: float = SLACK / 4.0
    """Distance kept beyond the required clearance at the postures between nodes [m]."""


SEAM = SeamPlanSettings()


def trace_retract(
    chain: Chain, limits: JointLimits, position: FloatArray, length: float
) -> FloatArray | Refusal:
    """Trace the joints while the tool retracts along its axis.

    Only the slave's own joints move, by Newton steps of least norm.

    Args:
        chain: part and tool.
        limits: of all joints.
        position: joints at the seam [rad], shape (n,).
        length: of the retract [m].

    Returns:
        Joints [rad], shape (`seam_line_samples`, n), or the reason why the tool cannot retract.
    """
    bodies_at_seam = chain.bodies(position[None])
    R, p, axis = bodies_at_seam.R_tool[0], bodies_at_seam.p_tool[0], -bodies_at_seam.R_tool[0, :, 2]
    weight = np.square(limits.velocity) * chain.slave_joints
    positions = np.empty((SEAM.seam_line_samples, len(position)))
    positions[0] = q = np.array(position)
    for k in range(1, SEAM.seam_line_samples):
        p_goal = p + axis * (length * k / (SEAM.seam_line_samples - 1))
        if k > 1:
            q = 2.0 * positions[k - 1] - positions[k - 2]
        for _ in range(SEAM.steps):
            bodies = chain.bodies(q[None])
            error = np.append(
                bodies.p_tool[0] - p_goal, log_rotation(product(bodies.R_tool[0], R.T))
            )
            if np.abs(error).max() < SEAM.exact:
                break
            JW = bodies.J_tool[0] * weight
            gram = product(JW, bodies.J_tool[0].T)
            q = q - product(JW.T, solve(gram + 1e-12 * np.eye(6), error))
        distance = {"mm": length * k / (SEAM.seam_line_samples - 1) * 1e3}
        if np.abs(error).max() > 100.0 * SEAM.exact:
            return Refusal("seam_line_out_of_reach", arm=chain.work.slave, data=distance)
        beyond = np.maximum(limits.lower - q, q - limits.upper) * chain.slave_joints
        if beyond.max() > 0.0:
            joint = limits.joints[int(np.argmax(beyond))]
            return Refusal("seam_line_at_limit", data={"joint": joint, **distance})
        positions[k] = q
    return positions


def line_motion(
    chain: Chain,
    position: FloatArray,
    length: float,
    limits: JointLimits,
    timing: TimingSolver,
    tool_speed: float | None,
) -> Trajectory | Refusal:
    """Time the motion along a line, or explain why there is none.

    Args:
        chain: part and tool.
        position: joints along it, in the order of the motion [rad], shape (k, n).
        length: of the line [m].
        limits: of all joints.
        timing: solver of lines.
        tool_speed: cap on the tool's speed [m/s], or None.
    """
    distances = np.linspace(0.0, length, len(position))
    ends = chain.bodies(position[[0, -1]])
    R, start = ends.R_tool[0], ends.p_tool[0]
    along = (ends.p_tool[1] - start) / length
    deviation = np.inf
    for knots in SEAM.knots:
        motion = timing.line(
            LineProblem(limits.joints, position, distances, limits, tool_speed, knots)
        )
        middle = (motion.time[1:] + motion.time[:-1]) / 2.0
        bodies = chain.bodies(motion.clamped(middle)[0])
        travelled = bodies.p_tool - start
        lateral = travelled - product(travelled, along)[:, None] * along
        rotations = log_rotation(product(bodies.R_tool, R.T))
        deviation = max(
            float(norm(lateral, axis=1).max()),
            float(norm(rotations, axis=1).max()),
        )
        if deviation <= SEAM.near:
            return motion
    return Refusal(
        "seam_line_left", measured=deviation, allowed=SEAM.near, data={"mm": deviation * 1e3}
    )


def seam_holding(job: Job, work: SeamWork) -> Holding:
    """Return the clearances while the tool works.

    It may touch the part, but not penetrate it.
    """
    cell, tool = job.cell, f"{work.slave}_tool"
    contacts = tuple((tool, body, -OVERLAP) for body in work.touches)
    cell = replace(cell, clearances=(*cell.clearances, *contacts))
    return Holding.of(replace(job, cell=cell, tasks=()))


def clearance_test(holding: Holding) -> Callable[[FloatArray], BoolArray]:
    """Create the test of configurations (k, n) [rad] for clearance, (k,)."""

    def is_free(position: FloatArray) -> BoolArray:
        return np.asarray(_margins(holding, position) >= SEAM.kept_at_nodes)

    return is_free


def nearest_bodies(holding: Holding, position: FloatArray) -> Refusal:
    """Describe the two nearest bodies at a configuration (n,) [rad]."""
    held_parts = holding.cell.loads.nothing(len(holding.cell.arms))
    body_a, body_b, missing = holding.cell.nearest(position, held_parts)
    return Refusal(
        "touches", measured=max(0.0, -missing), data={"body_a": body_a, "body_b": body_b}
    )


def worst_collision(
    holding: Holding, motions: Sequence[tuple[str, Trajectory | None]]
) -> Refusal | None:
    """Find the deepest collision of the first colliding motion, or None.

    Args:
        holding: bodies and clearances.
        motions: descriptions and motions, or None.
    """
    for words, motion in motions:
        if motion is None:
            continue
        count = max(2, int(np.ceil(motion.duration / SEAM.looked_at)) + 1)
        time = np.linspace(0.0, motion.duration, count)
        position = motion.clamped(time)[0]
        margin = _margins(holding, position)
        k = int(np.argmin(margin))
        if margin[k] < SEAM.kept_between:
            data = {"where": words, "time": time[k], "cause": nearest_bodies(holding, position[k])}
            return Refusal("seam_touches", data=data)
    return None


def _margins(holding: Holding, position: FloatArray) -> FloatArray:
    held_parts = holding.cell.loads.nothing(len(position), len(holding.cell.arms))
    return holding.cell.margins(position, held_parts)


@dataclass(frozen=True)
class _Start:
    """Begin of one attempt."""

    current: FloatArray
    """All joints before the seam [rad], shape (n,)."""
    begin: FloatArray | None = None
    """Required joints at the start of the seam [rad], shape (n,); None for any."""
    number: int = 0
    """Number of the attempt, which varies the random starts."""


@dataclass(frozen=True)
class SeamPlanner:
    """Planner of seams."""

    job: Job
    """The whole job."""
    timing: TimingSolver
    """Timing solver of lines. Trapezoid also determines the seam's ramps."""
    effort: str
    """quick, normal or thorough."""
    seed: int
    """Seed of the random starts."""
    check_collisions: bool
    """Whether collisions are checked."""
    free_start: bool = False
    """Whether the motion may start anywhere.

    No transfer to the seam is needed then.
    """
    requested: str | None = None
    """Name of the requested seam solver; None for the file's choice."""
    dynamics: Dynamics | None = None
    """Torques that limit seams; None for no limit."""

    def plan(
        self, task: str, work: SeamWork, current: FloatArray, after: SeamWork | None = None
    ) -> PlannedSeam:
        """Plan a seam with its approach and retract.

        Args:
            task: its name, for messages.
            work: the seam.
            current: all joints before it [rad], shape (n,); the platform stays unless turning it helps.
            after: the next seam, if any; it continues from the end of this one if it begins there.

        Raises:
            InfeasibleError: it cannot be worked as required, with the first place and the reason.
            UnsupportedError: the named seam solver does not support it.
        """
        chain = Chain(self.job.cell, work)
        holding = seam_holding(self.job, work) if self.check_collisions else None
        can_continue = self._continuation_test(after)
        attempts = [(_Start(current, number=k), can_continue) for k in range(SEAM.rounds)]
        if work.approach == 0.0 and _is_closed(chain, current):
            attempts.insert(0, (_Start(current, current), can_continue))
        if can_continue is not None:
            # A transfer between both seams is better than no plan.
            attempts.append((_Start(current), None))
        refusals: list[Refusal] = []
        for start, can_continue in attempts:
            if can_continue is not None and sum(map(is_too_fast, refusals)) >= SEAM.enough_refusals:
                continue
            planned = self._quickest(
                task, self._problem(chain, start, holding, can_continue), holding
            )
            if isinstance(planned, PlannedSeam):
                return planned
            refusals += planned
            if can_continue is None and sum(map(is_too_fast, refusals)) >= SEAM.enough_refusals:
                break
        # "Too fast" is the most useful reason: less speed would do.
        cause = min(refusals, key=lambda refusal: not is_too_fast(refusal))
        raise InfeasibleError(seam_refusal(task, work, cause))

    def _quickest(
        self, task: str, problem: SeamProblem, holding: Holding | None
    ) -> PlannedSeam | list[Refusal]:
        """Plan the quickest seam by the selected solvers, or list the reasons of each."""
        planned, refusals = [], []
        for name in self._solvers(task, problem):
            attempt = self._worked(problem, holding, name)
            if isinstance(attempt, Refusal):
                refusals.append(attempt)
                continue
            planned.append(attempt)
            if self.job.tool_speed is None and not self._falls_short(attempt, problem.chain.work):
                break
        if not planned:
            return refusals
        return min(planned, key=lambda plan: plan.seam.trajectory.duration)

    def _continuation_test(self, after: SeamWork | None) -> Callable[[FloatArray], bool] | None:
        """Create the test whether the next seam can start from joints (n,) [rad].

        None unless it begins with the tool and the part in the poses in which the one before ends.
        """
        if after is None or after.approach > 0.0:
            return None
        chain = Chain(self.job.cell, after)

        def can_continue(end: FloatArray) -> bool:
            if not _is_closed(chain, end):
                return True
            problem = self._problem(chain, _Start(end, end), None, None)
            return seam_starts(problem).failure is None

        return can_continue

    def _problem(
        self,
        chain: Chain,
        start: _Start,
        holding: Holding | None,
        can_continue: Callable[[FloatArray], bool] | None,
    ) -> SeamProblem:
        robot, work = self.job.cell.robot, chain.work
        reference = None if work.posture is None else np.array(robot.postures[work.posture])
        time = (
            work.duration * SEAM.steady_share
            if work.duration is not None
            else work.length / (work.speed or np.inf)
        )
        return SeamProblem(
            chain=chain,
            limits=self.job.limits,
            start=start.current,
            reference=reference,
            begin=start.begin,
            time=time / self.job.speed,
            samples=EFFORTS[self.effort].seam_samples,
            improved_starts=EFFORTS[self.effort].seam_starts,
            seed=self.seed + start.number,
            transfer_times=self._transfer_times(start.current),
            can_continue=can_continue,
            is_free=None if holding is None else clearance_test(holding),
            nearest_bodies=None if holding is None else partial(nearest_bodies, holding),
        )

    def _transfer_times(self, start: FloatArray) -> Callable[[FloatArray], FloatArray] | None:
        """Create the function of straight transfer times from a configuration."""
        if self.free_start:
            return None
        limits = self.job.limits
        return lambda position: np.array([float(limits.law.duration(q - start)) for q in position])

    def _solvers(self, task: str, problem: SeamProblem) -> list[str]:
        """Select the requested solver, or the first two that support the seam.

        The second one is for seams that the first cannot work, or not as fast as required. Solvers know neither ramps
        nor a cap on the tools' speed, which can make a moving part the worse choice.

        Raises:
            UnsupportedError: the requested solver does not support the seam.
        """
        work = problem.chain.work
        named = self.requested or work.method
        if named is not None:
            if reason := SEAM_SOLVERS[named].why_unsupported(problem):
                raise UnsupportedError(f"{work.place}: task '{task}': method {named}: {reason}")
            return [named]
        supporting = [
            solver.name for solver in SEAM_SOLVERS if solver.why_unsupported(problem) is None
        ]
        return supporting[:2]

    def _worked(
        self, problem: SeamProblem, holding: Holding | None, name: str
    ) -> PlannedSeam | Refusal:
        """Plan the seam by one solver, or explain why there is none."""
        motion = SEAM_SOLVERS[name].solve(problem)
        if isinstance(motion, NoSeam):
            return where_it_fails(problem.chain.work, motion)
        planned = self._timed(problem, motion, name)
        if motion.time <= problem.time and self._falls_short(planned, problem.chain.work):
            # The solver stopped at the required speed without ramps: repeat for the greatest speed.
            faster = SEAM_SOLVERS[name].solve(replace(problem, time=0.0))
            if isinstance(faster, SeamMotion):
                planned = quicker_seam(planned, self._timed(problem, faster, name))
        if isinstance(planned, Refusal) or holding is None:
            return planned
        motions = (
            ("on the approach", planned.approach),
            ("along the seam", planned.seam.trajectory),
            ("on the retract", planned.retract),
        )
        collision = worst_collision(holding, motions)
        return planned if collision is None else collision

    def _falls_short(self, planned: PlannedSeam | Refusal, work: SeamWork) -> bool:
        """Test whether a seam is refused as too fast, or slower than required."""
        if isinstance(planned, Refusal):
            return is_too_fast(planned)
        if work.duration is not None:
            return planned.seam.trajectory.duration > work.duration / self.job.speed * SEAM.slowed
        assert work.speed is not None
        return planned.seam.speed(work.length) * SEAM.slowed < work.speed * self.job.speed

    def _timed(self, problem: SeamProblem, motion: SeamMotion, name: str) -> PlannedSeam | Refusal:
        """Time a solver's joints, with the tool's lines, or explain why it fails."""
        chain, work, limits = problem.chain, problem.chain.work, problem.limits
        path = SeamPath.of(problem, motion)
        if path is None:
            return Refusal("seam_comes_apart")
        cap = np.inf
        if self.job.tool_speed is not None:
            cap = self.job.tool_speed / float(path.tool_rates(self.job.cell).max())
        trapezoid = self.timing.name == "trapezoid"
        seam = timed_seam(path, work, limits, self.job.speed, trapezoid=trapezoid, cap=cap)
        if isinstance(seam, Refusal):
            return seam
        if self.dynamics is not None and work.slower:
            # The same motion, slower as a whole: its torques fall, but for those at rest.
            factor, _ = least_slowing(self.dynamics, seam.trajectory)
            if 1.0 < factor < np.inf:
                less = limits.scaled(1.0 / factor)
                pace = self.job.speed / factor
                seam = timed_seam(path, work, less, pace, trapezoid=trapezoid, cap=cap)
                if isinstance(seam, Refusal):
                    return seam
        lines: dict[str, Trajectory | None] = {"approach": None, "retract": None}
        for line, length, end in (("approach", work.approach, 0), ("retract", work.retract, -1)):
            if length == 0.0:
                continue
            back = trace_retract(chain, limits, seam.trajectory.position[end], length)
            if isinstance(back, Refusal):
                return Refusal("seam_line", data={"line": line, "cause": back})
            positions = back[::-1] if end == 0 else back
            motion_on_line = line_motion(
                chain, positions, length, limits, self.timing, self.job.tool_speed
            )
            if isinstance(motion_on_line, Refusal):
                return Refusal("seam_line", data={"line": line, "cause": motion_on_line})
            lines[line] = motion_on_line
        q, joints = seam.trajectory.position, limits.joints
        return PlannedSeam(
            approach=lines["approach"],
            dwell_start=hold(joints, q[0], work.dwell_start),
            seam=seam,
            dwell_end=hold(joints, q[-1], work.dwell_end),
            retract=lines["retract"],
            solver=name,
            chain=chain,
        )


def _is_closed(chain: Chain, position: FloatArray) -> bool:
    """Test whether joints (n,) [rad] have tool and part at the seam's start."""
    share = np.zeros(1)
    given = chain.work.master is not None and chain.work.hold.given
    poses = chain.work.hold.at(share) if given else None
    residuals = all_equations(chain, position[None], share, part=poses).residuals
    return bool(np.abs(residuals).max() < SEAM.closed)
