"""What a random local search still finds near finished plans.

python -m benchmarks.quality.local_search [--stages 24 8 12] [--seed 1] [--efforts quick normal] [--seconds 60]

Random sequences of `long_sequences.py` on the SDA10F, planned with collision checking and blended. The search changes
one stage at a time: platform angle, arm angles at the target and at both line ends, yaw where it is free. A step that
an estimate with the launches that suit it best calls shorter is driven: timed exactly, blended with every width of
steps, and checked for collisions. It is kept if the cycle is shorter than the best one so far.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.quality.blended_cycles import sequence_job
from dualarm_cli.clearing.blended_plan import blended_plan
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.repairs import TimedPlan
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.motion import realise
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.stages.plans.launches import default_launches, with_best_launches
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.stretches import Stretch, loose_stretches
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence import decisions_of, stage_plans
from dualarm_cli.stages.sequence_problem import sequence_problem

LEAST = 1e-5
"""Estimated gain of a step that is worth driving [s]."""


def found(job: Job, effort: str, seconds: float, seed: int) -> tuple[float, float, int]:
    """Returns the cycle of a plan, the best one of the search [s], and how many steps were kept.

    Args:
        job: a job in the order of its file.
        effort: of the plan.
        seconds: processor time of the search [s].
        seed: of its steps.
    """
    work = resolve(job, PlanSettings(effort=effort))
    plan = quickest_clear(work.problem, work.method.solve, work.timing)
    numbers = sequence_problem(work.model, job)
    numbers = replace(numbers, launches=default_launches(numbers))
    stages = (plan.stopping or plan.cleared).plans
    decisions = decisions_of(numbers, work.model, stages)
    widths = work.problem.settings.sequence.refinement.widths

    def driven(decisions: Decisions) -> float:
        """Returns the cycle of decisions as they are driven [s], infinite if they cannot be."""
        moved = stage_plans(work.model, job, numbers, decisions, "sequence")
        pairs = zip(moved, stages, strict=True)
        moved = [replace(new, waits=old.waits, detours=old.detours) for new, old in pairs]
        clearing = plan.clearing(work.problem, work.timing)
        try:
            motion = realise(work.model, job, moved, work.timing, plan.cache)
            if clearing is None or clearing.colliding_stages(moved, motion):
                return np.inf
            tried = replace(plan, cleared=TimedPlan(moved, motion), rivals=(), stopping=None)
            return blended_plan(work.problem, tried, work.timing, widths=widths).cleared.duration
        except InfeasibleError:
            return np.inf

    best, kept = searched(numbers, decisions, driven, plan, (seconds, seed))
    return plan.cleared.duration, best, kept


def searched(
    numbers: SequenceProblem,
    decisions: Decisions,
    driven: Callable[[Decisions], float],
    plan: ClearedPlan,
    given: tuple[float, int],
) -> tuple[float, int]:
    """Returns the least cycle found [s] and how many steps were kept; `given` are seconds and seed."""
    seconds, seed = given
    random, end = np.random.default_rng(seed), time.process_time() + seconds
    best, kept = plan.cleared.duration, 0
    while time.process_time() < end:
        loose = np.arange(numbers.stages) == random.integers(numbers.stages)
        whole = evaluate(replace(numbers, launches=None), decisions)
        (stretch,) = loose_stretches(numbers, whole, loose)
        part = decisions.take(stretch.stages)
        now, variables = estimate(stretch, part), Variables.of(stretch.problem, stretch.loose)
        for _ in range(10):
            size = variables.count
            step = 10.0 ** random.uniform(-3.0, -0.7) * random.normal(size=size)
            moved = variables.moved(part, step * (random.random(size) < random.uniform(0.2, 1.0)))
            if estimate(stretch, moved) > now - LEAST:
                continue
            tried = stretch.put(decisions, moved)
            if (cycle := driven(tried)) < best - LEAST:
                best, decisions, kept = cycle, tried, kept + 1
                break
    return best, kept


def estimate(stretch: Stretch, part: Decisions) -> float:
    """Returns the time of a stretch with the launches that suit it best [s]."""
    plan = evaluate(replace(stretch.problem, launches=None), part)
    if not np.isfinite(plan.total):
        return np.inf
    return with_best_launches(stretch.problem, plan)[1].total


def main() -> None:
    """Prints one row per job and effort."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--stages", type=int, nargs="+", default=[24, 8, 12])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--efforts", nargs="+", choices=list(EFFORTS), default=["quick", "normal"])
    parser.add_argument("--seconds", type=float, default=60.0)
    given = parser.parse_args()
    print("| stages | effort | cycle | found | shorter by | steps kept |")
    print("| --- | --- | --- | --- | --- | --- |")
    for stages in given.stages:
        for effort in given.efforts:
            cycle, best, kept = found(
                sequence_job(given.seed, stages), effort, given.seconds, given.seed
            )
            print(
                f"| {stages} | {effort} | {cycle:.3f} s | {best:.3f} s | {1.0 - best / cycle:.2%} | {kept} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
