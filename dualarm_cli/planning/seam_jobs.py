"""One coordinate task: where it is worked, how fast, how the tool comes and leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.closed_chain import SEAM_SOLVERS, NoSeam, SeamMotion, SeamProblem
from dualarm_cli.closed_chain.chain import Chain
from dualarm_cli.closed_chain.closing import all_equations
from dualarm_cli.closed_chain.starts import seam_starts
from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.holding import Holding
from dualarm_cli.planning.seam_lines import drawn_back, line_motion
from dualarm_cli.planning.seam_motion import TOO_FAST, TimedSeam, timed_seam
from dualarm_cli.planning.seam_path import SeamPath
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.rest_to_rest import RestToRest

SAMPLES = {"quick": 500, "normal": 1500, "thorough": 5000}
"""Configurations that are drawn as starts of a seam, by effort."""
TRIED = {"quick": 2, "normal": 5, "thorough": 12}
"""Starts that are improved, by effort."""
ROUNDS = 3
"""How often other starts are drawn where what comes of the first ones cannot be worked."""
LOOKED_AT = 0.01
"""Time between the postures of a seam that are looked at [s]."""
CAP_USED = 0.998
"""Share of a cap on the tools' speed that seams use: knots are joined by curves."""
ENOUGH_REFUSALS = 2
"""So many times too fast, and other starts will be as well."""
TOGETHER = 1e-6
"""Residual up to which the robot counts as having tool and part where a seam begins [m, radians by TURN]."""
STEADY_SHARE = 0.8
"""Share of a given duration in which the tool is at its steady speed, about: solvers know no ramps."""


@dataclass(frozen=True)
class PlannedSeam:
    """A seam with the tool's way to it and from it."""

    approach: Trajectory | None
    """To where it begins; None for no length."""
    dwell_start: Trajectory
    """Standing where it begins."""
    seam: TimedSeam
    """The seam."""
    dwell_end: Trajectory
    """Standing where it ends."""
    retract: Trajectory | None
    """Away from it; None for no length."""
    solver: str
    """Name of the seam solver."""
    chain: Chain
    """Part and tool."""
    steady: float
    """Least time for the seam at a steady speed, ramps not counted [s]."""

    @property
    def first(self) -> FloatArray:
        """All joints where the tool's approach begins [rad], shape (n,)."""
        start: FloatArray = (self.approach or self.seam.trajectory).position[0]
        return start

    @property
    def duration(self) -> float:
        """How long all of it takes [s]."""
        lines = [line.duration for line in (self.approach, self.retract) if line is not None]
        return sum(lines) + sum(
            part.duration for part in (self.dwell_start, self.seam.trajectory, self.dwell_end)
        )


