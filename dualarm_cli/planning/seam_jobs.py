"""One coordinate task: where it is worked, how fast, how the tool comes and leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.closed_chain import SEAM_SOLVERS, NoSeam, SeamMotion, SeamProblem
from dualarm_cli.closed_chain.chain import Chain
from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.holding import Holding
from dualarm_cli.planning.seam_lines import drawn_back, line_motion
from dualarm_cli.planning.seam_motion import TimedSeam, timed_seam
from dualarm_cli.planning.seam_path import SeamPath
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold

SAMPLES = {"quick": 300, "normal": 800, "thorough": 2400}
"""Configurations that are drawn as starts of a seam, by effort."""
TRIED = {"quick": 2, "normal": 4, "thorough": 10}
"""Starts that are improved, by effort."""
ROUNDS = 3
"""How often other starts are drawn where what comes of the first ones cannot be worked."""
LOOKED_AT = 0.01
"""Time between the postures of a seam that are looked at [s]."""
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
    timing: TimingSolver
    """How lines are timed; trapezoid also decides the seam's ramps."""
    effort: str
    """quick, normal or thorough."""
    seed: int
    """Of what is drawn."""
    clear: bool
    """Whether anything has to keep clear."""
    asked: str | None = None
    """Name of the seam solver that was asked for; None for the file's choice."""

    def plan(self, task: str, work: SeamWork, start: FloatArray) -> PlannedSeam:
        """Returns the seam as it is worked.

        Args:
            task: its name, for messages.
            work: the seam.
            start: all joints before [rad], shape (n,); a platform stands as there unless it helps to turn it.

        Raises:
            InfeasibleError: it cannot be worked as the file asks, with the first place and the reason.
        """
        chain = Chain(self.job.cell, work)
        holding = self._holding(work) if self.clear else None
        refusals: list[str] = []
        for k in range(ROUNDS):
            problem = self._problem(chain, start, holding, k)
            planned: list[PlannedSeam] = []
            for name in self._solvers(problem):
                solver = SEAM_SOLVERS[name]
                if reason := solver.why_unsupported(problem):
                    raise InfeasibleError(f"{work.place}: task '{task}': method {name}: {reason}")
                motion = solver.solve(problem)
                if isinstance(motion, NoSeam):
                    refusals.append(_nowhere(work, motion))
                    continue
                found = self._timed(problem, motion, holding, name)
                if isinstance(found, PlannedSeam):
                    planned.append(found)
                else:
                    refusals.append(found)
            if planned:
                return min(planned, key=lambda one: one.seam.trajectory.duration)
        raise InfeasibleError(f"{work.place}: task '{task}' ({_who(work)}): {refusals[0]}")

    def _problem(
        self, chain: Chain, start: FloatArray, holding: Holding | None, round_number: int
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
            time=time / self.job.speed,
            samples=SAMPLES[self.effort],
            tried=TRIED[self.effort],
            seed=self.seed + round_number,
            clear=None if holding is None else _test(holding),
        )

    def _solvers(self, problem: SeamProblem) -> list[str]:
        """Returns the solver that was asked for, or the first one that serves.

        Solvers know of no cap on the tools' speed, under which a part that moves may be worth less than one that
        stands: there both are tried.
        """
        named = self.asked or problem.chain.work.method
        if named is not None:
            return [named]
        serve = [one.name for one in SEAM_SOLVERS if one.why_unsupported(problem) is None]
        return serve[: 1 if self.job.tool_speed is None else 2]

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
        cap = np.inf
        if self.job.tool_speed is not None:
            cap = self.job.tool_speed / float(path.tool_rates(self.job.cell).max())
        seam = timed_seam(path, work, limits, self.job.speed, trapezoid=trapezoid, cap=cap)
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
