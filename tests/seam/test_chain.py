"""The closed chain's equations against poses composed by hand with pinocchio, and their slopes by differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.kinds.seam.closed_chain.chain import KEPT, TURN, Chain, lean_and_spin
from dualarm_cli.model.process_work import SeamTool

PLAIN = SeamTool()


def about(axis, angle):
    """A rotation about a coordinate axis."""
    return pin.utils.rotate(axis, angle)


def closed_work(make, cell, q, share=0.3, tool=PLAIN, lean=(0.0, 0.0), spin=0.0):
    """A seam whose part is where the chain is closed at q, but for a lean about the tool's x and y, and a spin.

    The tool in the part by hand: at the line's point, turned over, by work angle about x, travel angle about y; its
    centre point back along its own z.
    """
    work = make.work_on(make.line(0.06), tool=tool)
    should = about("x", tool.work_angle) @ about("y", tool.travel_angle) @ about("x", np.pi)
    R = should @ pin.exp3(np.array([*lean, 0.0])) @ about("z", spin)
    point = np.array([(share - 0.5) * 0.06, 0.0, 0.0])
    T_part_tool = pin.SE3(R, point - tool.standoff * R[:, 2])
    part, at = make.by_pinocchio(cell, replace(work, part=pin.SE3.Identity()), q)
    return replace(work, part=part.inverse() * at * T_part_tool.inverse())


def drawn(cell, seed):
    """A random configuration."""
    limits = cell.robot.limits
    return np.random.default_rng(seed).uniform(limits.lower, limits.upper)


def equations(cell, work, q, share=0.3):
    """The equations at one configuration."""
    chain = Chain(cell, work)
    return chain.equations(chain.bodies(q[None]), np.array([share]))


TOOLS = [
    SeamTool(),
    SeamTool(0.002, 0.3, -0.2, free_spin=False),
    SeamTool(0.03, -0.7, 0.4, free_spin=True),
    SeamTool(0.0, 0.1, 0.2, free_spin=False, tilt=0.1),
]


@pytest.mark.parametrize("name", ["sda10f", "yumi"])
@pytest.mark.parametrize("tool", TOOLS)
def test_residuals_vanish_where_the_chain_is_closed_by_hand(cells, make, name, tool):
    """Random configurations, the part placed so that it is closed there; any spin where it is free."""
    cell = cells[name]
    for seed in range(5):
        q = drawn(cell, seed)
        work = closed_work(make, cell, q, tool=tool, spin=1.3 if tool.free_spin else 0.0)
        assert equations(cell, work, q).size[0] < 1e-12
        # Two shares of the line are 0.06 m times their difference apart.
        far = np.linalg.norm(equations(cell, work, q, 0.8).residuals[0, :3])
        assert far == pytest.approx(0.03, abs=1e-12)


def test_what_is_off_is_measured_in_the_tool_s_own_frame(cells, make):
    """Spin 0.2 where it is fixed; a lean of 0.05 with a tilt of 0.1, and of 0.15."""
    cell = cells["sda10f"]
    q = drawn(cell, 1)
    fixed = replace(TOOLS[1])
    found = equations(cell, closed_work(make, cell, q, tool=fixed, spin=0.2), q)
    np.testing.assert_allclose(found.residuals[0], [0, 0, 0, 0, 0, 0.2], atol=1e-12)
    assert found.size[0] == pytest.approx(0.2 * TURN)
    leant = equations(cell, closed_work(make, cell, q, tool=fixed, lean=(0.05, -0.02)), q)
    np.testing.assert_allclose(leant.residuals[0], [0, 0, 0, 0.05, -0.02, 0], atol=1e-12)
    tilting = TOOLS[3]
    inside = equations(cell, closed_work(make, cell, q, tool=tilting, lean=(0.03, 0.04)), q)
    assert inside.size[0] < 1e-12
    beyond = equations(cell, closed_work(make, cell, q, tool=tilting, lean=(0.09, 0.12)), q)
    # x, y, z, spin, then the lean of 0.15 beyond 0.1.
    np.testing.assert_allclose(beyond.residuals[0], [0, 0, 0, 0, 0.15 - KEPT * 0.1], atol=1e-12)
    assert beyond.one_sided == 1
    assert beyond.exact.size[0] < 1e-12


def test_lean_and_spin_take_a_turn_apart():
    """A turn of `spin` about z, then a lean, a vector across z, up to nearly upside down."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        lean = rng.normal(size=2)
        lean *= rng.uniform(0.0, 3.0) / np.linalg.norm(lean)
        spin = rng.uniform(-3.0, 3.0)
        E = pin.exp3(np.array([*lean, 0.0])) @ about("z", spin)
        np.testing.assert_allclose(lean_and_spin(E[None])[0], [*lean, spin], atol=1e-9)


