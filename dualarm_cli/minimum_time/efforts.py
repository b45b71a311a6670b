"""How hard the search over whole sequences tries, by name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.minimum_time.node_plans import Mesh

NEAR = Mesh(np.radians(6.0), 24, 1500, 40, 4, around=3)
"""The grid around a plan that does not keep clear, but for thorough effort."""
WHOLE = 24
"""Sequences of so many stages or more take as long as they are."""


def evening(stages: int) -> float:
    """Returns how much less luck at single stages counts in a sequence that is longer than WHOLE, 1 in others."""
    return min(1.0, float(np.sqrt(WHOLE / stages)))


@dataclass(frozen=True)
class Effort:
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

    def for_stages(self, stages: int) -> Effort:
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


LEAST_NODES = 0.7
"""Share of a grid's nodes that is left of it in the longest sequences, where an effort spares them."""
FEW = 4
"""So many times more rounds and further grids."""
MOST = 4
"""The shortest ones get so many times more rounds and plans."""

LOCAL = Mesh(np.radians(3.0), 36, 1500, 40, 4, around=1)
FINE = Mesh(np.radians(2.0), 48, 4000, 200, 8, around=2)
EFFORTS = {
    "quick": Effort((Mesh(np.radians(15.0), 12, 1500, 20),), 2, 4, 0, (), LOCAL, 0),
    "normal": Effort(
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
    "thorough": Effort(
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
