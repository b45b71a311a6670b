"""One coordinate task: where it is worked, how fast, how the tool comes and leaves."""

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
from dualarm_cli.kinds.seam.record import PlannedSeam, quicker
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem


@dataclass(frozen=True)
class SeamPlanSettings:
    """Numbers that steer the planning of a seam."""

    seam_line_samples: int = 65
    """Places along a line at which joints are solved for."""
    steps: int = 6
    """Newton steps from one place to the next."""
    exact: float = 1e-9
    """Residual that counts as none [m and rad]."""
    knots: tuple[int, ...] = (24, 48, 96, 192, 384)
    """Numbers of knots that are tried until the tool stays near enough to its line."""
    near: float = 5e-5
    """Tolerance of the tool's line [m] and orientation [rad]: half of the verified one."""
    looked_at: float = 0.01
    """Time between the postures of a seam that are looked at [s]."""
    rounds: int = 3
    """Number of draws of starts that are tried in turn."""
    enough_refusals: int = 2
    """Number of refusals for too high speed after which no more starts are tried."""
    steady_share: float = 0.8
    """Share of a given duration in which the tool is at its steady speed, about: solvers know no ramps."""
    together: float = 2e-7
    """Largest residual of robot, tool and part where a seam begins [m, rad].

    It covers the rounding of files.
    """
    slowed: float = 1.0005
    """Factor on time or speed above which a seam falls short of what is asked."""
    kept_at_nodes: float = SLACK / 2.0
    """Distance kept beyond the required clearance at a seam's nodes [m]."""
    kept_between: float = SLACK / 4.0
    """Distance kept beyond the required clearance at the postures between nodes [m]."""


SEAM = SeamPlanSettings()


def drawn_back(
    chain: Chain, limits: JointLimits, position: FloatArray, length: float
) -> FloatArray | Refusal:
    """Trace the joints while the tool is drawn back along its axis.

    Only the slave's own joints move, by Newton steps of least norm.

    Args:
        chain: part and tool.
        limits: of all joints.
        position: where the tool is [rad], shape (n,).
        length: how far it is drawn back [m].

    Returns:
        Joints [rad], shape (`seam_line_samples`, n), or the reason why the tool cannot be drawn back.
    """
    here = chain.bodies(position[None])
    R, p, back = here.R_tool[0], here.p_tool[0], -here.R_tool[0, :, 2]
    weight = np.square(limits.velocity) * chain.slave_joints
    found = np.empty((SEAM.seam_line_samples, len(position)))
    found[0] = q = np.array(position)
    for k in range(1, SEAM.seam_line_samples):
        there = p + back * (length * k / (SEAM.seam_line_samples - 1))
        if k > 1:
            q = 2.0 * found[k - 1] - found[k - 2]
        for _ in range(SEAM.steps):
            bodies = chain.bodies(q[None])
            left = np.append(bodies.p_tool[0] - there, log_rotation(product(bodies.R_tool[0], R.T)))
            if np.abs(left).max() < SEAM.exact:
                break
            JW = bodies.J_tool[0] * weight
            gram = product(JW, bodies.J_tool[0].T)
            q = q - product(JW.T, solve(gram + 1e-12 * np.eye(6), left))
        away = {"mm": length * k / (SEAM.seam_line_samples - 1) * 1e3}
        if np.abs(left).max() > 100.0 * SEAM.exact:
            return Refusal("seam_line_out_of_reach", arm=chain.work.slave, more=away)
        beyond = np.maximum(limits.lower - q, q - limits.upper) * chain.slave_joints
        if beyond.max() > 0.0:
            joint = limits.joints[int(np.argmax(beyond))]
            return Refusal("seam_line_at_limit", more={"joint": joint, **away})
        found[k] = q
    return found