def differences(function, q, h=1e-6):
    """How a function of configurations changes with each joint, (m, n)."""
    step = h * np.eye(len(q))
    return (function(q + step) - function(q - step)).T / (2.0 * h)


@pytest.mark.parametrize("name", ["sda10f", "yumi"])
@pytest.mark.parametrize("tool", TOOLS[:3])
@pytest.mark.parametrize("seed", [0, 1])
def test_slopes_are_those_of_the_residuals_in_closed_chains(cells, make, name, tool, seed):
    """Central differences of every row."""
    cell = cells[name]
    q = drawn(cell, seed)
    chain = Chain(cell, closed_work(make, cell, q, tool=tool))
    share = np.full(len(q), 0.3)
    expected = differences(lambda p: chain.equations(chain.bodies(p), share).residuals, q)
    found = chain.equations(chain.bodies(q[None]), share[:1]).slope[0]
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_slopes_hold_in_open_chains_too(cells, make):
    """Anywhere, lean and spin too: no tool is exactly against its axis."""
    cell = cells["sda10f"]
    work = make.work_on(make.rim(), tool=TOOLS[1])
    chain, share = Chain(cell, work), np.full(len(cell.robot.joints), 0.6)
    for seed in range(5):
        q = drawn(cell, seed)
        expected = differences(lambda p: chain.offsets(chain.bodies(p), share)[0], q)
        found = chain.offsets(chain.bodies(q[None]), share[:1])[1][0]
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_slopes_of_one_sided_rows(cells, make):
    """Lean beyond the tilt near a small lean, and the surface beyond downhand anywhere."""
    cell = cells["sda10f"]
    for seed in range(3):
        q = drawn(cell, seed)
        tool = replace(TOOLS[3], tilt=1e-4)
        work = closed_work(make, cell, q, tool=tool, lean=(3e-3, 4e-3))
        chain = Chain(cell, replace(work, downhand=0.01))
        share = np.full(len(q), 0.3)
        at = chain.equations(chain.bodies(q[None]), share[:1])
        assert at.one_sided == 2
        expected = differences(lambda p: chain.equations(chain.bodies(p), share).residuals, q)  # noqa: B023
        # To the first power of the lean, 5e-3.
        np.testing.assert_allclose(at.slope[0, -2], expected[-2], atol=2e-2)
        np.testing.assert_allclose(at.slope[0, -1], expected[-1], atol=1e-6)


def test_the_surface_s_lean_is_pinocchio_s(cells, make):
    """The normal of a rim's point in the world; downhand counts what is beyond it."""
    cell = cells["sda10f"]
    work = make.work_on(make.rim(0.03, 150.0), downhand=0.2)
    for seed in range(5):
        q = drawn(cell, seed)
        part, _ = make.by_pinocchio(cell, work, q)
        angle = np.radians(0.4 * 150.0)
        normal = part.rotation @ np.array([np.cos(angle), np.sin(angle), 0.0])
        found = equations(cell, work, q, 0.4)
        expected = max(0.0, np.arccos(normal[2]) - KEPT * 0.2)
        assert found.residuals[0, -1] == pytest.approx(expected, abs=1e-9)


