"""Tools and base heights: from Table 6 and the printed points, and from joint readings alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.calibration.calibrate import Side, calibrate, fit_tools_and_pose
from dualarm_cli.calibration.rigid import fit_rigid
from dualarm_cli.calibration.spread import half_widths, look, region_limit
from dualarm_cli.calibration.tool_fit import (
    HEIGHT,
    Flanges,
    fit_tool,
    flange_poses,
    second_joint_height,
    touched_points,
)
from dualarm_cli.errors import InfeasibleError, UsageError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.geometry.rotations import exp_rotation, log_rotation
from dualarm_cli.model.touches import Touches, TouchSide

R_TRUE, T_TRUE = exp_rotation(np.array([0.02, -0.04, -0.14])), np.array([-2.79, 0.24, -0.05])
TOOLS = {"left": np.array([0.012, -0.007, 0.347]), "right": np.array([-0.02, 0.004, 0.31])}


def side(robot: bool, tcp: object, joints: object, xyz: object, n: int) -> TouchSide:
    """Returns what one robot says, NaN where there is nothing."""
    return TouchSide(
        load_robot("qin_150").robot if robot else None,
        np.asarray(tcp, dtype=float),
        np.full((n, 6 if robot else 0), np.nan) if joints is None else np.asarray(joints),
        np.full((n, 3), np.nan) if xyz is None else np.asarray(xyz),
    )


def random_flanges(n: int, seed: int, turned: float = 1.0) -> dict[str, Flanges]:
    """Returns flange poses that touch the same n points exactly with `TOOLS`; rotations as far apart as `turned`."""
    random = np.random.default_rng(seed)
    left = random.uniform([-1.8, -0.1, 0.6], [-0.6, 1.1, 1.8], (n, 3))
    points = {"left": left, "right": (left - T_TRUE) @ R_TRUE}
    found = {}
    for name, tool in TOOLS.items():
        R = exp_rotation(turned * random.normal(size=(n, 3)))
        found[name] = Flanges(R, points[name] - R @ tool)
    return found


def start(flanges: dict[str, Flanges], off: float) -> dict[str, Side]:
    """Returns sides whose tools are off by so much [m] in every coordinate."""
    return {
        name: Side(f, f.tips(TOOLS[name] + off), TOOLS[name] + off) for name, f in flanges.items()
    }


def test_table_6_and_the_printed_points_tell_tool_and_base_height(qin: Touches) -> None:
    """347 mm along z, none aside, 335 mm up to the second axis: to 0.3 mm, and most inside their intervals."""
    found = calibrate(replace(qin, fit=("tool", "base_height")), "least_squares", "joints")
    inside = []
    for name in ("left", "right"):
        fit = found.tools[name]
        assert fit.determined.all()
        assert fit.degrees == 5
        assert fit.covariance is not None
        off = np.append(fit.tool(np.zeros(3)) - [0.0, 0.0, 0.347], fit.value(HEIGHT, np.nan))
        np.testing.assert_allclose(off, 0.0, atol=3e-4)
        widths = half_widths(fit.covariance, fit.degrees)
        assert (widths < 2e-4).all()
        inside.append(np.abs(off) <= widths)
        assert found.second_joint[name] == pytest.approx(0.335, abs=3e-4)
    assert np.mean(inside) >= 0.75  # 4-decimal angles are not quite normal noise


def test_a_wrong_file_is_put_right_by_its_own_points(qin: Touches) -> None:
    """No tool and d1 = 684 mm as Table 1 prints: the tool comes out as 347 mm, the height as -349 mm."""
    robot = qin.left.robot
    assert robot is not None
    wrong = replace(robot, urdf=robot.urdf.replace(' 0.0 0.335"', ' 0.0 0.684"'))
    assert second_joint_height(wrong) == pytest.approx(0.684)
    left = replace(qin.left, robot=wrong, tcp=np.zeros(3))
    right = replace(qin.right, robot=wrong, tcp=np.zeros(3))
    touches = replace(qin, left=left, right=right, fit=("tool", "base_height"))
    found = calibrate(touches, "least_squares", "joints")
    for name in ("left", "right"):
        fit = found.tools[name]
        np.testing.assert_allclose(fit.tool(np.zeros(3)), [0, 0, 0.347], atol=3e-4)
        assert fit.value(HEIGHT, 0.0) == pytest.approx(-0.349, abs=3e-4)
        assert found.second_joint[name] == pytest.approx(0.335, abs=3e-4)
    np.testing.assert_allclose(found.judgement.distances * 1000, [5.0, 9.0, 4.0], atol=0.2)
    # Without the fit the two triangles do not match, and what is wrong is said.
    with pytest.raises(
        InfeasibleError, match=r"left: joint readings and coordinates .* differ by up to .* mm"
    ):
        calibrate(replace(touches, fit=()), "least_squares", "joints")
    off = replace(qin, left=replace(qin.left, tcp=np.array([0.0, 0.0, 0.337])))
    notes = calibrate(off, "least_squares", "joints").notes
    assert [note for note in notes if note.startswith("left: joint readings")]


def test_a_tool_that_is_never_turned_cannot_be_told_from_height() -> None:
    """Same rotation at every point: tool and base height shift all tips alike; only two of four are determined."""
    random = np.random.default_rng(0)
    flanges = Flanges(np.broadcast_to(np.eye(3), (5, 3, 3)), random.normal(size=(5, 3)))
    xyz = flanges.tips(np.array([0.01, 0.02, 0.3]), 0.1)
    fit = fit_tool(flanges, xyz, np.zeros(3), ("tool", "base_height"), None)
    assert fit.determined.tolist() == [True, True, False, False]
    assert fit.values[:2] == pytest.approx([0.01, 0.02])
    assert fit.unseen == ("0.71 tool z -0.71 base height",)
    # Turned about the vertical only, it is the same for z, whatever the turns.
    about_z = exp_rotation(np.array([[0, 0, a] for a in (0.0, 1.0, 2.0, 3.0, 4.0)]))
    flanges = Flanges(about_z, flanges.position)
    xyz = flanges.tips(np.array([0.01, 0.02, 0.3]), 0.1)
    fit = fit_tool(flanges, xyz, np.zeros(3), ("tool", "base_height"), None)
    assert fit.determined.tolist() == [True, True, False, False]
    alone = fit_tool(flanges, xyz, np.zeros(3), ("tool",), None)
    assert alone.determined.all()


def test_exact_readings_give_exact_tools_and_transform() -> None:
    """20 sets of 8 points, tools wrong by 30 mm or by 300 mm in every coordinate: 1e-9 m."""
    for seed in range(20):
        flanges = random_flanges(8, seed)
        fit = fit_tools_and_pose(start(flanges, 0.3 if seed % 2 else 0.03), None)
        for name, tool in TOOLS.items():
            np.testing.assert_allclose(fit.tools[name].values, tool, atol=1e-9)
        np.testing.assert_allclose(fit.solution.translation, T_TRUE, atol=1e-9)
        np.testing.assert_allclose(fit.solution.rotation, R_TRUE, atol=1e-9)
        assert fit.solution.degrees == 24 - 12


@pytest.mark.parametrize("stated", [None, 0.5e-3])
def test_the_transform_s_region_has_the_tools_uncertainty_in_it(stated: float | None) -> None:
    """Noise of 0.5 mm in both robots' tips, 300 trials of 8 points: 95 +- 4 %."""
    inside = []
    for seed in range(300):
        random = np.random.default_rng(1000 + seed)
        flanges = {
            name: Flanges(f.rotation, f.position + 0.5e-3 * random.normal(size=(8, 3)))
            for name, f in random_flanges(8, seed).items()
        }
        solution = fit_tools_and_pose(start(flanges, 0.0), stated).solution
        assert solution.covariance is not None
        turn = log_rotation(R_TRUE @ solution.rotation.T)
        e = np.concatenate([T_TRUE - solution.translation, turn])
        distance = e @ np.linalg.solve(solution.covariance, e)
        inside.append(distance <= region_limit(solution.degrees))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.04)


