"""More of everything for short sequences, fewer nodes for long ones, and all of it where no time is spared."""

from __future__ import annotations

import math

import pytest

from dualarm_cli.effort import EFFORTS
from dualarm_cli.effort.stages import SCALING


def test_long_sequences_get_fewer_nodes_but_for_thorough_effort():
    """By hand: luck at single stages evens out with the square root of their number beyond 24, nodes down to 70 %."""
    assert SCALING.damping(24) == SCALING.damping(3) == 1.0
    assert SCALING.damping(96) == pytest.approx(0.5)
    normal, thorough = EFFORTS["normal"].search, EFFORTS["thorough"].search
    for stages, share in ((24, 1.0), (30, math.sqrt(24 / 30)), (1000, SCALING.min_node_fraction)):
        meshes = normal.for_stages(stages).meshes
        assert [mesh.most_nodes for mesh in meshes] == [
            round(share * mesh.most_nodes) for mesh in normal.meshes
        ]
        assert thorough.for_stages(stages).meshes == thorough.meshes


@pytest.mark.full_effort
@pytest.mark.parametrize(("stages", "more"), [(24, 1), (13, 1), (12, 2), (8, 3), (6, 4), (2, 4)])
def test_short_sequences_get_more_rounds(stages, more):
    """As many times as they go into 24, four times at most (quick: twice); short ones begin with three rounds."""
    for name, most in (("quick", 2), ("normal", 4), ("thorough", 4)):
        effort, least = EFFORTS[name].search, 3 if more > 1 else 1
        assert effort.for_stages(stages).rounds == min(more, most) * max(effort.rounds, least)


@pytest.mark.full_effort
def test_quick_effort_has_wide_grids_for_short_sequences_alone():
    """Longer ones have the common grid, as all have where arms lack closed forms."""
    quick = EFFORTS["quick"].search
    assert quick.for_stages(12).meshes == quick.in_short != quick.meshes
    assert quick.for_stages(13).meshes == quick.for_general_arms(12).meshes == quick.meshes
    assert quick.for_stages(6).local_rounds == 1
    assert quick.for_stages(7).local_rounds == 0
