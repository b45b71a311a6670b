"""A lift or a rail that carries both arms: moved between stages, or frozen below a waist that turns."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.bound.bound import bound_note
from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError, UnsupportedError
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import PlatformChain
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.postures.platform_reach import reachable_spans
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.stages.platform_moves import stage_move
from dualarm_cli.verification import verify

SERVED = ("sequence", "minimum_time", "fixed")
Jobs = Callable[..., Job]
Places = dict[str, list[tuple[float, float, float]]]
NEAR: Places = {
    "left": [(0.55, 0.2, 0.75), (0.45, 0.35, 0.95)],
    "right": [(0.55, -0.25, 0.8), (0.4, -0.3, 0.7)],
}
"""Targets before the arms at home, the second ones higher and lower [m]."""


@pytest.fixture
def job(tmp_path: Path, sliding_robots: ModuleType) -> Jobs:
    """Returns what writes and reads a job of moves on a robot with sliding joints; both arms work in every stage."""

    def made(places: Places, platform: dict[str, Any], more: str = "", **robot: Any) -> Job:
        sliding_robots.write_robot(tmp_path, platform, **robot)
        (tmp_path / "cell.yaml").write_text(
            "dualarm: cell/1\nrobot: robot.yaml\ntools: {left: {tcp: {}}, right: {tcp: {}}}\n"
        )
        lines = ["dualarm: tasks/1", "cell: cell.yaml", "return: true", more, "tasks:"]
        for k, pair in enumerate(zip(places["left"], places["right"], strict=True)):
            for arm, xyz in zip(("left", "right"), pair, strict=True):
                lines.append(
                    f"  - {{id: {arm}-{k}, arm: {arm}, move: {{xyz: {list(xyz)}, rpy: [180 deg, 0, 0]}}}}"
                )
        (tmp_path / "tasks.yaml").write_text("\n".join(lines) + "\n")
        return load_job(tmp_path / "tasks.yaml")

    return made


def chain_of(
    axis: str, tmp_path: Path, sliding_robots: ModuleType
) -> tuple[PlatformChain, CellModel]:
    """Returns the platform of a robot on one slide."""
    slide = sliding_robots.Slide(axis, -1.0, 1.0)
    sliding_robots.write_robot(tmp_path, {"slide": slide})
    (tmp_path / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot: robot.yaml\nbase: {xyz: [0.1, 0.2, 0.3], rpy: [0.3, -0.2, 0.5]}\n"
    )
    model = CellModel.from_cell(load_cell(tmp_path / "cell.yaml").cell)
    return model.platform, model


@pytest.mark.parametrize("axis", ["0 0 1", "1 0 0", "0.36 -0.48 0.8"])
def test_a_slide_moves_what_it_carries_along_its_axis(axis, tmp_path, sliding_robots):
    """Finite differences of the carried frame and of tools: the axis of the URDF, turned by the base; no rotation."""
    chain, model = chain_of(axis, tmp_path, sliding_robots)
    assert chain.is_rail
    assert chain.is_chosen
    assert not chain.is_turntable
    wanted = model.cell.base.rotation @ np.array([float(v) for v in axis.split()])
    q = np.array(model.cell.robot.postures["home"])
    step = np.zeros(len(q))
    step[model.platform_columns] = 1e-3
    for arm in model.arms:
        rate = (model.tool_position(arm, q + step) - model.tool_position(arm, q - step)) / 2e-3
        np.testing.assert_allclose(rate, wanted, atol=1e-12)
        turned = model.tool_pose(arm, q + step).rotation
        np.testing.assert_allclose(turned, model.tool_pose(arm, q).rotation, atol=1e-15)


@pytest.mark.parametrize("axis", ["0 0 1", "0.36 -0.48 0.8"])
def test_shifted_is_the_frame_before_seen_from_the_frame_after(axis, tmp_path, sliding_robots):
    """Against products of poses, of a rail and of a turntable."""
    chain, _ = chain_of(axis, tmp_path, sliding_robots)
    turning = dataclasses.replace(chain, revolute=(True,))
    for platform, here, moved in itertools.product((chain, turning), (-0.4, 0.7), (-0.3, 0.2)):
        before = pin.SE3(*platform.pose(np.array([here])))
        after = pin.SE3(*platform.pose(np.array([here + moved])))
        R, p = platform.shifted(np.array([moved]))
        wanted = after.inverse() * before
        np.testing.assert_allclose(R[0], wanted.rotation, atol=1e-15)
        np.testing.assert_allclose(p[0], wanted.translation, atol=1e-15)


def test_positions_of_a_rail_cover_its_limits_and_no_more(tmp_path, sliding_robots):
    """All of a long rail, at most as many positions as angles around a circle; some of a short one; no half turns."""
    chain, _ = chain_of("1 0 0", tmp_path, sliding_robots)
    assert chain.around(3.9, -4.0, 4.0) == (-4.0, 4.0)
    assert chain.around(0.0, -0.1, 9.0) == (-0.1, 9.0)
    degrees = np.radians(5.0)
    assert 8.0 / chain.spacing(degrees, -4.0, 4.0) == pytest.approx(72.0)
    assert 0.2 / chain.spacing(degrees, 0.0, 0.1) >= 4.0
    # Between these half a metre counts like a radian.
    assert chain.spacing(degrees, 0.0, 1.0) == pytest.approx(0.5 * degrees)
    assert chain.spacing(degrees, 0.3, 0.3) > 0.0
    turning = dataclasses.replace(chain, revolute=(True,))
    assert turning.spacing(degrees, -4.0, 4.0) == degrees
    assert turning.around(0.5, -4.0, 3.0) == (0.5 - np.pi, 3.0)


def test_spans_within_reach_are_those_of_distances(tmp_path, sliding_robots):
    """Random wrists against the distance at many positions; beside the axis the nearest reach divides the span."""
    _, model = chain_of("0 0 1", tmp_path, sliding_robots)
    arm = model.arms["left"].closed_form
    least, most = arm.reach
    assert 0.0 < least < most
    at = np.linspace(-2.0, 2.0, 4001)
    random, counts = np.random.default_rng(3), set()
    for radius in [*random.uniform(0.0, 1.1 * most, 40), 0.3 * least]:
        turn = random.uniform(-np.pi, np.pi)
        offset = np.array([radius * np.cos(turn), radius * np.sin(turn), random.uniform(-0.5, 0.5)])
        wrist = arm.geometry.shoulder + offset
        spans = reachable_spans(arm, wrist)
        counts.add(len(spans))
        away = np.hypot(radius, offset[2] - at)
        inside = np.any([(low <= at) & (at <= high) for low, high in spans], axis=0)
        clear = (np.abs(away - least) > 1e-6) & (np.abs(away - most) > 1e-6)
        expected = (least <= away) & (away <= most)
        assert (np.broadcast_to(inside, at.shape) == expected)[clear].all()
    assert counts == {0, 1, 2}


def test_a_rail_needs_the_textbook_time_for_its_way(job, sliding_robots):
    """d/v + v/a + a/j for a way d of at least v²/a + v a/j, with 0.5 m/s, 2 m/s² and 20 m/s³.

    The targets are 3.9 m from where the rail starts, farther than half a turn has radians, and out of the arms' reach.
    """
    places = {
        "left": [(3.9, 0.25, 0.8), (0.55, 0.25, 0.8)],
        "right": [(3.9, -0.25, 0.8), (0.55, -0.25, 0.8)],
    }
    made = job(places, {"rail": sliding_robots.LONG})
    schedule = plan(made, PlanSettings(effort="quick"))
    assert verify(schedule, made, clearance=True).passed
    at = [0.0, *(stage.platform_angle for stage in schedule.stages)]
    v, a, j = sliding_robots.SPEED, sliding_robots.ACCELERATION, sliding_robots.JERK
    far = 0
    for stage, (before, after) in zip(schedule.stages, itertools.pairwise(at), strict=True):
        way = abs(after - before)
        if way < v * v / a + v * a / j:
            continue
        far += 1
        textbook = way / v + v / a + a / j
        assert stage.platform_time == pytest.approx(textbook, abs=1e-9)
        assert stage.end - stage.start >= textbook - 1e-9
    assert far >= 2
    # What the arms reach ahead of where the shoulders are, less what they reach at home.
    reach = sliding_robots.UPPER + sliding_robots.FORE + 0.1
    assert max(at) >= 3.9 - reach
    assert max(at) > np.pi - 0.1
    column = schedule.trajectory.joints.index("rail")
    assert np.abs(schedule.trajectory.velocity[:, column]).max() == pytest.approx(v, rel=1e-9)


@pytest.mark.parametrize("method", SERVED)
def test_methods_that_serve_a_lift_make_verified_plans(job, sliding_robots, method):
    """Verified with clearance; no slower than with the lift where it starts, where the method looks at that."""
    made = job(NEAR, {"lift": sliding_robots.LIFT})
    schedule = plan(made, PlanSettings(platform=method, effort="quick"))
    verification = verify(schedule, made, clearance=True)
    assert verification.passed, [c for c in verification.checks if c.verdict == "failed"]
    units = {check.name: check.unit for check in verification.checks}
    assert units["platform_still"] == "m, m/s"
    assert schedule.lower_bound is None
    assert bound_note("rail") in schedule.notes
    held = plan(made, PlanSettings(platform="fixed"))
    if method == "sequence":
        assert schedule.duration < held.duration


@pytest.mark.parametrize("method", sorted(set(METHODS.names) - set(SERVED)))
def test_closed_forms_of_turning_platforms_are_refused_by_name(job, sliding_robots, method):
    """With what can be used instead."""
    made = job(NEAR, {"lift": sliding_robots.LIFT})
    with pytest.raises(
        UnsupportedError, match=r"its platform slides.*sequence, minimum_time and fixed plan it"
    ):
        plan(made, PlanSettings(platform=method))
    with pytest.raises(UnsupportedError, match="platform that slides"):
        stage_move(made, 1)


def test_a_target_that_no_position_reaches_is_told_in_millimetres(
    tmp_path, job, sliding_robots, capsys
):
    """The lift goes up 500 mm; a target 2.4 m high stays 400 mm and more away."""
    job({"left": [(0.5, 0.2, 2.6)], "right": [(0.5, -0.2, 0.8)]}, {"lift": sliding_robots.LIFT})
    assert run(["plan", str(tmp_path / "tasks.yaml"), "--out", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err
    assert "at best, with the platform at 500.0 mm" in said
    assert "deg" not in said


def test_two_arms_that_need_different_heights_are_told_so(tmp_path, job, sliding_robots, capsys):
    """1.9 m and 0.2 m: each is reached, at no one position."""
    job({"left": [(0.4, 0.25, 1.75)], "right": [(0.4, -0.25, 0.2)]}, {"lift": sliding_robots.LIFT})
    assert run(["plan", str(tmp_path / "tasks.yaml"), "--out", str(tmp_path / "out")]) == 3
    assert "reached, but at no platform position that suits both arms" in capsys.readouterr().err


def test_a_frozen_lift_below_a_waist_is_a_higher_base(job, sliding_robots):
    """300 mm up, targets and lift alike: the same plan; the waist turns, the bound holds, the note tells it in mm."""
    both = {"lift": sliding_robots.LIFT, "waist": None}
    low = job(NEAR, both, frozen="lift: 0")
    found = plan(low, PlanSettings(effort="quick"))
    higher = {arm: [(x, y, z + 0.3) for x, y, z in some] for arm, some in NEAR.items()}
    high = job(higher, both, frozen="lift: 300 mm")
    schedule = plan(high, PlanSettings(effort="quick"))
    assert verify(schedule, high, clearance=True).passed
    assert schedule.robot.platform == ("waist",)
    assert schedule.duration == pytest.approx(found.duration, abs=1e-6)
    assert max(abs(stage.platform_angle) for stage in schedule.stages) > 0.0
    assert schedule.lower_bound is not None
    assert schedule.lower_bound <= schedule.duration
    assert any("lift at 300 mm" in note for note in high.notes)


def test_a_lift_and_a_waist_that_both_may_move_stand_with_a_note(job, sliding_robots):
    """The note says what to do."""
    made = job(NEAR, {"lift": sliding_robots.LIFT, "waist": None})
    schedule = plan(made, PlanSettings(effort="quick"))
    assert verify(schedule, made, clearance=True).passed
    columns = [schedule.trajectory.joints.index(name) for name in ("lift", "waist")]
    assert np.ptp(schedule.trajectory.position[:, columns], axis=0).max() == 0.0
    assert any("freeze the others" in note for note in schedule.notes)


def test_what_people_see_of_a_lift_is_in_millimetres(tmp_path, job, sliding_robots, capsys):
    """Table of stages, robot show, comparison; files stay in SI units and say which joints slide."""
    job(NEAR, {"lift": sliding_robots.LIFT})
    tasks, out = str(tmp_path / "tasks.yaml"), tmp_path / "out"
    assert run(["plan", tasks, "--out", str(out), "--effort", "quick", "-v"]) == 0
    assert "place mm" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    schedule = json.loads((out / "schedule.json").read_text())
    assert report["sliding_joints"] == ["lift"]
    assert report["platform_slides"] is True
    places = [stage["platform_angle"] for stage in schedule["stages"]]
    assert max(abs(place) for place in places) <= 0.5
    travel = float(np.abs(np.diff([0.0, *places])).sum())
    assert report["platform_travel"] == pytest.approx(travel, abs=1e-9)
    assert run(["robot", "show", str(tmp_path / "robot.yaml")]) == 0
    table = capsys.readouterr().out
    for text in ("-200 mm", "500 mm/s", "2000 mm/s²", "20000 mm/s³"):
        assert text in table
    assert run(["compare", "solvers", tasks, "--method", "fixed"]) == 0
    assert "platform mm" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("acceleration: 2 m/s^2", "acceleration: 100 deg/s^2"), r":\d+:24: E200 unit 'deg/s\^2'"),
        (("jerk: 20000 mm/s^3", "jerk: 5 rad/s^3"), r":\d+:\d+: E200 unit 'rad/s\^3'"),
        (("home: {", "home: {lift: 20 deg, "), r":\d+:25: E200 unit 'deg'"),
        (
            ("home: {", "home: {lift: 0.6, "),
            r"outside the limits of 'lift': -0.2 to 0.5 m \(-200 to 500 mm\)",
        ),
        (("platform: [lift]", "platform: [lift]\nfrozen: {lift: 0.2}"), "take its name out there"),
        (("platform: [lift]", "platform: []\nfrozen: {lift: 20 deg}"), r":5:16: E200 unit 'deg'"),
    ],
)
def test_wrong_units_of_a_lift_are_refused_where_they_stand(
    tmp_path, sliding_robots, change, words
):
    """Angles for lengths, and positions beyond the limits."""
    sliding_robots.write_robot(tmp_path, {"lift": sliding_robots.LIFT})
    file = tmp_path / "robot.yaml"
    text = file.read_text()
    assert change[0] in text
    file.write_text(text.replace(*change))
    with pytest.raises(InputError, match=words):
        load_robot(str(file))


def _bench(random_valid_jobs: ModuleType, sliding_robots: ModuleType, seed: int) -> tuple[Any, Any]:
    """Returns a random slide, and a bench before the arms' home posture."""
    random = np.random.default_rng([seed, 3])
    axis = random.normal(size=3)
    axis = np.eye(3)[seed % 3] if seed % 4 else axis / np.linalg.norm(axis)
    text = " ".join(f"{v:.6f}" for v in axis)
    lower, upper = -random.uniform(0.05, 1.0), random.uniform(0.05, 4.0)
    slide = sliding_robots.Slide(text, round(lower, 3), round(upper, 3))
    bench = random_valid_jobs.Bench(
        "robot.yaml",
        ((0.40, 0.12, 0.62), (0.60, 0.45, 0.85)),
        ((0.45, -0.1, 0.65), (0.6, 0.1, 0.85)),
    )
    return slide, bench