def test_the_jacobian_s_blind_directions_leave_the_residuals_alone() -> None:
    """Both heights raised by h and the transform shifted: the same tips, so base height is not among the unknowns."""
    flanges = random_flanges(8, 3)
    tips = {name: f.tips(TOOLS[name], 0.2) for name, f in flanges.items()}
    R, t = fit_rigid(tips["left"], tips["right"])
    np.testing.assert_allclose(tips["left"], tips["right"] @ R.T + t, atol=1e-12)
    np.testing.assert_allclose(R, R_TRUE, atol=1e-12)
    up = np.array([0.0, 0.0, 0.2])
    np.testing.assert_allclose(t, T_TRUE + up - R_TRUE @ up, atol=1e-12)


@pytest.mark.parametrize(("count", "turned"), [(3, 1.0), (8, 0.0), (8, 1e-6)])
def test_readings_that_leave_the_transform_open_are_refused(count: int, turned: float) -> None:
    """Nine equations for twelve unknowns; or tools that are never turned: exit 3, with what is not observable."""
    with pytest.raises(InfeasibleError, match="not determined together") as caught:
        fit_tools_and_pose(start(random_flanges(count, 0, turned), 0.0), None)
    assert "not observable:" in str(caught.value)
    assert "another orientation of the tool" in str(caught.value)


