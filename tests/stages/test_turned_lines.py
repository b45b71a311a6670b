"""What the search over the sequence sees of lines on which the platform turns: against exact lines and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.motion.line_motion import with_turned_line
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.stages.plans.source import postures
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.stages.turned_lines import LINES, turned_postures, turned_slopes
from dualarm_cli.timing import TIMING_SOLVERS


@pytest.fixture(scope="module")
def planned(random_job):
    """A random job with lines, its numbers, stages and decisions."""
    job = random_job(3, (4, 3), line=0.05, dwell=0.5)
    model = CellModel.from_cell(job.cell)
    plans = choose_stages(model, job, "exact", "arm_angle")
    numbers = sequence_problem(model, job)
    return model, job, numbers, plans, decisions_of(numbers, model, plans)


def of(planned, a, outer, line, decisions=None):
    """Postures of an arm in all stages, the platform moved so far at the outer ends of its lines."""
    _, _, numbers, _, own = planned
    rows, table = np.arange(numbers.stages), StopTable.of(numbers.arms[a])
    return turned_postures(
        numbers, a, table, rows, own if decisions is None else decisions, outer, line
    )


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("a", [0, 1])
def test_outer_ends_are_those_of_exact_lines(planned, a, line):
    model, job, numbers, plans, _ = planned
    drive = Drive.of(model, job, TIMING_SOLVERS["ruckig"])
    found = of(planned, a, np.full(numbers.stages, 0.05), line)
    name, checked = numbers.arms[a].name, 0
    for k, plan in enumerate(plans[: numbers.stages]):
        if name not in plan.stops or not found.possible[k]:
            continue
        target = plan.platform_at(line, model.platform_columns)
        exact = with_turned_line(drive, plan, line, target + 0.05, target)
        outer = exact.end if line == "retract" else exact.arrival
        own = getattr(found, f"q_{line}")[k]
        assert own == pytest.approx(outer[model.arms[name].columns], abs=1e-9)
        checked += 1
    assert checked


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("a", [0, 1])
def test_a_standing_platform_changes_nothing(planned, a, line):
    """Nor does one that moves by next to nothing, up to as little."""
    _, _, numbers, _, decisions = planned
    rows, table = np.arange(numbers.stages), StopTable.of(numbers.arms[a])
    still = postures(numbers, a, table, rows, decisions.angle, decisions.arms[a])
    for moved in (0.0, 1e-9):
        found = of(planned, a, np.full(numbers.stages, moved), line)
        active = table.active
        for name in ("q_approach", "q_target", "q_retract", line):
            same = getattr(still, name)[active]
            assert getattr(found, name)[active] == pytest.approx(same, abs=1e-6)


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("a", [0, 1])
def test_slopes_are_those_of_central_differences(planned, a, line):
    """By the platform's way; where the target's angle changes as well, the outer end moves alike."""
    _, _, numbers, _, decisions = planned
    table, outer, step = StopTable.of(numbers.arms[a]), np.full(numbers.stages, 0.03), 1e-4
    base = of(planned, a, outer, line)
    rates = turned_slopes(numbers, a, table, decisions, outer, line, base)
    ahead, behind = (of(planned, a, outer + sign * step, line) for sign in (1.0, -1.0))
    good = table.active & base.possible & ahead.possible & behind.possible
    assert good.any()
    own = getattr(rates, f"q_{line}")
    difference = getattr(ahead, f"q_{line}") - getattr(behind, f"q_{line}")
    assert own[good, :, -1] == pytest.approx(difference[good] / (2.0 * step), abs=1e-4)
    # The outer end depends on the sum of both angles alone.
    assert own[good, :, 0] == pytest.approx(own[good, :, -1], abs=1e-5)
    assert rates.q_target[good, :, -1] == pytest.approx(0.0, abs=1e-9)
    shifted = replace(decisions, angle=decisions.angle + step)
    both = of(planned, a, outer - step, line, shifted)
    assert getattr(both, f"q_{line}")[good] == pytest.approx(
        getattr(base, f"q_{line}")[good], abs=1e-9
    )