def _judged(
    seed: int, folder: Path, random_valid_jobs: ModuleType, sliding_robots: ModuleType
) -> int:
    """Plans a random job on a random slide; returns the exit code."""
    slide, bench = _bench(random_valid_jobs, sliding_robots, seed)
    sliding_robots.write_robot(folder, {"slide": slide}, joints=6 + seed % 2)
    what = random_valid_jobs.write_random_job(seed, folder, bench)
    tasks, out = str(folder / "tasks.yaml"), str(folder / "plan")
    code = run(["plan", tasks, "--out", out, "--effort", "quick", "--quiet"])
    if code == 0:
        assert run(["verify", out, "--tasks", tasks, "--quiet"]) == 0, what
        found = json.loads((folder / "plan" / "schedule.json").read_text())
        assert found["lower_bound"] is None or found["lower_bound"] <= found["duration"], what
    return code


@pytest.mark.parametrize("seed", [1, 3, 12])
def test_a_random_job_on_a_random_slide_is_verified(
    seed, tmp_path, random_valid_jobs, sliding_robots
):
    """Exit 0 for jobs that are known to have a plan: any axis and limits, all kinds of work."""
    assert _judged(seed, tmp_path, random_valid_jobs, sliding_robots) == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_no_random_job_on_a_random_slide_crashes(seed, tmp_path, random_valid_jobs, sliding_robots):
    """Exit 0 or 3: a valid file is never refused as input, and no plan is unsound."""
    assert _judged(seed, tmp_path, random_valid_jobs, sliding_robots) in (0, 3)