def test_one_tool_alone_needs_fewer_points() -> None:
    """The right robot's points are known: nine unknowns, four points; the left tool comes out exactly."""
    flanges = random_flanges(4, 7)
    sides = start(flanges, 0.02)
    known = flanges["right"].tips(TOOLS["right"])
    fit = fit_tools_and_pose({**sides, "right": Side(None, known, np.zeros(3))}, None)
    assert list(fit.tools) == ["left"]
    np.testing.assert_allclose(fit.tools["left"].values, TOOLS["left"], atol=1e-9)
    assert fit.solution.degrees == 3


def test_joint_readings_alone_are_fitted_with_a_word_on_the_base_height() -> None:
    """Random readings of the real robot that touch the same points; base_height is asked for and not given."""
    random = np.random.default_rng(4)
    robot = load_robot("qin_150").robot
    low, high = robot.limits.lower, robot.limits.upper
    q = random.uniform(low, high, (9, 6))
    tips = flange_poses(robot, q).tips(np.array([0.0, 0.0, 0.347]))
    left = side(True, [0, 0, 0], q, None, 9)
    right = side(False, np.zeros(3), None, (tips - T_TRUE) @ R_TRUE, 9)
    names = tuple(f"P{k}" for k in range(9))
    touches = Touches(names, left, right, None, 1, ("tool", "base_height"))
    found = calibrate(touches, "least_squares", "joints")
    np.testing.assert_allclose(found.tools["left"].values, [0, 0, 0.347], atol=1e-9)
    np.testing.assert_allclose(found.solution.translation, T_TRUE, atol=1e-9)
    assert HEIGHT not in found.tools["left"].names
    assert found.second_joint == {}
    assert "cannot be observed from joint readings alone" in " ".join(found.notes)
    tool_only = calibrate(replace(touches, fit=("tool",)), "least_squares", "joints")
    assert "base heights cannot be observed" in " ".join(tool_only.notes)
    frame = calibrate(touches, "frame", "joints")
    np.testing.assert_allclose(frame.solution.rotation, R_TRUE, atol=1e-8)
    assert frame.solution.covariance is None


def test_a_fit_without_readings_is_refused(qin: Touches) -> None:
    """Coordinates only: nothing to fit; --use joints then takes the coordinates there are."""
    none = np.full((3, 0), np.nan)
    left = replace(qin.left, robot=None, joints=none)
    right = replace(qin.right, robot=None, joints=none)
    bare = replace(qin, left=left, right=right)
    with pytest.raises(UsageError, match="joint readings"):
        calibrate(replace(bare, fit=("tool",)), "least_squares", "joints")
    np.testing.assert_array_equal(touched_points("left", left, "joints", np.zeros(3)), left.xyz)


