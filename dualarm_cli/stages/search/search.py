"""Search for the fastest plan of a sequence: nodes, potentials, beam, polishing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.background import BackgroundCall, map_halves
from dualarm_cli.effort import EFFORTS
from dualarm_cli.effort.stages import SCALING, Mesh, SearchEffort
from dualarm_cli.geometry.arrays import BoolArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.launches import with_best_launches
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.exact_stages import ExactStages
from dualarm_cli.stages.search.node_plans import plans_on_nodes
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.polish import Polishing
from dualarm_cli.stages.search.stretches import (
    Progress,
    Stretch,
    counted,
    in_parts,
    loose_stretches,
    stretch_of,
)
from dualarm_cli.stages.search.variables import Variables


@dataclass(frozen=True)
class SequenceResult:
    """Result of the sequence search."""

    best: Evaluated
    """The fastest plan."""
    grid_bound: float | None
    """Lower bound of all plans on the grid's nodes [s]; None without a grid."""
    grid_total: float | None
    """Duration of the best plan on the nodes, before polishing [s]."""
    is_infeasible: bool = False
    """Whether every node of some stop collides; the plan shows where."""
    others: tuple[Decisions, ...] = ()
    """Plan with margin to the position limits, and plans polished in several variants.

    They may be clear if the best plan is not, or the shortest when blended.
    """


def search(
    problem: SequenceProblem,
    starts: Sequence[Decisions],
    effort: str,
    seed: int,
    further: Callable[[bool], Sequence[Decisions]] = lambda _: (),
) -> SequenceResult | None:
    """Search for the fastest plan; None if no plan is found.

    Nodes of all stops are computed on several grids. Backward dynamic programming per arm, with the other arm relaxed,
    guides a beam search. Its plans and the given ones are polished briefly and combined stage by stage, as are plans on
    finer grids around the best plan. The last combination is polished thoroughly, finally with line ends in motion.
    With stops, the result is never slower than any start. A short blended sequence is also searched with margin to the
    position limits; the shorter plan, with its best launches, is polished once more.

    Args:
        problem: the sequence.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: seed of the random polishing steps.
        further: computes slow plans of simpler methods; its argument is whether the grids have a plan.
    """
    how = search_effort(problem, effort)
    has_narrow = bool(problem.with_margin) and problem.stages <= SCALING.short

    def narrow() -> tuple[Decisions, ...]:
        if not has_narrow:
            return ()
        one_grid = replace(how, meshes=how.meshes[:1], local_rounds=0, rivals=0)
        part = replace(next(_with_room(problem)), progress=lambda _: None)
        result = _searched(part, starts, one_grid, seed)
        return () if result is None or result.is_infeasible else (result.best.decisions,)

    with BackgroundCall(narrow, is_long=has_narrow) as others:
        return _searched(problem, starts, how, seed, further, others.result)


def _searched(
    problem: SequenceProblem,
    starts: Sequence[Decisions],
    how: SearchEffort,
    seed: int,
    further: Callable[[bool], Sequence[Decisions]] = lambda _: (),
    narrow: Callable[[], tuple[Decisions, ...]] = tuple,
) -> SequenceResult | None:
    """Search with one set of position limits, see `search`; `narrow` computes blended plans."""
    moving, problem = problem, replace(problem, launches=None)
    exact, polishing = ExactStages(problem), Polishing(problem, seed)
    steps = 3 + how.local_rounds
    problem.progress(f"step 1 of {steps}")
    grids = map_halves(
        lambda meshes: [plans_on_nodes(problem, exact, mesh, how.plans) for mesh in meshes],
        how.meshes,
    )
    bound = grids[0].bound
    total = grids[0].plans[0][0].total if grids[0].plans else None
    on_nodes = [pair for grid in grids for pair in grid.plans]
    possible = any(path.is_possible for path, _ in on_nodes)
    plans = [*further(possible), *starts]
    others = narrow()
    pool = [evaluate(problem, start) for start in (*plans, *others)]
    if not pool and on_nodes and not possible:
        return SequenceResult(min(on_nodes, key=lambda pair: pair[0].total)[1], bound, total, True)
    pool += [plan for _, plan in on_nodes]
    pool = best_of_each_kind(problem, [plan for plan in pool if np.isfinite(plan.total)])
    if not pool:
        return None
    problem.progress(f"step 2 of {steps}")
    best, tried = combination(polishing, pool, how)
    for round_ in range(how.local_rounds):
        problem.progress(f"step {3 + round_} of {steps}")
        plans_around = plans_on_nodes(problem, exact, how.local, how.plans, best).plans
        before = best.total
        pool = [best, *(plan for _, plan in plans_around)]
        best, polished = combination(polishing, pool, how)
        tried += polished
        if best.total > (1.0 - problem.settings.least_grid_gain) * before:
            break
    problem.progress(f"step {steps} of {steps}")
    rivals = _apart(problem, best, tried)[: how.rivals] if moving.launches is not None else []
    given = [evaluate(problem, decisions) for decisions in others]
    polishing = replace(polishing, problem=moving)
    best, *tried = polished_thoroughly(polishing, best, how, (rivals, given))
    shown = tuple(plan.decisions for plan in tried)
    return SequenceResult(best, bound, total, others=(*others, *shown))


