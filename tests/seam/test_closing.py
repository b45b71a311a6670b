"""Newton's steps that close a chain: they converge, move joints least, and stay calm where an arm is stretched."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.seam.closed_chain.chain import KEPT, Chain
from dualarm_cli.kinds.seam.closed_chain.closing import CLOSING, all_equations, close, least_norm
from dualarm_cli.model.process_work import SeamTool


@pytest.fixture(scope="module")
def chain(cells, make):
    """A torch of fixed spin on a line that an SDA10F holds."""
    return Chain(cells["sda10f"], make.work_on(make.line(), tool=SeamTool(0.002, free_spin=False)))


@pytest.fixture(scope="module")
def limits(cells):
    """Of the SDA10F."""
    return cells["sda10f"].robot.limits


def equations(chain, share, part=None):
    """What closes the chain at shares of the seam, and has the part at its poses."""
    return partial(all_equations, chain, share=share, part=part)


def near_closed(chain, limits, count=20):
    """Configurations that close the chain at share 0.5, from random ones."""
    rng = np.random.default_rng(5)
    q = rng.uniform(0.6 * limits.lower, 0.6 * limits.upper, (200, len(limits.joints)))
    found = close(equations(chain, np.full(200, 0.5)), q, chain.closes * 1.0, 40)
    good = found.position[found.residual < 1e-9]
    assert len(good) >= count
    return good[:count]


def test_newton_s_steps_converge_quadratically(chain, limits):
    """From 0.05 rad beside closed ones: eight steps leave nothing, and each squares what was left."""
    rng = np.random.default_rng(6)
    q = near_closed(chain, limits)
    q = q + rng.uniform(-0.05, 0.05, q.shape) * chain.closes
    share, weight = np.full(len(q), 0.5), limits.velocity**2 * chain.closes
    left = [
        close(equations(chain, share), q, weight, steps).residual.max() for steps in (0, 1, 2, 3, 8)
    ]
    assert left[0] > 1e-3
    assert left[-1] < 1e-11
    for before, after in pairwise(left[1:4]):
        assert after < 20.0 * before**2 + 1e-11


def test_steps_are_those_of_least_weighted_norm(chain, limits):
    """Against the pseudo-inverse of J sqrt(W) by singular values; joints of no weight stay."""
    rng = np.random.default_rng(7)
    q = near_closed(chain, limits, 5)
    q = q + 1e-4 * rng.normal(size=q.shape) * chain.closes
    found = all_equations(chain, q, np.full(len(q), 0.5))
    weight = limits.velocity**2 * (chain.closes & (np.arange(15) != 3))
    steps = least_norm(found, weight, np.zeros_like(q))
    for J, left, step in zip(found.slope, found.residuals, steps, strict=True):
        root = np.sqrt(weight)
        expected = root * (np.linalg.pinv(J * root) @ left)
        np.testing.assert_allclose(step, expected, atol=1e-7)
        np.testing.assert_allclose(J @ step, left, atol=1e-7)
    assert (steps[:, weight == 0.0] == 0.0).all()


def test_a_wish_is_granted_as_far_as_the_chain_lets_it(chain, limits):
    """Pulled towards the middle of their ranges joints come nearer to it, and the chain is as closed as before."""
    # Steps end where the chain is closed: a little open, they are taken.
    q = near_closed(chain, limits) + 1e-3 * chain.closes
    share, weight = np.full(len(q), 0.5), limits.velocity**2 * chain.closes
    middle = (limits.lower + limits.upper) / 2.0
    pulled = close(equations(chain, share), q, weight, 20, towards=middle, pulls=12)
    good = pulled.residual < 1e-9
    assert good.mean() > 0.8

    def far(p):
        return (((p - middle) / limits.velocity) ** 2 * chain.closes).sum(axis=1)

    assert (far(pulled.position[good]) < far(q[good])).mean() > 0.8


def test_stretched_arms_do_not_fly_off(chain, limits):
    """All joints at zero, both arms straight: no step is longer than it may be, and every number is finite."""
    q = np.zeros((1, 15))
    share, weight = np.array([0.5]), limits.velocity**2 * chain.closes
    for _ in range(10):
        after = close(equations(chain, share), q, weight, 1).position
        assert np.isfinite(after).all()
        assert np.abs(after - q).max() <= CLOSING.longest_step * (1.0 + 1e-12)
        q = after


def test_one_sided_rows_are_brought_to_their_bound_and_not_beyond(cells, make, limits):
    """A tool that leans 0.3 where 0.1 is left ends at what is kept of it; one that leans 0.05 stays as it is."""
    work = make.work_on(make.line(), tool=SeamTool(0.0, free_spin=True, tilt=0.1))
    upright = Chain(cells["sda10f"], replace(work, tool=replace(work.tool, tilt=0.0)))
    q = near_closed(upright, limits, 1)
    chain = Chain(cells["sda10f"], work)
    share, weight = np.array([0.5]), limits.velocity**2 * chain.slave_joints
    for lean, expected in ((0.3, KEPT * 0.1), (0.05, 0.05)):
        # The part turned under the tool, about where it works: a lean and nothing else.
        turn = pin.SE3(pin.exp3(np.array([lean, 0.0, 0.0])), np.zeros(3))
        turned = Chain(cells["sda10f"], replace(work, part=work.part * turn))
        found = close(equations(turned, share), q, weight, 20)
        assert found.residual[0] < 1e-9
        part, tool = make.by_pinocchio(cells["sda10f"], turned.work, found.position[0])
        seen = part.actInv(tool)
        np.testing.assert_allclose(seen.translation, 0.0, atol=1e-9)
        assert np.arccos(-seen.rotation[2, 2]) == pytest.approx(expected, abs=2e-3)


def test_a_part_comes_to_where_it_is_to_be(cells, make, chain, limits):
    """The pose of one configuration asked of others near by: pinocchio has it there."""
    [q] = near_closed(chain, limits, 1)
    part, _ = make.by_pinocchio(cells["sda10f"], chain.work, q)
    rng = np.random.default_rng(8)
    near = q + 0.05 * rng.normal(size=(4, 15)) * chain.closes
    poses = np.tile(part.rotation, (4, 1, 1)), np.tile(part.translation, (4, 1))
    found = close(
        equations(chain, np.full(4, 0.5), poses), near, limits.velocity**2 * chain.closes, 20
    )
    assert found.residual.max() < 1e-10
    for row in found.position:
        there, _ = make.by_pinocchio(cells["sda10f"], chain.work, row)
        np.testing.assert_allclose(there.homogeneous, part.homogeneous, atol=1e-9)
