"""[Bottin2021], Tables 1 and 2."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.platform_angle import PLATFORM_SOLVERS, PlatformProblem
from dualarm_cli.platform_angle.table import candidate_rows

# Table 2: phi_f - phi_0, elbow displacements of arms 1 and 2, difference; degrees, None for a dash. The paper
# prints the second displacement with the sign mirrored, so magnitudes are compared there.
TABLE_2 = [
    (-113.63, 59.14, -58.17, -0.97),
    (-40.43, 4.62, 5.24, 0.62),
    (-26.57, -6.87, 7.61, 0.74),
    (39.49, -45.01, -33.88, -11.13),
    (-70.10, 28.95, -12.75, -16.20),
    (109.90, 0.65, None, None),
    (179.53, 54.4, None, None),
    (-0.47, -27.55, -0.40, -27.15),
]
# Exactly equal displacements of the same move, from an independent calculation to four decimals.
EXACT = [
    (-114.8475, 59.7634, 59.7634),
    (-40.9550, 5.0609, -5.0609),
    (-25.6871, -7.5971, -7.5971),
    (48.0446, -43.1698, 43.1698),
]
HALF_DIGIT = 0.005 + 1e-9


@pytest.fixture(scope="module")
def table_1() -> PlatformProblem:
    """Table 1 in metres and radians."""
    return PlatformProblem.planar(
        radius=0.050,
        alpha=np.radians(120.0),
        links=(0.070, 0.070),
        angle_0=np.radians(-30.0),
        start=[[0.120, 0.0], [0.0, 0.120]],
        goal=[[0.080, 0.010], [0.050, 0.100]],
    )


@pytest.mark.parametrize("number", range(8))
def test_the_linearised_solver_prints_table_2(table_1, number):
    """All eight rows, to half a unit of the last printed digit, unreachable ones as dashes."""
    solution = PLATFORM_SOLVERS["linearised"].solve(table_1)
    row = candidate_rows("linearised", solution)[number]
    turn, one, two, difference = TABLE_2[number]
    assert abs(np.degrees(row.turn) - turn) <= HALF_DIGIT
    tolerance = 0.05 + 1e-9 if number == 6 else HALF_DIGIT  # row 7 is printed with one decimal
    assert abs(np.degrees(row.delta[0]) - one) <= tolerance
    if two is None:
        assert row.delta[1] is None
        assert row.difference is None
    else:
        printed = [round(abs(np.degrees(delta)), 2) for delta in row.delta]
        assert printed[1] == abs(two)
        # The paper's last column is the difference of its two printed columns.
        assert round(printed[1] - printed[0], 2) == difference


def test_the_paper_chooses_the_root_nearest_the_start(table_1):
    """Number 3 of Table 2."""
    rows = candidate_rows("linearised", PLATFORM_SOLVERS["linearised"].solve(table_1))
    assert [row.chosen for row in rows].index(True) == 2


def test_the_exact_solver_finds_the_four_exact_solutions(table_1):
    """Turns and displacements to the four decimals they are known with."""
    rows = candidate_rows("exact", PLATFORM_SOLVERS["exact"].solve(table_1))
    found = np.degrees([[row.turn, *row.delta] for row in rows])
    assert found.shape == (4, 3)
    assert np.abs(found - EXACT).max() < 5.1e-5


def test_exact_displacements_differ_by_less_than_a_nanoradian(table_1):
    """The elbows really move equally."""
    rows = candidate_rows("exact", PLATFORM_SOLVERS["exact"].solve(table_1))
    assert max(abs(row.difference) for row in rows) < 1e-9


def test_the_fixed_platform_does_not_turn(table_1):
    """One candidate, no turn."""
    (row,) = candidate_rows("fixed", PLATFORM_SOLVERS["fixed"].solve(table_1))
    assert row.turn == 0.0
    assert row.chosen