def _apart(
    problem: SequenceProblem, best: Evaluated, plans: Sequence[Evaluated]
) -> list[Evaluated]:
    """Select the plans, best first, that differ in platform angles or kind."""
    selected = [best]
    for plan in sorted(plans, key=lambda plan: _objective(problem, plan)):
        angle, kind = plan.decisions.angle, plan.decisions.kind
        if all(
            np.abs(angle - chosen.decisions.angle).max() > problem.settings.same_angle
            or kind != chosen.decisions.kind
            for chosen in selected
        ):
            selected.append(plan)
    return selected[1:]


def polished_thoroughly(
    polishing: Polishing,
    best: Evaluated,
    how: SearchEffort,
    rivals: tuple[Sequence[Evaluated], Sequence[Evaluated]] = ((), ()),
) -> list[Evaluated]:
    """Polish a plan thoroughly, first at rest, then with line ends in motion.

    Returns the best plan. Those that were polished in motion in variants follow: blending may make any the best.

    Args:
        polishing: local optimisation of the sequence.
        best: a plan, timed at rest.
        how: effort of the search.
        rivals: plans that may win with line ends in motion: those to polish, and those polished already.
    """
    problem, at_rest = polishing.problem, polishing.at_rest
    if problem.launches is None:
        further = how.cycles * how.passing_rounds if problem.stages > SCALING.long else 0
        rounds = max(how.rounds + further, problem.settings.least_rounds)
        return [at_rest.polished(best, rounds, how.random_steps)]
    best = at_rest.polished(best, how.rounds, how.random_steps)
    polished = partial(polished_in_motion, polishing, how)
    unpolished, others = rivals
    variants = [(plan, follows) for plan in (best, *unpolished) for follows in how.follows_rates]
    tried = map_halves(partial(polished, range(how.cycles)), variants)
    if len(candidates := [*tried, *others]) == 1:
        return candidates
    moving = [with_best_launches(problem, plan) for plan in candidates]
    k = min(range(len(moving)), key=lambda k: _objective(*moving[k]))
    decisions = [plan.decisions for plan in candidates[:k] + candidates[k + 1 :]]
    best = best_combination(moving[k][0], moving[k][1], decisions)
    # Its best launches are known, so the first cycle is skipped.
    joined = evaluate(at_rest.problem, best.decisions), how.follows_rates[0]
    shown = tried if len(how.follows_rates) > 1 else []
    return [*polished(range(1, how.cycles), [joined]), *shown]


