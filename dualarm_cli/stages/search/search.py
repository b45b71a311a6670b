"""The fastest plan of a whole sequence: nodes, potentials, beam, polish."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.effort import EFFORTS
from dualarm_cli.effort.stages import SCALING, Mesh, SearchEffort
from dualarm_cli.geometry.arrays import BoolArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.launches import best_launches
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.exact_stages import ExactStages
from dualarm_cli.stages.search.node_plans import plans_on_nodes
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.polish import Polishing
from dualarm_cli.stages.search.stretches import Stretch, in_parts, loose_stretches, stretch_of
from dualarm_cli.stages.search.variables import Variables


@dataclass(frozen=True)
class SequenceResult:
    """What the search found."""

    best: Evaluated
    """The plan."""
    grid_bound: float | None
    """No plan on the grid's nodes is faster, with the nodes' own line times [s]; None without a plan there."""
    grid_total: float | None
    """The best plan found on the nodes, before polishing [s]."""
    is_infeasible: bool = False
    """Whether something has to touch at a stop, on all nodes: the plan only shows what."""
    with_margin: tuple[Decisions, ...] = ()
    """The plan with room to come to rest beyond lines, if there is one: it may be clear where the best one is not."""


def search(
    problem: SequenceProblem,
    starts: Sequence[Decisions],
    effort: str,
    seed: int,
    further: Callable[[bool], Sequence[Decisions]] = lambda _: (),
) -> SequenceResult | None:
    """Returns the fastest plan found, None if there is none at all.

    The nodes of all stops on several grids; backward dynamic programming per arm with the other one relaxed; a beam
    guided by it. The beams' plans and the given ones are polished a little and combined stage by stage; so are those of
    finer grids around the best plan so far, where the effort has them. The last combination is polished thoroughly, and
    at last as lines' ends are passed in motion, where they may be. Without that the result is never slower, in
    closed-form times, than any of the starts. A short sequence whose lines' ends are passed is also searched, on one
    grid, with room to come to rest beyond them; of both plans, with the ways that go best with each, the shorter one is
    polished once more.

    Args:
        problem: the sequence.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
        further: gives plans of simpler methods that take their time, told whether there is a plan on the grids.
    """
    how = search_effort(problem, effort)
    others: list[Decisions] = []
    if problem.with_margin and problem.stages <= SCALING.short:
        one_grid = replace(how, meshes=how.meshes[:1], local_rounds=0, rivals=0)
        narrow = _searched(next(_with_room(problem)), starts, one_grid, seed)
        others = [] if narrow is None or narrow.is_infeasible else [narrow.best.decisions]
    found = _searched(problem, (*starts, *others), how, seed, further, others)
    return None if found is None else replace(found, with_margin=tuple(others))


def _searched(
    problem: SequenceProblem,
    starts: Sequence[Decisions],
    how: SearchEffort,
    seed: int,
    further: Callable[[bool], Sequence[Decisions]] = lambda _: (),
    others: Sequence[Decisions] = (),
) -> SequenceResult | None:
    """Search with one set of limits of position, see `search`; `others` are plans that were polished in motion."""
    asked, problem = problem, replace(problem, launches=None)
    exact, polishing = ExactStages(problem), Polishing(problem, seed)
    made = map_halves(
        lambda meshes: [plans_on_nodes(problem, exact, mesh, how.plans) for mesh in meshes],
        how.meshes,
    )
    bound = made[0].bound
    total = made[0].plans[0][0].total if made[0].plans else None
    on_nodes = [one for found in made for one in found.plans]
    possible = any(path.is_possible for path, _ in on_nodes)
    pool = [evaluate(problem, start) for start in (*further(possible), *starts)]
    if not pool and on_nodes and not possible:
        return SequenceResult(min(on_nodes, key=lambda one: one[0].total)[1], bound, total, True)
    pool += [plan for _, plan in on_nodes]
    pool = best_of_each_kind(problem, [plan for plan in pool if np.isfinite(plan.total)])
    if not pool:
        return None
    best, tried = combination(polishing, pool, how)
    for _ in range(how.local_rounds):
        around = plans_on_nodes(problem, exact, how.local, how.plans, best).plans
        before = best.total
        pool = [best, *(plan for _, plan in around)]
        best, more = combination(polishing, pool, how)
        tried += more
        if best.total > (1.0 - problem.settings.least_grid_gain) * before:
            break
    rivals = _apart(problem, best, tried)[: how.rivals] if asked.launches is not None else []
    given = [evaluate(problem, decisions) for decisions in others]
    best = polished_thoroughly(replace(polishing, problem=asked), best, how, (rivals, given))
    return SequenceResult(best, bound, total)


def _apart(
    problem: SequenceProblem, best: Evaluated, plans: Sequence[Evaluated]
) -> list[Evaluated]:
    """Returns the plans, best first, whose platform angles or kinds are others than those of `best` and each other."""
    found = [best]
    for plan in sorted(plans, key=lambda plan: _worth(problem, plan)):
        angle, kind = plan.decisions.angle, plan.decisions.kind
        if all(
            np.abs(angle - other.decisions.angle).max() > problem.settings.same_angle
            or kind != other.decisions.kind
            for other in found
        ):
            found.append(plan)
    return found[1:]


def polished_thoroughly(
    polishing: Polishing,
    best: Evaluated,
    how: SearchEffort,
    rivals: tuple[Sequence[Evaluated], Sequence[Evaluated]] = ((), ()),
) -> Evaluated:
    """Returns a plan polished thoroughly: from rest to rest, and then as its lines' ends are passed, if they may be.

    Args:
        polishing: of the sequence.
        best: a plan, in times from rest to rest.
        how: how hard is searched.
        rivals: plans that may be as short when lines' ends are passed, those to be polished for that and those that
            were; what is best of all of them is taken.
    """
    problem, at_rest = polishing.problem, polishing.at_rest
    best = at_rest.polished(best, how.rounds, how.random_steps)
    if problem.launches is None:
        return best
    polished = partial(polished_in_motion, polishing, how)
    unpolished, others = rivals
    found = [*map_halves(partial(polished, range(how.cycles)), [best, *unpolished]), *others]
    if len(found) == 1:
        return found[0]
    moving = [with_best_launches(problem, plan) for plan in found]
    k = min(range(len(moving)), key=lambda k: _worth(*moving[k]))
    beside = [plan.decisions for plan in found[:k] + found[k + 1 :]]
    best = best_combination(moving[k][0], moving[k][1], beside)
    # The ways that go best with it are known.
    return polished(range(1, how.cycles), [evaluate(at_rest.problem, best.decisions)])[0]


def with_best_launches(
    problem: SequenceProblem, plan: Evaluated
) -> tuple[SequenceProblem, Evaluated]:
    """Returns a sequence with the ways of passing lines' ends that are best for a plan, and the plan with them."""
    moving = replace(problem, launches=best_launches(problem, plan))
    return moving, evaluate(moving, plan.decisions)