def test_the_part_s_equations_vanish_at_its_pose_and_have_its_slopes(cells, make):
    """By pinocchio; a turn and a shift of the pose are what is left."""
    cell = cells["sda10f"]
    work = make.work_on(make.line())
    chain, q = Chain(cell, work), drawn(cell, 4)
    part, _ = make.by_pinocchio(cell, work, q)
    at = chain.part_equations(chain.bodies(q[None]), part.rotation[None], part.translation[None])
    assert at.size[0] < 1e-12
    w, d = np.array([0.01, -0.02, 0.03]), np.array([0.1, 0.2, -0.3])
    off = chain.part_equations(
        chain.bodies(q[None]), (pin.exp3(w) @ part.rotation)[None], (part.translation + d)[None]
    )
    np.testing.assert_allclose(off.residuals[0], [*-d, *-w], atol=1e-12)
    R, p = np.tile(part.rotation, (len(q), 1, 1)), np.tile(part.translation, (len(q), 1))
    expected = differences(lambda p_: chain.part_equations(chain.bodies(p_), R, p).residuals, q)
    np.testing.assert_allclose(at.slope[0], expected, atol=1e-8)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), turn=st.floats(-3.0, 3.0))
def test_a_platform_that_carries_both_arms_has_no_influence(cells, make, seed, turn):
    """Turning it changes neither the residual nor its slopes by the arms' joints: it cannot make a seam faster."""
    cell = cells["sda10f"]
    work = make.work_on(make.rim(), tool=TOOLS[1])
    chain, q = Chain(cell, work), drawn(cell, seed)
    torso = cell.robot.joints.index("torso_b1")
    assert not chain.closes[torso]
    assert chain.closes.sum() == 14
    turned = np.array(q)
    turned[torso] = turn
    share = np.array([0.6])
    one, other = (chain.equations(chain.bodies(p[None]), share) for p in (q, turned))
    np.testing.assert_allclose(one.residuals, other.residuals, atol=1e-12)
    np.testing.assert_allclose(one.slope, other.slope, atol=1e-12)
    np.testing.assert_allclose(one.slope[0][:, torso], 0.0, atol=1e-12)


def test_a_part_without_a_master_stands_in_the_world(cells, make):
    """The platform closes the chain, the idle arm does not; the residual is that of the tool in the world."""
    cell = cells["sda10f"]
    q = drawn(cell, 7)
    work = make.work_on(make.line(), master=None, tool=SeamTool())
    _, tool = make.by_pinocchio(cell, work, q)
    place = pin.SE3(tool.rotation @ about("x", np.pi), tool.translation)
    work = replace(work, part=place * pin.SE3(np.eye(3), np.array([0.03 - 0.3 * 0.06, 0.0, 0.0])))
    chain = Chain(cell, work)
    names = np.array(cell.robot.joints)
    assert set(names[chain.closes]) == {"torso_b1", *cell.robot.arm("right").joints}
    assert not chain.master_joints.any()
    assert equations(cell, work, q).size[0] < 1e-12
    share = np.full(len(q), 0.3)
    expected = differences(lambda p: chain.equations(chain.bodies(p), share).residuals, q)
    found = chain.equations(chain.bodies(q[None]), share[:1]).slope[0]
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_the_nearest_share_is_where_the_working_point_is(cells, make):
    """Newton steps from a share a tenth aside; on a rim as on a line, and no farther than its ends."""
    cell = cells["sda10f"]
    q = drawn(cell, 2)
    chain = Chain(cell, closed_work(make, cell, q, share=0.3, tool=TOOLS[1]))
    bodies = chain.bodies(q[None])
    assert chain.nearest_share(bodies, np.array([0.4]))[0] == pytest.approx(0.3, abs=1e-12)
    away = closed_work(make, cell, q, share=1.2, tool=TOOLS[1])
    chain = Chain(cell, away)
    assert chain.nearest_share(chain.bodies(q[None]), np.array([0.9]))[0] == 1.0