def polished_in_motion(
    polishing: Polishing,
    how: SearchEffort,
    cycles: range,
    plans: Sequence[tuple[Evaluated, bool]],
) -> list[Evaluated]:
    """Polish plans with line ends in motion, following rates or not; return them timed at rest."""
    problem, polished = polishing.problem, list[Evaluated]()
    for best, follows in plans:
        moving = problem
        for cycle in cycles:
            if cycle:
                moving, start = with_best_launches(moving, best, near=moving is not problem)
            else:
                start = evaluate(problem, best.decisions)
            seed, first = polishing.seed + cycle, cycle * how.passing_rounds
            moved = replace(polishing, problem=moving, seed=seed, follows_rates=follows)
            best = moved.polished(start, how.passing_rounds, how.random_steps, first)
        polished.append(evaluate(polishing.at_rest.problem, best.decisions))
    return polished


def refined(
    problem: SequenceProblem, decisions: Decisions, loose: BoolArray, effort: str, seed: int
) -> Decisions:
    """Polish a plan by random steps, timed with the launches that suit it best.

    Stops that lack the search's clearance stay, because the exact test has accepted them.

    Args:
        problem: the sequence.
        decisions: the plan.
        loose: flags of stages that may change, shape (n,).
        effort: one of EFFORTS.
        seed: seed of the random steps.
    """
    rounds = search_effort(problem, effort).refinement_rounds
    for part in _with_room(problem):
        plan = evaluate(replace(part, launches=None), decisions)
        if np.isfinite(plan.total):
            stays = np.flatnonzero(~plan_clearance(part, plan).stops)
            free = loose & ~np.isin(np.arange(part.stages), stays)
            part = part if part.clearance is None else _settled(part, stays.tolist())
            return Polishing(part, seed, free).refined(plan, rounds).decisions
    return decisions


def search_in_parts(
    problem: SequenceProblem, starts: Sequence[Decisions], effort: str, seed: int
) -> SequenceResult | None:
    """Search a long sequence part by part; None if a part has no plan.

    Distant stages hardly interact: parts are planned independently, each with margin for line ends in motion if such a
    plan exists. The stages around their junctions are then polished together.

    Args:
        problem: the sequence, at least `settings.in_parts` stages, without a return.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
    """

    def decided(first: int, past: int, progress: Progress) -> Decisions | None:
        part_starts = [start.take(np.arange(first, past)) for start in starts]
        for part in _with_room(replace(stretch_of(problem, first, past), progress=progress)):
            parts = search(part, part_starts, effort, seed)
            if parts is not None and not parts.is_infeasible:
                return parts.best.decisions
        return None

    joined = in_parts(problem, decided, starts)
    if joined is None:
        return None
    plan, near = joined
    how, decisions = search_effort(problem, effort), plan.decisions

    def polished(stretches: Sequence[Stretch]) -> list[Decisions]:
        parts = []
        for stretch in stretches:
            for part in _with_room(stretch.problem):
                polishing = Polishing(part, seed, stretch.loose)
                best = evaluate(polishing.at_rest.problem, decisions.take(stretch.stages))
                if np.isfinite(best.total):
                    best = polished_thoroughly(polishing, best, replace(how, random_steps=0))[0]
                    break
            parts.append(best.decisions)
        return parts

    stretches = loose_stretches(problem, plan, near)
    problem.progress("joining its parts")
    for stretch, part in zip(stretches, map_halves(polished, stretches), strict=True):
        decisions = stretch.put(decisions, part)
    best = evaluate(replace(problem, launches=None), decisions)
    return SequenceResult(best, None, None) if np.isfinite(best.total) else None


def _with_room(part: SequenceProblem) -> Iterator[SequenceProblem]:
    """Yield a problem with narrowed position limits, if given, then without."""
    if part.with_margin:
        arms = zip(part.with_margin, part.arms, strict=True)
        narrow = (replace(narrowed, stops=work.stops, start=work.start) for narrowed, work in arms)
        yield replace(part, arms=tuple(narrow), with_margin=())
    yield replace(part, with_margin=())