def polished_in_motion(
    polishing: Polishing, how: SearchEffort, cycles: range, plans: Sequence[Evaluated]
) -> list[Evaluated]:
    """Polish plans as their lines' ends are passed; return them in times from rest to rest."""
    problem, found = polishing.problem, list[Evaluated]()
    for plan in plans:
        best = plan
        for cycle in cycles:
            if cycle:
                moving, start = with_best_launches(problem, best)
            else:
                moving, start = problem, evaluate(problem, best.decisions)
            moved = replace(polishing, problem=moving, seed=polishing.seed + cycle)
            best = moved.polished(start, how.passing_rounds, how.random_steps)
        found.append(evaluate(polishing.at_rest.problem, best.decisions))
    return found


def search_in_parts(
    problem: SequenceProblem, starts: Sequence[Decisions], effort: str, seed: int
) -> SequenceResult | None:
    """Returns a fast plan of a long sequence, decided part by part; None if a part has none.

    Stages far apart hardly depend on each other: parts are decided side by side, take memory one by one, and each with
    room to pass lines' ends in motion where it has a plan with that. Where two meet, what is best of both is polished.

    Args:
        problem: the sequence, at least `settings.in_parts` stages, without a return.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
    """
    at_rest = replace(problem, launches=None)

    def decided(first: int, past: int) -> Decisions | None:
        own = [start.take(np.arange(first, past)) for start in starts]
        for part in _with_room(stretch_of(problem, first, past)):
            found = search(part, own, effort, seed)
            if found is not None and not found.is_infeasible:
                return found.best.decisions
        return None

    joined = in_parts(problem, decided, starts)
    if joined is None:
        return None
    plan, near = joined
    how, decisions = search_effort(problem, effort), plan.decisions

    def polished(stretches: Sequence[Stretch]) -> list[Decisions]:
        found = []
        for stretch in stretches:
            for part in _with_room(stretch.problem):
                polishing = Polishing(part, seed, stretch.loose)
                best = evaluate(polishing.at_rest.problem, decisions.take(stretch.stages))
                if np.isfinite(best.total):
                    best = polished_thoroughly(polishing, best, replace(how, random_steps=0))
                    break
            found.append(best.decisions)
        return found

    stretches = loose_stretches(problem, plan, near)
    for stretch, part in zip(stretches, map_halves(polished, stretches), strict=True):
        decisions = stretch.put(decisions, part)
    best = evaluate(at_rest, decisions)
    return SequenceResult(best, None, None) if np.isfinite(best.total) else None


