"""The fastest plan of a whole sequence: nodes, potentials, beam, polish; never slower than where it starts."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray
from dualarm_cli.stages.search.beam import kind_of
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.node_plans import Mesh, plans_on_nodes
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.polish import polish
from dualarm_cli.stages.search.problem import Decisions, SequenceProblem
from dualarm_cli.stages.search.source import has_closed_form
from dualarm_cli.stages.search.stops import StopTable
from dualarm_cli.stages.search.times import Evaluated, evaluate
from dualarm_cli.stages.search.variables import Variables

NEAR = Mesh(np.radians(6.0), 24, 1500, 40, 4, around=3)
"""The grid around a plan that does not keep clear, but for thorough effort."""
WHOLE = 24
"""Sequences of so many stages or more take as long as they are."""


def evening(stages: int) -> float:
    """Returns how much less luck at single stages counts in a sequence that is longer than WHOLE, 1 in others."""
    return min(1.0, float(np.sqrt(WHOLE / stages)))


@dataclass(frozen=True)
class SearchEffort:
    """How hard the search tries."""

    meshes: tuple[Mesh, ...]
    """Grids of nodes, each with a plan of its own; the first one's bound is reported."""
    trial_rounds: int
    """Rounds of polishing of every plan before they are combined."""
    rounds: int
    """Rounds of polishing of the combination."""
    random_steps: int
    """Random steps that are offered in each round."""
    for_few: tuple[Mesh, ...]
    """Further grids for short sequences."""
    local: Mesh
    """The grid around the best plan so far."""
    local_rounds: int = 1
    """How often there is such a grid, at most."""
    plans: int = 1
    """Plans of every grid that are polished: different in branches, targets or yaws."""
    near: Mesh = NEAR
    """The grid around a plan that does not keep clear."""
    spares: bool = True
    """Whether sequences longer than WHOLE get fewer nodes and fewer of their plans polished."""

    def for_stages(self, stages: int) -> SearchEffort:
        """Returns more of all for short sequences, where it takes little time, and fewer nodes for long ones."""
        more = min(MOST, max(1, WHOLE // stages))
        if stages > WHOLE and self.spares:
            share = max(LEAST_NODES, evening(stages))
            return replace(
                self,
                meshes=tuple(mesh.thinned(share) for mesh in self.meshes),
                local=self.local.thinned(share),
            )
        return replace(
            self,
            meshes=self.meshes if more < FEW else (*self.meshes, *self.for_few),
            trial_rounds=self.trial_rounds * min(more, 2),
            rounds=self.rounds * more,
            random_steps=self.random_steps * more,
            local_rounds=self.local_rounds * more,
            plans=self.plans * more,
        )

    def for_general_arms(self, stages: int) -> SearchEffort:
        """Returns less of all for arms without closed forms, whose postures take some thirty times as long.

        One grid, the finer one for short sequences, and little polishing.
        """
        few = MOST * stages <= WHOLE and self.for_few
        return replace(
            self,
            meshes=(self.for_few if few else self.meshes)[:1],
            trial_rounds=max(1, self.trial_rounds // 2),
            plans=max(2, self.plans),
        )


LEAST_NODES = 0.7
"""Share of a grid's nodes that is left of it in the longest sequences, where an effort spares them."""
FEW = 4
"""So many times more rounds and further grids."""
MOST = 4
"""The shortest ones get so many times more rounds and plans."""

LOCAL = Mesh(np.radians(3.0), 36, 1500, 40, 4, around=1)
FINE = Mesh(np.radians(2.0), 48, 4000, 200, 8, around=2)
EFFORTS = {
    "quick": SearchEffort((Mesh(np.radians(15.0), 12, 1500, 20),), 2, 4, 0, (), LOCAL, 0),
    "normal": SearchEffort(
        (
            Mesh(np.radians(12.0), 14, 1500, 40),
            Mesh(np.radians(15.0), 12, 1500, 20),
        ),
        4,
        6,
        4,
        (
            Mesh(np.radians(8.0), 22, 3000, 200, 8),
            Mesh(np.radians(10.0), 18, 3000, 100, 8),
        ),
        LOCAL,
    ),
    "thorough": SearchEffort(
        (
            Mesh(np.radians(8.0), 22, 3000, 200, 8),
            Mesh(np.radians(6.0), 30, 5000, 100, 8),
            Mesh(np.radians(10.0), 18, 3000, 100, 8),
            Mesh(np.radians(12.0), 16, 3000, 100, 8),
            Mesh(np.radians(15.0), 12, 3000, 100, 8),
            Mesh(np.radians(18.0), 14, 3000, 100, 8),
        ),
        12,
        60,
        24,
        (),
        FINE,
        6,
        near=replace(NEAR, width=160),
        spares=False,
    ),
}
"""By name."""


BESIDE = 1
"""So many stages to either side of one that does not keep clear are looked at with it."""
LITTLE = 2e-3
"""Share of the cycle time; a finer grid that gains less is the last one."""
PROMISING = 0.06
"""A plan that is slower than the best one by more than this share is not polished."""
POLISHED = 2
"""So many plans of a long sequence are polished before they are combined, where an effort spares them."""
AT_ONCE = 2
"""Grids that are worked on at the same time; each takes half a gigabyte for a thousand stages."""


@dataclass(frozen=True)
class FoundSequence:
    """What the search found."""

    best: Evaluated
    """The plan."""
    grid_bound: float | None
    """No plan on the grid's nodes is faster, with the nodes' own line times [s]; None without a plan there."""
    grid_total: float | None
    """The best plan found on the nodes, before polishing [s]."""
    hopeless: bool = False
    """Whether something has to touch at a stop, on all nodes: the plan only shows what."""


def search(
    problem: SequenceProblem, starts: Sequence[Decisions], effort: str, seed: int
) -> FoundSequence | None:
    """Returns the fastest plan found, None if there is none at all.

    The nodes of all stops on several grids; backward dynamic programming per arm with the other one relaxed; a beam
    guided by it. The beams' plans and the given ones are polished a little and combined stage by stage; so are those of
    finer grids around the best plan so far. The last combination is polished thoroughly. The result is never slower, in
    closed-form times, than any of the starts.

    Args:
        problem: the sequence.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
    """
    how = _how(problem, effort)
    tables = tuple(StopTable.of(work) for work in problem.arms)
    pool = [evaluate(problem, tables, start) for start in starts]
    with ThreadPoolExecutor(AT_ONCE) as threads:
        made = list(
            threads.map(lambda mesh: plans_on_nodes(problem, tables, mesh, how.plans), how.meshes)
        )
    bound = made[0].bound
    total = made[0].plans[0][0].total if made[0].plans else None
    on_nodes = [one for found in made for one in found.plans]
    if not pool and on_nodes and not any(path.is_possible for path, _ in on_nodes):
        return FoundSequence(
            min((plan for _, plan in on_nodes), key=lambda p: p.total), bound, total, True
        )
    pool += [plan for _, plan in on_nodes]
    pool = _different(problem, [plan for plan in pool if np.isfinite(plan.total)])
    if not pool:
        return None
    best = _combined(problem, tables, pool, how, seed)
    for _ in range(how.local_rounds):
        around = plans_on_nodes(problem, tables, how.local, how.plans, best).plans
        before = best.total
        best = _combined(problem, tables, [best, *(plan for _, plan in around)], how, seed)
        if best.total > (1.0 - LITTLE) * before:
            break
    best = polish(problem, tables, best, how.rounds, how.random_steps, seed)
    return FoundSequence(best, bound, total)


def search_near(
    problem: SequenceProblem,
    near: Decisions,
    touching: Sequence[int],
    effort: str,
    seed: int,
    *,
    local: bool,
) -> Evaluated | None:
    """Returns a fast plan about one that is fast but does not keep clear, None where no collision-free one is found.

    One grid around the plan; what the beam finds there is polished, combined with the plan stage by stage, and polished
    again. In sequences longer than WHOLE, and where that is asked for, only the stages that do not keep clear and
    those beside them are looked at; all others stay as they are. So does a stage for which no nodes are found: it
    may be collision-free by less than the search asks of nodes, which an exact test then decides.

    Args:
        problem: the sequence, with clearance.
        near: the plan.
        touching: numbers of stages, and of stages in all for the return, that are known not to keep clear.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
        local: whether all else stays as it is.
    """
    how = _how(problem, effort)
    tables = tuple(StopTable.of(work) for work in problem.arms)
    start = evaluate(problem, tables, near)
    loose = _loose(problem, start, touching)
    if problem.stages <= WHOLE and not local:
        loose[:] = True
    found = plans_on_nodes(problem, tables, how.near, how.plans, start, loose)
    while found.lacking and loose[list(found.lacking)].all():
        loose[list(found.lacking)] = False
        problem = _settled(problem, found.lacking)
        found = plans_on_nodes(problem, tables, how.near, how.plans, start, loose)
    # Nodes are in single precision; what is not looked at stays as it was to the last bit.
    around = [
        plan.decisions.put(np.flatnonzero(~loose), near)
        for path, plan in found.plans
        if path.is_possible
    ]
    if not around:
        return None
    pool = [*(evaluate(problem, tables, plan) for plan in around), start]
    best = _combined(problem, tables, pool, how, seed, loose)
    best = polish(problem, tables, best, how.rounds, how.random_steps, seed, loose)
    return best if np.isfinite(_worth(problem, best)) else None


def _settled(problem: SequenceProblem, stages: Sequence[int]) -> SequenceProblem:
    """Returns a sequence in which further stages are taken to be collision-free at their stops as they are."""
    test = problem.clearance
    assert test is not None  # callers ask where something has to keep clear
    return replace(problem, clearance=replace(test, settled=test.settled.union(stages)))


def _how(problem: SequenceProblem, effort: str) -> SearchEffort:
    how = EFFORTS[effort]
    if all(has_closed_form(work) for work in problem.arms):
        return how.for_stages(problem.stages)
    how = how.for_general_arms(problem.stages)
    # Where every configuration is given there is nothing around a plan.
    return how if Variables.of(problem).count else replace(how, local_rounds=0)


def _loose(problem: SequenceProblem, plan: Evaluated, touching: Sequence[int]) -> BoolArray:
    """Returns the stages to look at anew for a plan to keep clear, shape (n,): with moves that do, those before them.

    Args:
        problem: the sequence, with clearance.
        plan: a plan for it.
        touching: numbers of stages that are known not to keep clear, of moves as of stops.
    """
    clear, n = plan_clearance(problem, plan), problem.stages
    moves = ~clear.moves | (clear.waits > 0.0)
    moves[list(touching)] = True
    touched = ~clear.stops | moves[:n] | moves[1:]
    loose = touched.copy()
    for k in range(1, min(BESIDE, n - 1) + 1):
        loose[k:] |= touched[:-k]
        loose[:-k] |= touched[k:]
    return loose


def _combined(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    pool: list[Evaluated],
    how: SearchEffort,
    seed: int,
    loose: BoolArray | None = None,
) -> Evaluated:
    """Returns the best combination of several plans after a little polishing; never slower than any of them."""
    worth = [_worth(problem, plan) for plan in pool]
    least = min(worth)
    promising = [k for k, own in enumerate(worth) if own <= (1.0 + PROMISING) * least]
    if problem.stages > WHOLE and how.spares:
        promising = sorted(promising, key=lambda k: worth[k])[:POLISHED]
    tried = [polish(problem, tables, pool[k], how.trial_rounds, 0, seed, loose) for k in promising]
    tried.sort(key=lambda plan: _worth(problem, plan))
    others = [plan.decisions for plan in (*tried[1:], *pool)]
    return best_combination(problem, tables, tried[0], others)


def _worth(problem: SequenceProblem, plan: Evaluated) -> float:
    """Returns a plan's length, with what does not keep clear counted in [s]."""
    return plan.total + plan_clearance(problem, plan).penalty


def _different(problem: SequenceProblem, pool: list[Evaluated]) -> list[Evaluated]:
    """Returns the best plan of every kind: those with the same branches, targets and yaws are polished into one."""
    best: dict[bytes, Evaluated] = {}
    for plan in sorted(pool, key=lambda plan: _worth(problem, plan)):
        best.setdefault(kind_of(plan.decisions), plan)
    return list(best.values())
