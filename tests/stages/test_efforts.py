"""More of everything for short sequences, fewer nodes for long ones, and all of it where no time is spared."""

from __future__ import annotations

import math

import pytest

from dualarm_cli.effort import EFFORTS, further_searches
from dualarm_cli.effort.stages import COARSE, FINE, MEDIUM, SCALING


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
def test_very_short_sequences_get_finer_grids_at_normal_effort():
    """Up to six stages; arms without closed forms get the first of them alone."""
    normal = EFFORTS["normal"].search
    assert normal.for_stages(6).meshes == (MEDIUM, *FINE)
    assert normal.for_stages(7).meshes == (MEDIUM,)
    assert normal.for_general_arms(6).meshes == FINE[:1]
    assert normal.for_general_arms(7).meshes == (MEDIUM,)


def test_further_searches_of_thorough_effort_are_all_those_of_normal_effort():
    """Up to 12 stages its own and two further grids, up to 24 one, beyond none; quick effort has none."""
    assert [further_searches("quick", stages) for stages in (2, 24)] == [[], []]
    for stages, count in ((0, 0), (1, 3), (12, 3), (13, 2), (24, 2), (25, 0)):
        thorough = further_searches("thorough", stages)
        grids = [(), *((mesh,) for mesh in EFFORTS["normal"].search.further_meshes)]
        assert thorough == [("normal", meshes) for meshes in grids[:count]]
        assert further_searches("normal", stages) == thorough[1:]
    assert grids[1] == (COARSE,)


@pytest.mark.full_effort
@pytest.mark.parametrize(("stages", "more"), [(24, 1), (13, 1), (12, 2), (8, 3), (6, 4), (2, 4)])
def test_short_sequences_get_more_rounds(stages, more):
    """As many times as they go into 24, four times at most."""
    for effort in (each.search for each in EFFORTS.values()):
        assert effort.for_stages(stages).rounds == more * effort.rounds
