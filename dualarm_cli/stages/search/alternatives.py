"""Choice among alternative targets of stops, such as grasps, on one grid of nodes.

The nodes of all alternatives of a stop are one layer of the search of `node_plans`. A linked stop (the place of a
part) takes the alternative of the arm's stop before (its pick), and the taker of a hand-over that of the giver. Each
arm is clear of the cell at every node; whether the arms are clear of each other is for the plans to find out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import ArmDecisions, SequenceProblem, StopTarget
from dualarm_cli.stages.search.beam import beam_search
from dualarm_cli.stages.search.node_plans import StageNodes, grid_angles
from dualarm_cli.stages.search.potentials import ArmLayers, Layer, with_potentials
from dualarm_cli.stages.search.search import search_effort


@dataclass(frozen=True)
class RankedChoice:
    """Alternatives of all stops with the time of their best plan on the nodes."""

    chosen: IntArray
    """Number of the alternative by arm and stage, 0 without any, shape (arms, n)."""
    total: float
    """Time of the best plan on the nodes [s]."""


@dataclass(frozen=True)
class AlternativeSettings:
    """Width of the search among alternatives."""

    width: int = 200
    """Number of states of the beam."""
    per_angle: int = 8
    """Number of nodes of each arm that are paired at each platform angle."""
    plans: int = 100
    """Number of plans on the nodes; those with different alternatives are kept."""
    yaws: int = 8
    """Number of yaws of a free stop that has alternatives with a fixed yaw."""


ALTERNATIVES = AlternativeSettings()


def ranked_choices(
    problems: Sequence[SequenceProblem], offered: BoolArray, linked: BoolArray, effort: str
) -> list[RankedChoice]:
    """Rank the choices among alternatives by their best plans on one grid.

    The choices of one alternative throughout are among the results wherever they have a plan.

    Args:
        problems: the sequence with each alternative at every stop that has it, the first one elsewhere.
        offered: flags of stops that have an alternative, shape (alternatives, arms, n).
        linked: flags of stops that take the alternative of the arm's stop before, shape (arms, n).
        effort: one of EFFORTS.

    Returns:
        Different choices, fastest first; empty without a plan on the nodes.
    """
    problems = _with_like_yaws(problems)
    mesh = search_effort(problems[0], effort).meshes[0]
    angles = np.tile(grid_angles(problems[0], mesh.angle_step), (problems[0].stages, 1))
    count = len(problems[0].arms)
    by_problem = [
        StageNodes(problem, mesh, angles, None, None).layers(range(count)) for problem in problems
    ]
    merged = [
        replace(_merged([arms[a] for arms in by_problem], offered[:, a]), linked=linked[a])
        for a in range(count)
    ]
    problem = replace(problems[0], clearance=None, launches=None, with_margin=())
    totals: dict[bytes, RankedChoice] = {}
    # One alternative throughout is searched by itself: the widest beam may lose it.
    for only, plans in ((None, ALTERNATIVES.plans), *((m, 1) for m in range(len(problems)))):
        arms = [_restricted(arm, offered[:, a], only) for a, arm in enumerate(merged)]
        if any(layer is not None and not len(layer.work) for arm in arms for layer in arm.layers):
            continue
        layers = with_potentials(problem, arms, angles.shape[1])
        widths = ALTERNATIVES.width, ALTERNATIVES.per_angle
        for path in beam_search(problem, layers, angles, *widths, plans):
            targets = np.stack([rows.target for rows in path.decisions.arms])
            chosen = np.where(offered[1:].any(axis=0), targets, 0)
            key, choice = chosen.tobytes(), RankedChoice(chosen, path.total)
            totals[key] = min(totals.get(key, choice), choice, key=lambda choice: choice.total)
    return sorted(totals.values(), key=lambda choice: choice.total)


def _with_like_yaws(problems: Sequence[SequenceProblem]) -> list[SequenceProblem]:
    """Sample the free yaws of stops that have alternatives with a fixed yaw."""

    def sampled(stop: StopTarget | None, a: int, k: int) -> StopTarget | None:
        stops = [s for p in problems if (s := p.arms[a].stops[k]) is not None]
        free = [s.free_yaw and not s.lines_turn for s in stops]
        if stop is None or not stop.free_yaw or all(free):
            return stop
        step = max(1, len(stop.yaw) // ALTERNATIVES.yaws)
        return replace(stop, free_yaw=False, yaw=stop.yaw[::step])

    return [
        replace(
            problem,
            arms=tuple(
                replace(arm, stops=tuple(sampled(s, a, k) for k, s in enumerate(arm.stops)))
                for a, arm in enumerate(problem.arms)
            ),
        )
        for problem in problems
    ]


def _merged(arms: Sequence[ArmLayers], offered: BoolArray) -> ArmLayers:
    """Merge an arm's nodes of all alternatives; the target of each is its alternative."""
    layers: list[Layer | None] = []
    for k, layer in enumerate(arms[0].layers):
        alternatives = [
            (m, nodes) for m, arm in enumerate(arms) if offered[m, k] and (nodes := arm.layers[k])
        ]
        layers.append(layer if len(alternatives) < 2 else _joined(alternatives))
    return replace(arms[0], layers=layers)


def _joined(alternatives: Sequence[tuple[int, Layer]]) -> Layer:
    """Join layers of one stop in order of their platform angles."""
    numbers = [np.full(len(nodes.work), m, dtype=np.int16) for m, nodes in alternatives]
    layers = [nodes for _, nodes in alternatives]
    decisions = ArmDecisions(
        *(
            np.concatenate([getattr(layer.decisions, field.name) for layer in layers])
            for field in fields(ArmDecisions)
        )
    )
    whole = Layer(
        replace(decisions, target=np.concatenate(numbers)),
        np.concatenate([layer.angle_index for layer in layers]),
        layers[0].free_last,
        np.concatenate([layer.approach for layer in layers], axis=1),
        np.concatenate([layer.retract for layer in layers], axis=1),
        np.concatenate([layer.work for layer in layers]),
    )
    return whole.take(np.argsort(whole.angle_index, kind="stable"))


def _restricted(arm: ArmLayers, offered: BoolArray, only: int | None) -> ArmLayers:
    """Keep the nodes of one alternative where it is offered, else of the first.

    None keeps all.
    """
    if only is None:
        return arm
    layers = [
        layer
        if layer is None or not offered[1:, k].any()
        else layer.take(np.flatnonzero(layer.decisions.target == (only if offered[only, k] else 0)))
        for k, layer in enumerate(arm.layers)
    ]
    return replace(arm, layers=layers)