@pytest.mark.parametrize("use", ["joints", "xyz"])
def test_a_point_is_taken_from_the_reading_that_it_has(use: str, qin: Touches) -> None:
    """P1 has joints only, P2 coordinates only, P3 both: only P3 depends on what is preferred."""
    joints, xyz = qin.left.joints.copy(), qin.left.xyz.copy()
    xyz[0], joints[1] = np.nan, np.nan
    touch = replace(qin.left, joints=joints, xyz=xyz)
    robot = touch.robot
    assert robot is not None
    tips = flange_poses(robot, qin.left.joints).tips(qin.left.tcp)
    expected = [tips[0], xyz[1], tips[2] if use == "joints" else xyz[2]]
    np.testing.assert_array_equal(touched_points("left", touch, use, touch.tcp), expected)


def test_look_finds_rank_and_directions_whatever_the_units() -> None:
    """The third parameter is the sum of the first two's effects; scaled by a thousand it stays so."""
    random = np.random.default_rng(0)
    J = random.normal(size=(10, 4))
    J[:, 2] = J[:, 0] + J[:, 1]
    for factor in (1.0, 1000.0):
        stretched = J * [1.0, 1.0, factor, 1.0]
        sight = look(stretched, np.array([1.0, 1.0, 1.0 / factor, 1.0]))
        assert (sight.rank, sight.seen.tolist()) == (3, [False, False, False, True])
        assert sight.in_words(["a", "b", "c", "d"]) == ["0.58 a +0.58 b -0.58 c"]
    full = look(J[:, :2], np.ones(2))
    np.testing.assert_allclose(full.inverse, np.linalg.pinv(J[:, :2]), atol=1e-12)


def readings(n: int, seed: int, noise: float) -> Touches:
    """N points of two robots at one place: joint readings, and coordinates that have the noise of both."""
    random = np.random.default_rng(seed)
    exact = side(True, [0.0, 0.0, 0.347], random.uniform(-1.5, 1.5, (n, 6)), None, n)
    tips = touched_points("left", exact, "joints", exact.tcp)
    left, right = (
        replace(exact, xyz=tips + np.sqrt(2.0) * noise * random.normal(size=(n, 3)))
        for _ in range(2)
    )
    return Touches(tuple(f"P{k}" for k in range(n)), left, right, None, 0, ())


def told_apart(touches: Touches) -> bool:
    """Whether joint readings are said to contradict coordinates."""
    found = calibrate(touches, "least_squares", "joints")
    return any("joint readings and coordinates of the same points" in note for note in found.notes)


@pytest.mark.parametrize("n", [4, 8, 20, 60])
def test_readings_that_differ_by_noise_do_not_contradict_each_other(n: int) -> None:
    """0.45 mm, less than touching is taken to have: told in 1 of 100 files at most, for whatever number of points."""
    assert sum(told_apart(readings(n, seed, 0.45e-3)) for seed in range(100)) <= 2


@pytest.mark.parametrize("n", [4, 8, 20, 60])
def test_one_reading_5_mm_off_contradicts(n: int) -> None:
    """Ten times the noise, at the last point; one that noise of 5 mm explains does not."""
    touches = readings(n, n, 0.2e-3)
    xyz = touches.right.xyz.copy()
    xyz[-1, 1] += 5e-3
    wrong = replace(touches, right=replace(touches.right, xyz=xyz))
    assert told_apart(wrong)
    assert not told_apart(replace(wrong, noise=5e-3))


@pytest.mark.parametrize("n", [4, 8, 20, 60])
def test_readings_that_are_all_off_by_a_tool_contradict(n: int) -> None:
    """2 mm along the tool: no single point of many is far off, all together are."""
    touches = readings(n, n, 0.2e-3)
    wrong = replace(touches.left, tcp=np.array([0.0, 0.0, 0.349]))
    assert told_apart(replace(touches, left=wrong))