def _with_room(part: SequenceProblem) -> Iterator[SequenceProblem]:
    """Yield a part of a sequence with its arms' limits of position narrowed, if that is asked for, and as it is."""
    if part.with_margin:
        arms = zip(part.with_margin, part.arms, strict=True)
        narrow = (replace(one, stops=own.stops, start=own.start) for one, own in arms)
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
    """Returns a fast plan about one that is fast but collides, None where no collision-free one is found.

    One grid around the plan; what the beam finds there is polished, combined with the plan stage by stage, and polished
    again. In long sequences, and where that is asked for, only the stages that collide and
    those beside them are looked at, each stretch of them by itself; all others stay as they are. So does a stage for
    which no nodes are found, or none that go together: it may be collision-free by less than the search asks for, which
    an exact test then decides. A stretch without a plan is tried again with more stages about it on the first of the
    grids over the whole range. In sequences of `settings.in_parts` stages or more, where the effort spares time, it
    then gets a plan that touches in the fewest stages.

    Args:
        problem: the sequence, with clearance.
        near: the plan.
        colliding_stages: numbers of stages, and of stages in all for the return, that are known to collide.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
        local: whether all else stays as it is.
    """
    how, plan = search_effort(problem, effort), evaluate(problem, near)
    loose = _loose(problem, plan, colliding_stages)
    if problem.stages <= SCALING.long and not local:
        loose[:] = True

    def decided(plan: Decisions, mesh: Mesh, some: Sequence[Stretch]) -> list[Decisions | None]:
        found = []
        for stretch in some:
            tried = (
                _near(replace(stretch, problem=part), plan, colliding_stages, (how, mesh), seed)
                for part in _with_room(stretch.problem)
            )
            found.append(next((one for one in tried if one is not None), None))
        return found

    # Where nothing near the plan will do, something far from it may, with more stages.
    for mesh, more in ((how.near, 0), (how.meshes[0], problem.settings.further_neighbours)):
        loose = _beside(loose, more)
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
    # Nothing there is as clear as is asked for: what touches least is for an exact test and for repairs.
    decisions = plan.decisions
    for stretch in loose_stretches(problem, plan, loose):
        if len(stretch.stages) == problem.stages:
            return None
        parts_with = (search(part, [], effort, seed) for part in _with_room(stretch.problem))
        least = next((one for one in parts_with if one is not None), None)
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
    """Returns what is decided in the stages of a stretch, None where no collision-free plan of them is found.

    Args:
        stretch: which stages.
        given: the plan of the whole sequence.
        colliding_stages: numbers of the whole sequence's stages that are known to collide.
        effort: how hard is searched, and on which grid.
        seed: of the random steps of polishing.
    """
    asked, loose = stretch.problem, np.array(stretch.loose)
    problem = replace(asked, launches=None)
    how, mesh = effort
    near = given.take(stretch.stages)
    start = evaluate(problem, near)
    known = set(np.flatnonzero(np.isin(stretch.stages, list(colliding_stages))).tolist())
    exact = ExactStages(problem)
    while True:
        found = plans_on_nodes(problem, exact, mesh, how.plans, start, loose)
        # Nodes are in single precision; what is not looked at stays as it was to the last bit.
        around = [
            evaluate(problem, plan.decisions.put(np.flatnonzero(~loose), near))
            for path, plan in found.plans
            if path.is_possible
        ]
        lacking = [k for k in found.lacking or _never_clear(problem, around) if loose[k]]
        # What is known to collide must not stay as it is where there are nodes.
        if not lacking or (around and not known.isdisjoint(lacking)):
            break
        loose[lacking] = False
        problem = _settled(problem, lacking)
    if not around:
        return None
    polishing = Polishing(problem, seed, loose)
    best, _ = combination(polishing, [*around, start], how)
    moving = replace(problem, launches=asked.launches)
    best = polished_thoroughly(replace(polishing, problem=moving), best, how)
    return best.decisions if np.isfinite(_worth(problem, best)) else None


