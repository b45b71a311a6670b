"""What it costs that both arms start every stage together, where only the platform couples them.

python -m benchmarks.quality.stage_barrier [--stages 8] [--seeds 1 2 3] [--jobs 02_two_trays 04_packing] [--tries 6000]

Plans of normal effort, timed twice by the estimate of the search: stage by stage, and with each arm by itself. Then the
platform leaves when the last tool is off its line, and no line begins before it has arrived; nothing else makes an arm
wait. First with the plan's postures, then with those of a random local search under either timing, one stage at a time,
as many tries each. Arms may collide in the latter: without collisions less is left.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.quality.blended_cycles import sequence_job
from benchmarks.tables import print_head, print_row
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.stages.plans.launches import default_launches, with_best_launches
from dualarm_cli.stages.plans.passing import transfer_times
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import (
    Evaluated,
    TransferChain,
    evaluate,
    left_with,
    platform_times,
    rest_times,
    start_angle,
    start_joints,
)
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem

TASKS = Path(__file__).parents[2] / "tasks"
BUNDLED = ("02_two_trays", "04_packing", "07_two_shelves", "08_narrow_bin", "14_two_grippers")
RENEWAL = 400
"""Tries after which launches are chosen again."""

Timing = Callable[[SequenceProblem, Evaluated], float]
"""Cycle of a plan [s], infinite if it is not possible."""


def by_stages(_: SequenceProblem, plan: Evaluated) -> float:
    """Returns the cycle of arms that start every stage together [s]."""
    return plan.total


def by_themselves(problem: SequenceProblem, plan: Evaluated) -> float:
    """Returns the cycle of arms that wait for the platform alone [s]."""
    if not np.isfinite(plan.total):
        return np.inf
    angle = np.concatenate([[start_angle(problem, plan.decisions.angle)], plan.decisions.angle])
    turns = platform_times(problem, np.diff(angle))
    arms = [_times(problem, a, plan) for a in range(len(problem.arms))]
    clocks = [0.0] * len(arms)
    for k in range(problem.stages):
        turned = max(clocks) + turns[k]
        for a, times in enumerate(arms):
            if np.isfinite(times[k, 0]):
                transfer, line, retract = times[k]
                clocks[a] = max(clocks[a] + transfer, turned) + line + retract
    ends = [clock + times[-1, 0] for clock, times in zip(clocks, arms, strict=True)]
    home = platform_times(problem, angle[:1] - angle[-1:]) if problem.returns else np.zeros(1)
    return max(*ends, max(clocks) + float(home[0]))


def _times(problem: SequenceProblem, a: int, plan: Evaluated) -> FloatArray:
    """Returns an arm's transfer, approach with dwell, and retract by stage [s], shape (n + 1, 3).

    The last row is the return; rows without work are infinite, the return's 0.
    """
    work, postures = problem.arms[a], plan.arms[a]
    chain = TransferChain.of(work)
    k, previous = chain.active, chain.previous[chain.active]
    times = np.full((problem.stages + 1, 3), np.inf)
    times[-1] = 0.0
    if not len(k):
        return times
    start = start_joints(problem, work, chain, postures)
    q_from = np.where(previous[:, None] >= 0, postures.q_retract[previous], start)
    leaving = q_from[:, None], left_with(postures, previous)[:, None]
    arriving = postures.q_approach[k, None], postures.rates[k, None, 0]
    times[k, 0] = transfer_times(work, leaving, arriving)[:, 0, 0]
    times[k, 2] = (postures.retract.max(axis=1) * postures.shares[:, 1])[k]
    times[k, 1] = postures.work[k] - times[k, 2]
    if problem.returns:
        angle = plan.decisions.angle
        last = postures.q_retract[k[-1:]], angle[-1:]
        home = start[None], np.array([start_angle(problem, angle)])
        times[-1, 0] = rest_times(problem, work, np.array([problem.stages]), last, home)[0]
    return times


def searched(
    problem: SequenceProblem, plan: Evaluated, timing: Timing, tries: int
) -> tuple[SequenceProblem, Evaluated]:
    """Returns the best plan near another one that random steps of single stages find, with its launches."""
    random = np.random.default_rng(1)
    stages = np.arange(problem.stages)
    variables = [Variables.of(problem, stages == k) for k in stages]
    best, least, renewed = plan, timing(problem, plan), plan
    for i in range(1, tries + 1):
        loose = variables[random.integers(problem.stages)]
        size = 10.0 ** random.uniform(-3.0, -0.7) * random.normal(size=loose.count)
        step = size * (random.random(loose.count) < random.uniform(0.2, 1.0))
        moved = evaluate(problem, loose.moved(best.decisions, step))
        if (time := timing(problem, moved)) < least:
            best, least = moved, time
        if i % RENEWAL == 0 and best is not renewed:
            launched, suited = with_best_launches(problem, best, near=True)
            if (time := timing(launched, suited)) < least:
                problem, best, least = launched, suited, time
            renewed = best
    return problem, best


def estimated(job: Job) -> tuple[float, SequenceProblem, Evaluated]:
    """Returns the cycle of a plan of normal effort [s], and the plan as the search times it, with its problem."""
    work = resolve(job, PlanSettings(effort="normal"))
    found = quickest_clear(work.problem, work.method.solve, work.timing)
    numbers = sequence_problem(work.model, job)
    decisions = decisions_of(numbers, work.model, (found.stopping or found.cleared).plans)
    at_rest = evaluate(numbers, decisions)
    launched = replace(numbers, launches=default_launches(numbers))
    return found.cleared.duration, *with_best_launches(launched, at_rest)


def compared(job: Job, tries: int) -> tuple[float, float, float]:
    """Returns the cycle of a plan [s], and what arms by themselves take of it: as planned, and as searched."""
    cycle, problem, plan = estimated(job)
    cycles = [
        timing(*searched(problem, plan, timing, tries)) for timing in (by_stages, by_themselves)
    ]
    kept = by_themselves(problem, plan) / by_stages(problem, plan)
    return cycle, kept, cycles[1] / cycles[0]


def jobs(given: argparse.Namespace) -> Iterator[tuple[str, Job]]:
    """Yields the jobs with their names."""
    for seed in given.seeds:
        yield f"random, {given.stages} stages, {seed}", sequence_job(seed, given.stages)
    for name in given.jobs:
        yield f"`{name}`", load_job(TASKS / name / "tasks.yaml")


def main() -> None:
    """Prints one row per job."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--stages", type=int, default=8)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--jobs", nargs="*", default=BUNDLED)
    parser.add_argument("--tries", type=int, default=6000)
    given = parser.parse_args()
    print_head("job", "cycle", "gain, the same postures", "gain, postures anew")
    for name, job in jobs(given):
        cycle, kept, anew = compared(job, given.tries)
        print_row(name, f"{cycle:.3f} s", f"{1.0 - kept:.2%}", f"{1.0 - anew:.2%}")


if __name__ == "__main__":
    main()