def search_near(
    problem: SequenceProblem,
    near: Decisions,
    colliding_stages: Sequence[int],
    effort: str,
    seed: int,
    *,
    local: bool,
) -> Evaluated | None:
    """Search for a collision-free plan near a fast colliding one, or None.

    Plans on one grid around the given plan are polished, combined with it stage by stage, and polished again. In long
    sequences, or if `local`, only colliding stages and their neighbours are re-planned, stretch by stretch. A stage
    without matching nodes keeps its stops: its clearance may be below the search's margin, and the exact test decides.
    A stretch without a plan is tried again with more neighbours on the first grid over the whole range. In sequences of
    `settings.in_parts` stages or more, at low effort, it then gets a plan with the fewest collisions.

    Args:
        problem: the sequence, with clearance.
        near: the colliding plan.
        colliding_stages: indices of colliding stages; the number of stages for the return.
        effort: one of EFFORTS.
        seed: seed of the random polishing steps.
        local: whether all other stages keep their decisions.
    """
    how, plan = search_effort(problem, effort), evaluate(problem, near)
    loose = _loose(problem, plan, colliding_stages)
    if problem.stages <= SCALING.long and not local:
        loose[:] = True

    def decided(plan: Decisions, mesh: Mesh, batch: Sequence[Stretch]) -> list[Decisions | None]:
        decided_parts = []
        for stretch, _ in counted(problem, batch):
            tried = (
                _near(replace(stretch, problem=part), plan, colliding_stages, (how, mesh), seed)
                for part in _with_room(stretch.problem)
            )
            decided_parts.append(next((part for part in tried if part is not None), None))
        return decided_parts

    # If no plan nearby is clear, search the whole range with more neighbours.
    for mesh, more in ((how.near, 0), (how.meshes[0], problem.settings.further_neighbours)):
        loose = _extended(loose, more)
        stretches = loose_stretches(problem, plan, loose)
        decisions = plan.decisions
        parts = map_halves(partial(decided, decisions, mesh), stretches)
        for stretch, part in zip(stretches, parts, strict=True):
            if part is not None:
                decisions = stretch.put(decisions, part)
                loose[stretch.stages] = False
        plan = evaluate(problem, decisions)
        if not loose.any() or loose.all():
            break
    if not loose.any():
        return plan
    if loose.all() or problem.stages < problem.settings.in_parts or not how.spares:
        return None
    # No plan has the search's margin: leave the least colliding one to the exact test and repairs.
    decisions = plan.decisions
    for stretch in loose_stretches(problem, plan, loose):
        if len(stretch.stages) == problem.stages:
            return None
        parts_with = (search(part, [], effort, seed) for part in _with_room(stretch.problem))
        least = next((part for part in parts_with if part is not None), None)
        if least is None:
            return None
        decisions = stretch.put(decisions, least.best.decisions)
    return evaluate(problem, decisions)


def _near(
    stretch: Stretch,
    given: Decisions,
    colliding_stages: Sequence[int],
    effort: tuple[SearchEffort, Mesh],
    seed: int,
) -> Decisions | None:
    """Re-plan the stages of a stretch; None if no collision-free plan is found.

    Args:
        stretch: the stages to re-plan.
        given: the plan of the whole sequence.
        colliding_stages: indices of colliding stages in the whole sequence.
        effort: effort of the search and its grid.
        seed: seed of the random polishing steps.
    """
    problem_in_motion, loose = stretch.problem, np.array(stretch.loose)
    problem = replace(problem_in_motion, launches=None)
    how, mesh = effort
    near = given.take(stretch.stages)
    start = evaluate(problem, near)
    colliding = set(np.flatnonzero(np.isin(stretch.stages, list(colliding_stages))).tolist())
    exact = ExactStages(problem)
    while True:
        grid = plans_on_nodes(problem, exact, mesh, how.plans, start, loose)
        # Nodes are in single precision; fixed stages keep their decisions to the last bit.
        plans = [
            evaluate(problem, plan.decisions.put(np.flatnonzero(~loose), near))
            for path, plan in grid.plans
            if path.is_possible
        ]
        lacking = [k for k in grid.lacking or _never_clear(problem, plans) if loose[k]]
        # Colliding stages must not keep their decisions if they have nodes.
        if not lacking or (plans and not colliding.isdisjoint(lacking)):
            break
        loose[lacking] = False
        problem = _settled(problem, lacking)
    if not plans:
        return None
    polishing = Polishing(problem, seed, loose)
    best, _ = combination(polishing, [*plans, start], how)
    moving = replace(problem, launches=problem_in_motion.launches)
    best = polished_thoroughly(replace(polishing, problem=moving), best, how)[0]
    return best.decisions if np.isfinite(_objective(problem, best)) else None


