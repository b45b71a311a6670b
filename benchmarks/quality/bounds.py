"""How far lower bounds are below plans, and what they cost: random sequences, with all stops and blended, by effort.

python -m benchmarks.quality.bounds --sequences 20 --stages 24 --efforts quick,normal,thorough
python -m benchmarks.quality.bounds --perturbed 10000

Random sequences of `long_sequences.py` on the SDA10F, lines of 80 mm, dwells of 0.15 s. Printed are gaps (how far the
bound is below the plan of the same effort), medians and the least and largest, and the bound's processor time as a
share of the planning's. No bound may be above its plan: the command fails if one is. With `--perturbed` so many plans
are compared instead: plans of the search whose platform angles and arm angles are moved at random, a little or a lot.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from multiprocessing import Pool

import numpy as np

from benchmarks.quality.blended_cycles import sequence_job
from benchmarks.tables import print_head, print_row
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.stages.plans.launches import default_launches, with_best_launches
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence_problem import sequence_problem


@dataclass(frozen=True)
class Measured:
    """One sequence, with one effort and one kind of blending."""

    gap: float
    """How far the bound is below the plan, as a share of the plan."""
    cost: float
    """Processor time of the bound as a share of the planning's."""


def measured(given: tuple[int, int, str, str]) -> Measured:
    """Returns what a seed's sequence of so many stages gives, by effort and `--blend`."""
    seed, stages, effort, blend = given
    job = sequence_job(seed, stages)
    begin = time.process_time()
    schedule = plan_without_bound(job, PlanSettings(blend=blend, effort=effort))
    planned = time.process_time()
    bound = job_bound(job, effort, blend).value or 0.0
    bounded = time.process_time()
    return Measured(1.0 - bound / schedule.duration, (bounded - planned) / (planned - begin))


def perturbed(given: tuple[int, int, int, str]) -> tuple[int, float]:
    """Returns how many plans about one of a seed's sequence are possible, and the bound over the shortest of them.

    Every 25th blended plan has the launches that suit it best, the others those of a search's start.

    Args:
        given: seed, stages, how many plans are tried, and `--blend`.
    """
    seed, stages, count, blend = given
    job, random = sequence_job(seed, stages), np.random.default_rng(seed)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    bound = job_bound(job, "normal", blend).value or 0.0
    found = search(problem, [], "quick", seed)
    assert found is not None  # these sequences have plans
    moving = blend == "lines"
    launched = replace(problem, launches=default_launches(problem)) if moving else problem
    variables = Variables.of(problem)
    lengths = []
    for k in range(count):
        step = 10.0 ** random.uniform(-3.0, 0.0) * random.normal(size=variables.count)
        step *= random.random(variables.count) < random.uniform(0.02, 1.0)
        plan = evaluate(launched, variables.moved(found.best.decisions, step))
        if not np.isfinite(plan.total):
            continue
        if moving and k % 25 == 0:
            _, plan = with_best_launches(launched, plan)
        lengths.append(plan.total)
    return len(lengths), bound / min(lengths, default=np.inf)


def main() -> int:
    """Measures and prints; returns 1 if a bound is above its plan."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--efforts", default="quick,normal")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--perturbed", type=int, default=0)
    options = parser.parse_args()
    good = True
    with Pool(options.processes) as pool:
        if options.perturbed:
            each = options.perturbed // options.sequences
            seeds, tried_plans = range(1, options.sequences + 1), each * options.sequences
            print_head("", "plans", "possible", "bound / plan, at most")
            for blend in ("none", "lines"):
                tried = [(seed, options.stages, each, blend) for seed in seeds]
                pairs = pool.map(perturbed, tried, 1)
                most, possible = max(ratio for _, ratio in pairs), sum(n for n, _ in pairs)
                print_row(f"`--blend {blend}`", tried_plans, possible, f"{most:.3f}")
                good &= most <= 1.0
            return 0 if good else 1
        print_head("effort", "sequences", "", "bound below the plan", "time / planning's")
        for effort in options.efforts.split(","):
            for blend in ("none", "lines"):
                seeds = range(1, options.sequences + 1)
                rows = pool.map(measured, [(s, options.stages, effort, blend) for s in seeds], 1)
                gaps, costs = (np.array([getattr(r, k) for r in rows]) for k in ("gap", "cost"))
                print_row(
                    effort,
                    len(gaps),
                    f"`--blend {blend}`",
                    f"{np.median(gaps):.1%} ({gaps.min():.1%} to {gaps.max():.1%})",
                    f"{np.median(costs):.2f}",
                )
                good &= bool((gaps >= 0.0).all())
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