def line_motion(
    chain: Chain,
    position: FloatArray,
    length: float,
    limits: JointLimits,
    timing: TimingSolver,
    tool_speed: float | None,
) -> Trajectory | Refusal:
    """Returns the motion along a line, or why there is none.

    Args:
        chain: part and tool.
        position: joints along it, in the order of the motion [rad], shape (k, n).
        length: of the line [m].
        limits: of all joints.
        timing: how lines are timed.
        tool_speed: cap on the tool's speed [m/s], or None.
    """
    way = np.linspace(0.0, length, len(position))
    ends = chain.bodies(position[[0, -1]])
    R, start = ends.R_tool[0], ends.p_tool[0]
    along = (ends.p_tool[1] - start) / length
    off = np.inf
    for knots in SEAM.knots:
        found = timing.line(LineProblem(limits.joints, position, way, limits, tool_speed, knots))
        middle = (found.time[1:] + found.time[:-1]) / 2.0
        bodies = chain.bodies(found.at(middle)[0])
        gone = bodies.p_tool - start
        beside = gone - product(gone, along)[:, None] * along
        turned = log_rotation(product(bodies.R_tool, R.T))
        off = max(
            float(norm(beside, axis=1).max()),
            float(norm(turned, axis=1).max()),
        )
        if off <= SEAM.near:
            return found
    return Refusal("seam_line_left", measured=off, allowed=SEAM.near, more={"mm": off * 1e3})


def seam_holding(job: Job, work: SeamWork) -> Holding:
    """Returns what has to be collision-free while the tool works: it may touch the part, not reach into it."""
    cell, tool = job.cell, f"{work.slave}_tool"
    contacts = tuple((tool, body, -OVERLAP) for body in work.touches)
    cell = replace(cell, clearances=(*cell.clearances, *contacts))
    return Holding.of(replace(job, cell=cell, tasks=()))


def clearance_test(holding: Holding) -> Callable[[FloatArray], BoolArray]:
    """Returns a test of which configurations (k, n) [rad] are collision-free, (k,)."""

    def clear(position: FloatArray) -> BoolArray:
        return np.asarray(_margins(holding, position) >= SEAM.kept_at_nodes)

    return clear


def nearest_bodies(holding: Holding, position: FloatArray) -> Refusal:
    """Returns which bodies come nearest at a configuration (n,) [rad]."""
    held = holding.cell.loads.nothing(len(holding.cell.arms))
    one, other, missing = holding.cell.nearest(position, held)
    return Refusal("touches", measured=max(0.0, -missing), more={"one": one, "other": other})


def where_it_touches(
    holding: Holding, motions: Sequence[tuple[str, Trajectory | None]]
) -> Refusal | None:
    """Returns where motions collide, or None.

    Args:
        holding: what has to.
        motions: each with words for where it is; None for none.
    """
    for words, motion in motions:
        if motion is None:
            continue
        count = max(2, int(np.ceil(motion.duration / SEAM.looked_at)) + 1)
        time = np.linspace(0.0, motion.duration, count)
        position = motion.at(time)[0]
        margin = _margins(holding, position)
        k = int(np.argmin(margin))
        if margin[k] < SEAM.kept_between:
            more = {"where": words, "time": time[k], "cause": nearest_bodies(holding, position[k])}
            return Refusal("seam_touches", more=more)
    return None


def _margins(holding: Holding, position: FloatArray) -> FloatArray:
    held = holding.cell.loads.nothing(len(position), len(holding.cell.arms))
    return holding.cell.margins(position, held)


@dataclass(frozen=True)
class _Start:
    """How one try begins."""

    here: FloatArray
    """All joints where the robot is [rad], shape (n,)."""
    begin: FloatArray | None = None
    """Joints in which the seam has to begin [rad], shape (n,); None where any will do."""
    number: int = 0
    """Number of the try: each draws anew."""


