"""The family of seam solvers: which is at least as fast as which, who serves what, same seed same bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam
from dualarm_cli.kinds.seam.closed_chain.closing import all_equations
from dualarm_cli.model.process_work import Hold, SeamTool

LEAST = 1.03
"""The smoothing at the end may cost a percent, twice."""


@pytest.fixture(scope="module")
def answers(cells, make):
    """What each solver makes of a line on an SDA10F's part."""
    tool = SeamTool(0.002, free_spin=True)
    problem = make.problem_on(
        cells["sda10f"], make.work_on(make.line(), tool=tool), samples=40, improved_starts=1
    )
    return problem, {one.name: one.solve(problem) for one in SEAM_SOLVERS}


def test_freedom_is_never_slower(answers):
    """A part that may move is no slower than a still one at its best, that no slower than steps of least norm."""
    _, found = answers
    assert found["moving"].time <= found["still"].time
    assert found["still"].time <= LEAST * found["least_motion"].time
    assert found["still"].time < 0.8 * found["least_motion"].time


def test_every_answer_is_closed_and_stands_where_it_has_to(answers):
    """Residuals at the nodes; limits; the part still where the solver says so."""
    problem, found = answers
    for name, motion in found.items():
        q = motion.position
        assert all_equations(problem.chain, q, problem.shares).size.max() < 1e-8
        assert ((q >= problem.limits.lower) & (q <= problem.limits.upper))[:, 1:].all()
        if name != "moving":
            assert np.ptp(q[:, problem.chain.master_joints], axis=0).max() == 0.0
        np.testing.assert_array_equal(q[:, 0], problem.start[0])


def test_the_same_problem_has_the_same_answer(cells, make):
    """To the last byte, solved twice from problems built twice."""
    found = [
        SEAM_SOLVERS["still"].solve(
            make.problem_on(
                cells["yumi"], make.work_on(make.line(0.03)), samples=40, improved_starts=1
            )
        )
        for _ in range(2)
    ]
    assert found[0].position.tobytes() == found[1].position.tobytes()


def test_fast_enough_is_enough(cells, make):
    """Asked for 20 s, no solver looks for more: a still part, under that time."""
    problem = make.problem_on(cells["sda10f"], make.work_on(make.line()), time=20.0, samples=40)
    still, moving = (SEAM_SOLVERS[name].solve(problem) for name in ("still", "moving"))
    assert still.time < 20.0
    np.testing.assert_array_equal(still.position, moving.position)


def test_moving_does_not_serve_parts_that_are_told_where_to_be(cells, make):
    """A pose, or still; without a master nothing is told of the part."""
    work = make.work_on(make.line())
    moving, still = SEAM_SOLVERS["moving"], SEAM_SOLVERS["still"]
    for hold, expected in (
        (Hold(), None),
        (Hold(still=True), "stand still"),
        (Hold(pose=pin.SE3.Identity()), "pose"),
    ):
        problem = make.problem_on(cells["sda10f"], replace(work, hold=hold))
        why = moving.why_unsupported(problem)
        assert why is None if expected is None else expected in why
        assert still.why_unsupported(problem) is None
    alone = replace(work, master=None, hold=Hold())
    assert moving.why_unsupported(make.problem_on(cells["sda10f"], alone)) is None


@pytest.mark.parametrize("name", SEAM_SOLVERS.names)
def test_a_seam_out_of_reach_is_answered_with_a_reason(cells, make, name):
    """A part that stands two metres away."""
    far = pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.5]))
    work = make.work_on(make.line(), master=None, slave="left", part=far, tool=SeamTool())
    found = SEAM_SOLVERS[name].solve(make.problem_on(cells["iiwa14"], work, samples=20))
    assert isinstance(found, NoSeam)
    assert found.share == 0.0