def _never_clear(problem: SequenceProblem, plans: Sequence[Evaluated]) -> list[int]:
    """List the stages whose stops lack clearance in every given plan."""
    if not plans:
        return []
    clear = np.logical_or.reduce([plan_clearance(problem, plan).stops for plan in plans])
    return np.flatnonzero(~clear).tolist()


def _settled(problem: SequenceProblem, stages: Sequence[int]) -> SequenceProblem:
    """Mark further stages as fixed, to be decided by the exact test."""
    test = problem.clearance
    assert test is not None  # called with collision checking only
    return replace(problem, clearance=replace(test, settled=test.settled.union(stages)))


def search_effort(problem: SequenceProblem, effort: str) -> SearchEffort:
    """Select the search effort of a sequence by its length and arms."""
    how = EFFORTS[effort].search
    if problem.has_arm_angles:
        how = how.for_stages(problem.stages)
        return replace(how, meshes=problem.meshes) if problem.meshes else how
    how = how.for_general_arms(problem.stages)
    # With all configurations given, a plan has no neighbourhood.
    return how if Variables.of(problem).count else replace(how, local_rounds=0)


def _loose(problem: SequenceProblem, plan: Evaluated, colliding_stages: Sequence[int]) -> BoolArray:
    """Return the stages to re-plan for clearance, shape (n,), including those before moves.

    Args:
        problem: the sequence, with clearance.
        plan: a plan for it.
        colliding_stages: numbers of stages that are known to collide, of moves as of stops.
    """
    clear, n = plan_clearance(problem, plan), problem.stages
    moves = ~clear.moves | (clear.waits > 0.0)
    moves[list(colliding_stages)] = True
    touched = ~clear.stops | moves[:n] | moves[1:]
    return _extended(touched, problem.settings.neighbours)


def _extended(stages: BoolArray, count: int) -> BoolArray:
    """Extend flagged stages by neighbours on both sides, shape (n,)."""
    extended, n = stages.copy(), len(stages)
    for k in range(1, min(count, n - 1) + 1):
        extended[k:] |= stages[:-k]
        extended[:-k] |= stages[k:]
    return extended


def combination(
    polishing: Polishing, pool: list[Evaluated], how: SearchEffort
) -> tuple[Evaluated, list[Evaluated]]:
    """Polish plans briefly and combine them; also return the polished plans.

    One plan by itself is left as it is where there is no grid around it: it is polished anyway.
    """
    if len(pool) == 1 and not how.local_rounds:
        return pool[0], []
    problem, settings = polishing.problem, polishing.problem.settings
    objectives = [_objective(problem, plan) for plan in pool]
    limit = (1.0 + settings.promising) * min(objectives)
    promising = [k for k, objective in enumerate(objectives) if objective <= limit]
    if problem.stages > SCALING.long and how.spares:
        promising = sorted(promising, key=lambda k: objectives[k])[: settings.polished_in_long]
    tried = map_halves(
        lambda batch: [polishing.polished(pool[k], how.trial_rounds, 0) for k in batch],
        promising,
    )
    tried.sort(key=lambda plan: _objective(problem, plan))
    others = [plan.decisions for plan in (*tried[1:], *pool)]
    return best_combination(problem, tried[0], others), tried


def _objective(problem: SequenceProblem, plan: Evaluated) -> float:
    """Compute a plan's objective: duration plus collision penalty [s]."""
    return plan.total + plan_clearance(problem, plan).penalty


def best_of_each_kind(problem: SequenceProblem, pool: list[Evaluated]) -> list[Evaluated]:
    """Return the best plan of each kind: same branches, targets and yaws."""
    best: dict[bytes, Evaluated] = {}
    for plan in sorted(pool, key=lambda plan: _objective(problem, plan)):
        best.setdefault(plan.decisions.kind, plan)
    return list(best.values())