@dataclass(frozen=True)
class SeamPlanner:
    """What seams are planned with."""

    job: Job
    """The whole job."""
    timing: TimingSolver
    """How lines are timed; trapezoid also decides the seam's ramps."""
    effort: str
    """quick, normal or thorough."""
    seed: int
    """Of what is drawn."""
    clear: bool
    """Whether anything has to be collision-free."""
    free_start: bool = False
    """Whether the motion may start anywhere, so that no motion to the start of the seam is needed."""
    asked: str | None = None
    """Name of the seam solver that was asked for; None for the file's choice."""

    def plan(
        self, task: str, work: SeamWork, here: FloatArray, after: SeamWork | None = None
    ) -> PlannedSeam:
        """Returns the seam as it is worked.

        Args:
            task: its name, for messages.
            work: the seam.
            here: all joints before [rad], shape (n,); a platform stands as there unless it helps to turn it.
            after: the seam that comes next, if one does: where it begins where this one ends, it goes on from there.

        Raises:
            InfeasibleError: it cannot be worked as the file asks, with the first place and the reason.
            UnsupportedError: the named seam solver does not serve it.
        """
        chain = Chain(self.job.cell, work)
        holding = seam_holding(self.job, work) if self.clear else None
        goes_on = self._goes_on(after)
        tries = [(_Start(here, number=k), goes_on) for k in range(SEAM.rounds)]
        if work.approach == 0.0 and _together(chain, here):
            tries.insert(0, (_Start(here, here), goes_on))
        if goes_on is not None:
            # Better with a way in between than not at all.
            tries.append((_Start(here), None))
        refusals: list[Refusal] = []
        for start, test in tries:
            if test is not None and sum(map(is_too_fast, refusals)) >= SEAM.enough_refusals:
                continue
            planned = self._tried(task, self._problem(chain, start, holding, test), holding)
            if isinstance(planned, PlannedSeam):
                return planned
            refusals += planned
            if goes_on is None and sum(map(is_too_fast, refusals)) >= SEAM.enough_refusals:
                break
        # That less speed would do says more than that something else was in the way of another try.
        cause = min(refusals, key=lambda one: not is_too_fast(one))
        raise InfeasibleError(seam_refusal(task, work, cause))

    def _tried(
        self, task: str, problem: SeamProblem, holding: Holding | None
    ) -> PlannedSeam | list[Refusal]:
        """Returns the quickest seam by the solvers that are taken, or why there is none by each."""
        planned, refusals = [], []
        for name in self._solvers(task, problem):
            found = self._worked(problem, holding, name)
            if isinstance(found, Refusal):
                refusals.append(found)
                continue
            planned.append(found)
            if self.job.tool_speed is None and not self._falls_short(found, problem.chain.work):
                break
        if not planned:
            return refusals
        return min(planned, key=lambda one: one.seam.trajectory.duration)

    def _goes_on(self, after: SeamWork | None) -> Callable[[FloatArray], bool] | None:
        """Returns a test of joints (n,) [rad] in which a seam ends: whether the next can be worked from there at once.

        Only where it begins in the part's pose and the tool's place in which the one before ends.
        """
        if after is None or after.approach > 0.0:
            return None
        chain = Chain(self.job.cell, after)

        def goes_on(end: FloatArray) -> bool:
            if not _together(chain, end):
                return True
            problem = self._problem(chain, _Start(end, end), None, None)
            return seam_starts(problem).failure is None

        return goes_on

    def _problem(
        self,
        chain: Chain,
        start: _Start,
        holding: Holding | None,
        goes_on: Callable[[FloatArray], bool] | None,
    ) -> SeamProblem:
        robot, work = self.job.cell.robot, chain.work
        near = None if work.posture is None else np.array(robot.postures[work.posture])
        time = (
            work.duration * SEAM.steady_share
            if work.duration is not None
            else work.length / (work.speed or np.inf)
        )
        return SeamProblem(
            chain=chain,
            limits=self.job.limits,
            start=start.here,
            near=near,
            begin=start.begin,
            time=time / self.job.speed,
            samples=EFFORTS[self.effort].seam_samples,
            tried=EFFORTS[self.effort].seam_starts,
            seed=self.seed + start.number,
            coming=self._coming(start.here),
            goes_on=goes_on,
            clear=None if holding is None else clearance_test(holding),
            what_touches=None if holding is None else partial(nearest_bodies, holding),
        )

    def _coming(self, here: FloatArray) -> Callable[[FloatArray], FloatArray] | None:
        """Returns how long straight transfers from a configuration take."""
        if self.free_start:
            return None
        limits = self.job.limits
        return lambda position: np.array([float(limits.law.duration(q - here)) for q in position])

    def _solvers(self, task: str, problem: SeamProblem) -> list[str]:
        """Returns the solver that was asked for, or the first one that serves.

        Then also the next one that serves: for where the first one's answer cannot be worked, or not as fast as asked:
        solvers know neither ramps nor a cap on the tools' speed, by which a part that moves may be worth less.

        Raises:
            UnsupportedError: the one that was asked for does not serve.
        """
        work = problem.chain.work
        named = self.asked or work.method
        if named is not None:
            if reason := SEAM_SOLVERS[named].why_unsupported(problem):
                raise UnsupportedError(f"{work.place}: task '{task}': method {named}: {reason}")
            return [named]
        serve = [one.name for one in SEAM_SOLVERS if one.why_unsupported(problem) is None]
        return serve[:2]

    def _worked(
        self, problem: SeamProblem, holding: Holding | None, name: str
    ) -> PlannedSeam | Refusal:
        """Returns the seam by one solver, or why there is none."""
        motion = SEAM_SOLVERS[name].solve(problem)
        if isinstance(motion, NoSeam):
            return where_it_fails(problem.chain.work, motion)
        planned = self._timed(problem, motion, name)
        if motion.time <= problem.time and self._falls_short(planned, problem.chain.work):
            # The solver ended where it thought it fast enough, ramps not counted: now as fast as it can.
            faster = SEAM_SOLVERS[name].solve(replace(problem, time=0.0))
            if isinstance(faster, SeamMotion):
                planned = quicker(planned, self._timed(problem, faster, name))
        if isinstance(planned, Refusal) or holding is None:
            return planned
        motions = (
            ("on the approach", planned.approach),
            ("along the seam", planned.seam.trajectory),
            ("on the retract", planned.retract),
        )
        touched = where_it_touches(holding, motions)
        return planned if touched is None else touched

    def _falls_short(self, planned: PlannedSeam | Refusal, work: SeamWork) -> bool:
        """Returns whether a seam is refused as too fast, or slower than the file asks."""
        if isinstance(planned, Refusal):
            return is_too_fast(planned)
        if work.duration is not None:
            return planned.seam.trajectory.duration > work.duration / self.job.speed * SEAM.slowed
        assert work.speed is not None
        return planned.seam.speed(work.length) * SEAM.slowed < work.speed * self.job.speed

    def _timed(self, problem: SeamProblem, motion: SeamMotion, name: str) -> PlannedSeam | Refusal:
        """Returns a solver's answer in time, with the tool's lines, or why there is none."""
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
        lines: dict[str, Trajectory | None] = {"approach": None, "retract": None}
        for line, length, end in (("approach", work.approach, 0), ("retract", work.retract, -1)):
            if length == 0.0:
                continue
            back = drawn_back(chain, limits, seam.trajectory.position[end], length)
            if isinstance(back, Refusal):
                return Refusal("seam_line", more={"line": line, "cause": back})
            way = back[::-1] if end == 0 else back
            found = line_motion(chain, way, length, limits, self.timing, self.job.tool_speed)
            if isinstance(found, Refusal):
                return Refusal("seam_line", more={"line": line, "cause": found})
            lines[line] = found
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


def _together(chain: Chain, position: FloatArray) -> bool:
    """Returns whether joints (n,) [rad] have tool and part where the seam begins."""
    share = np.zeros(1)
    given = chain.work.master is not None and chain.work.hold.given
    poses = chain.work.hold.at(share) if given else None
    left = all_equations(chain, position[None], share, part=poses).left
    return bool(np.abs(left).max() < SEAM.together)