@dataclass(frozen=True)
class SeamPlanner:
    """What seams are planned with."""

    job: Job
    """The whole job."""
    model: CellModel
    """Its cell."""
    timing: TimingSolver
    """How lines are timed; trapezoid also decides the seam's ramps."""
    effort: str
    """quick, normal or thorough."""
    seed: int
    """Of what is drawn."""
    clear: bool
    """Whether anything has to keep clear."""
    free_start: bool = False
    """Whether the motion may start anywhere, so that there is no way to where the seam begins."""
    asked: str | None = None
    """Name of the seam solver that was asked for; None for the file's choice."""

    def plan(
        self, task: str, work: SeamWork, start: FloatArray, after: SeamWork | None = None
    ) -> PlannedSeam:
        """Returns the seam as it is worked.

        Args:
            task: its name, for messages.
            work: the seam.
            start: all joints before [rad], shape (n,); a platform stands as there unless it helps to turn it.
            after: the seam that comes next, if one does: where it begins where this one ends, it goes on from there.

        Raises:
            InfeasibleError: it cannot be worked as the file asks, with the first place and the reason.
            UnsupportedError: the named seam solver does not serve it.
        """
        chain = Chain(self.job.cell, work)
        holding = self._holding(work) if self.clear else None
        refusals: list[str] = []
        first: PlannedSeam | None = None
        begins: list[FloatArray | None] = [None] * ROUNDS
        if work.approach == 0.0 and _together(chain, start):
            begins.insert(0, start)
        for k, begin in enumerate(begins):
            problem = self._problem(chain, start, holding, k, begin)
            name = self._solver(problem)
            solver = SEAM_SOLVERS[name]
            if reason := solver.why_unsupported(problem):
                raise UnsupportedError(f"{work.place}: task '{task}': method {name}: {reason}")
            motion = solver.solve(problem)
            if isinstance(motion, NoSeam):
                refusals.append(_nowhere(work, motion))
                continue
            found = self._timed(problem, motion, holding, name)
            if isinstance(found, str):
                refusals.append(found)
                if sum(TOO_FAST in reason for reason in refusals) == ENOUGH_REFUSALS:
                    break
            elif self._goes_on(found, after):
                return found
            else:
                first = first or found
        if first is not None:
            return first
        raise InfeasibleError(f"{work.place}: task '{task}' ({_who(work)}): {refusals[0]}")

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
            problem = self._problem(chain, end, None, (0, end, None))
            return seam_starts(problem).failure is None

        return goes_on

    def _problem(
        self,
        chain: Chain,
        start: FloatArray,
        holding: Holding | None,
        number: int,
        begin: FloatArray | None,
    ) -> SeamProblem:
        robot, work = self.job.cell.robot, chain.work
        near = None if work.posture is None else np.array(robot.postures[work.posture])
        time = (
            work.duration * STEADY_SHARE
            if work.duration is not None
            else work.length / (work.speed or np.inf)
        )
        return SeamProblem(
            chain=chain,
            limits=robot.limits.scaled(self.job.speed),
            start=start,
            near=near,
            begin=begin,
            time=time / self.job.speed,
            samples=SAMPLES[self.effort],
            tried=TRIED[self.effort],
            seed=self.seed + number,
            coming=self._coming(start),
            clear=None if holding is None else _test(holding),
        )

    def _coming(self, start: FloatArray) -> Callable[[FloatArray], FloatArray] | None:
        """Returns how long straight transfers from a configuration take."""
        if self.free_start:
            return None
        limits = self.job.cell.robot.limits.scaled(self.job.speed)
        law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
        return lambda position: np.array([float(law.duration(q - start)) for q in position])

    def _solver(self, problem: SeamProblem) -> str:
        """Returns the solver that was asked for, or the first one that serves."""
        named = self.asked or problem.chain.work.method
        if named is not None:
            return named
        return next(one.name for one in SEAM_SOLVERS if one.why_unsupported(problem) is None)

    def _holding(self, work: SeamWork) -> Holding:
        """Returns what has to keep clear while the tool works: it may touch the part, not reach into it."""
        cell = self.job.cell
        tool = f"{work.slave}_tool"
        contacts = tuple((tool, body, -OVERLAP) for body in work.touches)
        cell = replace(cell, clearances=(*cell.clearances, *contacts))
        return Holding.of(replace(self.job, cell=cell, tasks=()))

    def _timed(
        self, problem: SeamProblem, motion: SeamMotion, holding: Holding | None, name: str
    ) -> PlannedSeam | str:
        """Returns a solver's answer in time, with the tool's lines, or why there is none."""
        chain, work, limits = problem.chain, problem.chain.work, problem.limits
        path = SeamPath.of(problem, motion)
        if path is None:
            return (
                "the joints that were found for it do not keep tool and part together between them"
            )
        trapezoid = self.timing.name == "trapezoid"
        seam = timed_seam(
            path, work, limits, self.job.speed, trapezoid=trapezoid, most=self._capped(path)
        )
        if isinstance(seam, str):
            return seam
        lines: dict[str, Trajectory | None] = {"approach": None, "retract": None}
        for line, length, end in (("approach", work.approach, 0), ("retract", work.retract, -1)):
            if length == 0.0:
                continue
            back = drawn_back(chain, limits, seam.trajectory.position[end], length)
            if isinstance(back, str):
                return f"{line}: {back}"
            way = back[::-1] if end == 0 else back
            found = line_motion(chain, way, length, limits, self.timing, self.job.tool_speed)
            if isinstance(found, str):
                return f"{line}: {found}"
            lines[line] = found
        q = seam.trajectory.position
        joints = limits.joints
        planned = PlannedSeam(
            lines["approach"],
            hold(joints, q[0], work.dwell_start),
            seam,
            hold(joints, q[-1], work.dwell_end),
            lines["retract"],
            name,
            chain,
            motion.time,
        )
        return planned if holding is None else self._touching(planned, holding) or planned

    def _capped(self, path: SeamPath) -> float:
        """Returns the steady speed at which the quickest tool comes to the cap on tools, in seams a second [1/s]."""
        if self.job.tool_speed is None:
            return float("inf")
        arms = list(self.model.arms)
        tools = self.model.tool_positions(arms, path.position)
        rate = np.gradient(tools, 1.0 / (len(path.position) - 1), axis=1)
        fastest = float(np.linalg.norm(rate, axis=-1).max())
        return self.job.tool_speed * CAP_USED / max(fastest, 1e-9)

    def _touching(self, planned: PlannedSeam, holding: Holding) -> str | None:
        """Returns where a planned seam does not keep clear, or None."""
        for words, motion in (
            ("on the approach", planned.approach),
            ("along the seam", planned.seam.trajectory),
            ("on the retract", planned.retract),
        ):
            if motion is None:
                continue
            count = max(2, int(np.ceil(motion.duration / LOOKED_AT)) + 1)
            time = np.linspace(0.0, motion.duration, count)
            position = motion.at(time)[0]
            held = np.zeros((count, len(holding.cell.arms)), dtype=np.int64)
            margin = holding.cell.margins(position, held)
            k = int(np.argmin(margin))
            if margin[k] < SLACK / 4.0:
                one, other, missing = holding.cell.nearest(position[k], held[k])
                lack = max(0.0, -missing) * 1e3
                return f"{words}, after {time[k]:.3f} s, {one} and {other} lack {lack:.1f} mm of clearance"
        return None


def _together(chain: Chain, position: FloatArray) -> bool:
    """Returns whether joints (n,) [rad] have tool and part where the seam begins."""
    share = np.zeros(1)
    poses = chain.work.hold.at(share) if chain.work.hold.given else None
    left = all_equations(chain, position[None], share, part=poses).size
    return bool(left[0] < TOGETHER)


def _test(holding: Holding) -> Callable[[FloatArray], BoolArray]:
    """Returns a test of which configurations (k, n) [rad] keep clear."""

    def clear(position: FloatArray) -> BoolArray:
        held = np.zeros((len(position), len(holding.cell.arms)), dtype=np.int64)
        return np.asarray(holding.cell.margins(position, held) >= SLACK / 2.0)

    return clear


def _nowhere(work: SeamWork, found: NoSeam) -> str:
    """Returns why no joints were found, with the first place that fails."""
    length = work.length * 1e3
    if found.share >= 1.0:
        return found.reason
    from_here = f"{found.share * length:.1f} mm along the seam of {length:.1f} mm"
    return f"fails {from_here}: {found.reason}"


def _who(work: SeamWork) -> str:
    return work.slave if work.master is None else f"{work.slave} on the part in {work.master}"
