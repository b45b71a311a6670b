"""Local optimisation of a plan: linear and random steps, combined stage by stage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.launches import with_best_launches
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate, held
from dualarm_cli.stages.search.corridor import Pool, best_combination, combined
from dualarm_cli.stages.search.linear_steps import linear_step
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.variables import Variables


@dataclass(frozen=True)
class Polishing:
    """Local optimisation of plans of one sequence."""

    problem: SequenceProblem
    """The sequence."""
    seed: int = 0
    """Seed of the random steps."""
    loose: BoolArray | None = None
    """Stages in which something may change, shape (n,); None for all."""
    follows_rates: bool = False
    """Whether linear steps follow the rates at the ends of lines that are passed in motion."""

    @property
    def at_rest(self) -> Polishing:
        """The same optimisation with all line ends at rest."""
        return replace(self, problem=replace(self.problem, launches=None))

    def polished(
        self, start: Evaluated, rounds: int, random_steps: int, first: int = 0
    ) -> Evaluated:
        """Polish a plan; the result is never slower.

        Every round offers each stage shares of the linear step and some random steps; dynamic programming combines
        them.

        Args:
            start: a possible plan.
            rounds: maximum number of rounds.
            random_steps: number of random steps that are offered besides.
            first: number of the first round; odd rounds shift the windows of linear steps.
        """
        problem, settings = self.problem, self.problem.settings
        shares = settings.step_shares
        variables = Variables.of(problem, self.loose)
        if not variables.count:
            return start
        # Importing numpy's random module takes time: only if needed.
        random = np.random.default_rng(self.seed) if random_steps else None
        best, radius = start, settings.first_radius
        for k in range(first, first + rounds):
            radii = np.full(problem.stages + 1, radius)
            follows = self.follows_rates and problem.launches is not None
            step = linear_step(problem, variables, best, radii, k, follows_rates=follows)
            steps = np.vstack(
                [np.outer(shares, step), _random_steps(random, variables, radius, random_steps)]
            )
            moved = [_within(problem, variables.moved(best.decisions, row)) for row in steps]
            pool = Pool.of(problem, best, moved)
            combination = combined(problem, pool, best)
            if problem.returns:
                # An idle arm's return depends on distant stages: only whole steps show its cost.
                whole = [pool.plan(np.full(problem.stages, m + 1)) for m in range(len(shares))]
                combination = _best(problem, [combination, *whole])
            if best.total - combination.total < settings.least_gain * best.total:
                radius *= settings.radius_factor
            best = combination
            if radius < settings.smallest_radius:
                break
        sure = held(problem, best)
        if np.isfinite(sure.total):
            return sure
        return best_combination(problem, start, [best.decisions])

    def refined(self, start: Evaluated, rounds: int) -> Evaluated:
        """Polish a plan by small and large random steps; the result is never slower.

        Unlike `polished`, it follows no slopes, and chooses the launches again as the postures change.

        Args:
            start: a possible plan, at rest.
            rounds: number of rounds.
        """
        variables, settings = (
            Variables.of(self.problem, self.loose),
            self.problem.settings.refinement,
        )
        if not (variables.count and rounds):
            return start
        random, size = np.random.default_rng(self.seed), (settings.steps, variables.count)
        problem, best = with_best_launches(self.problem, start)
        first, renewed = best, best
        for k in range(1, rounds + 1):
            halved = random.integers(settings.halvings, size=(settings.steps, 1))
            scale = np.ldexp(settings.largest_step, -halved)
            steps = scale * random.normal(size=size) * (random.random(size) < settings.moved)
            moved = [_within(problem, variables.moved(best.decisions, row)) for row in steps]
            best = combined(problem, Pool.of(problem, best, moved), best)
            if k % settings.renewal == 0 and k < rounds and best is not renewed:
                launched, suited = with_best_launches(problem, best, near=True)
                if suited.total < best.total:
                    problem, best = launched, suited
                renewed = best
        if np.isfinite(held(problem, best).total):
            return best
        return best_combination(problem, evaluate(problem, first.decisions), [best.decisions])


def _best(problem: SequenceProblem, plans: list[Evaluated]) -> Evaluated:
    """Return the shortest plan, collision penalties included."""
    if problem.clearance is None:
        return min(plans, key=lambda plan: plan.total)
    least, objective = plans[0], plans[0].total + plan_clearance(problem, plans[0]).penalty
    for plan in plans[1:]:
        if plan.total < objective:
            candidate = plan.total + plan_clearance(problem, plan).penalty
            if candidate < objective:
                least, objective = plan, candidate
    return least


def _within(problem: SequenceProblem, decisions: Decisions) -> Decisions:
    """Clip the platform angles of decisions to their range."""
    if not problem.turns:
        return decisions
    return Decisions(np.clip(decisions.angle, *problem.platform_range), decisions.arms)


def _random_steps(
    random: np.random.Generator | None, variables: Variables, radius: float, count: int
) -> FloatArray:
    """Draw normally distributed steps of all variables, shape (count, v)."""
    if random is None:
        return np.empty((0, variables.count))
    steps = random.normal(scale=0.5 * radius, size=(count, variables.count))
    for m in range(count):
        which = m % (len(variables.arms) + 1)
        for a, rows in enumerate(variables.arms):
            if which not in (a, len(variables.arms)):
                steps[m, rows[rows >= 0]] = 0.0
        if which != len(variables.arms) and m % 2:
            steps[m, variables.angle[variables.angle >= 0]] = 0.0
    return steps