def _never_clear(problem: SequenceProblem, plans: Sequence[Evaluated]) -> list[int]:
    """Returns the stages at whose stops something lacks clearance in all of some plans."""
    if not plans:
        return []
    clear = np.logical_or.reduce([plan_clearance(problem, plan).stops for plan in plans])
    return np.flatnonzero(~clear).tolist()


def _settled(problem: SequenceProblem, stages: Sequence[int]) -> SequenceProblem:
    """Returns a sequence in which further stages are taken to be collision-free at their stops as they are."""
    test = problem.clearance
    assert test is not None  # callers ask where something has to be collision-free
    return replace(problem, clearance=replace(test, settled=test.settled.union(stages)))


def search_effort(problem: SequenceProblem, effort: str) -> SearchEffort:
    """Select how hard to search a sequence, by its length and the kinds of its arms."""
    how = EFFORTS[effort].search
    if problem.has_arm_angles:
        return how.for_stages(problem.stages)
    how = how.for_general_arms(problem.stages)
    # Where every configuration is given there is nothing around a plan.
    return how if Variables.of(problem).count else replace(how, local_rounds=0)


def _loose(problem: SequenceProblem, plan: Evaluated, colliding_stages: Sequence[int]) -> BoolArray:
    """Returns the stages to decide anew for a plan to avoid collisions, shape (n,), with those before moves.

    Args:
        problem: the sequence, with clearance.
        plan: a plan for it.
        colliding_stages: numbers of stages that are known to collide, of moves as of stops.
    """
    clear, n = plan_clearance(problem, plan), problem.stages
    moves = ~clear.moves | (clear.waits > 0.0)
    moves[list(colliding_stages)] = True
    touched = ~clear.stops | moves[:n] | moves[1:]
    return _beside(touched, problem.settings.neighbours)


def _beside(stages: BoolArray, count: int) -> BoolArray:
    """Returns stages with so many to either side of each, shape (n,)."""
    found, n = stages.copy(), len(stages)
    for k in range(1, min(count, n - 1) + 1):
        found[k:] |= stages[:-k]
        found[:-k] |= stages[k:]
    return found


def combination(
    polishing: Polishing, pool: list[Evaluated], how: SearchEffort
) -> tuple[Evaluated, list[Evaluated]]:
    """Returns the best combination of several plans after a little polishing, never slower than any of them, and those.

    One plan by itself is left as it is where there is no grid around it: it is polished anyway.
    """
    if len(pool) == 1 and not how.local_rounds:
        return pool[0], []
    problem, settings = polishing.problem, polishing.problem.settings
    worth = [_worth(problem, plan) for plan in pool]
    limit = (1.0 + settings.promising) * min(worth)
    promising = [k for k, own in enumerate(worth) if own <= limit]
    if problem.stages > SCALING.long and how.spares:
        promising = sorted(promising, key=lambda k: worth[k])[: settings.polished_in_long]
    tried = map_halves(
        lambda some: [polishing.polished(pool[k], how.trial_rounds, 0) for k in some],
        promising,
    )
    tried.sort(key=lambda plan: _worth(problem, plan))
    others = [plan.decisions for plan in (*tried[1:], *pool)]
    return best_combination(problem, tried[0], others), tried


def _worth(problem: SequenceProblem, plan: Evaluated) -> float:
    """Returns a plan's length, with what collides counted in [s]."""
    return plan.total + plan_clearance(problem, plan).penalty


def best_of_each_kind(problem: SequenceProblem, pool: list[Evaluated]) -> list[Evaluated]:
    """Returns the best plan of every kind: those with the same branches, targets and yaws are polished into one."""
    best: dict[bytes, Evaluated] = {}
    for plan in sorted(pool, key=lambda plan: _worth(problem, plan)):
        best.setdefault(plan.decisions.kind, plan)
    return list(best.values())
