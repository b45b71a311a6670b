"""What a person reads when a target cannot be reached: which arm, which point, how far, which way."""

from __future__ import annotations

import pytest

from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.notes import millimetres
from dualarm_cli.planning.planner import plan

HEAD = "dualarm: tasks/1\ncell: cell.yaml\nmode: paired\norder: given\nreturn: true\ntasks:\n"
GRIPPERS = "{left: {tcp: {xyz: [0, 0, 120 mm]}}, right: {tcp: {xyz: [0, 0, 120 mm]}}}"


@pytest.fixture
def refusal(tmp_path):
    """Plans task lines in a cell and returns the text of the refusal."""

    def plan_and_fail(cell, *tasks):
        (tmp_path / ".git").mkdir(exist_ok=True)
        (tmp_path / "cell.yaml").write_text(f"dualarm: cell/1\n{cell}\n")
        (tmp_path / "tasks.yaml").write_text(HEAD + "".join(f"  - {task}\n" for task in tasks))
        with pytest.raises(InfeasibleError) as caught:
            plan(load_job(tmp_path / "tasks.yaml"), PlanSettings())
        return str(caught.value)

    return plan_and_fail


def test_too_far_is_measured_at_the_best_platform_angle(refusal):
    """The miss by hand.

    The wrist is 120 + 155 mm above z = 0.80, so 125 mm below the shoulder; 2.5080 m from the axis less the shoulder's
    0.28324 m leaves 2.2248 m: sqrt(2.2248² + 0.125²) - 0.72 = 1.5083 m.
    """
    text = refusal(
        f"robot: sda10f\ntools: {GRIPPERS}",
        "{id: far, arm: left, move: {xyz: [2.5, 0.2, 0.8], rpy: [180 deg, 0, 0]}}",
    )
    assert "at best, with the platform at " in text
    assert "tasks.yaml:7:" in text
    assert (
        "task 'far': left arm cannot move: the target is 1508.3 mm beyond the arm's reach" in text
    )


def test_too_near_says_so_and_not_too_far(refusal):
    """The miss by hand.

    An elbow of ±120 degrees keeps the wrist sqrt(0.42² + 0.40² - 0.42 * 0.40) = 0.4104 m from the shoulder; at 0.3 m it
    is 110.4 mm too near.
    """
    text = refusal(
        "robot: iiwa14",
        "{id: near, arm: left, move: {xyz: [0.3, 0, 0.234], rpy: [180 deg, 0, 0]}}",
    )
    assert "the target is 110.4 mm too near the shoulder" in text
    assert "(from its base)" in text


def test_the_point_of_the_line_that_fails_is_named(refusal):
    """The target is in reach; a metre of approach above it is not."""
    text = refusal(
        "robot: iiwa14",
        "{id: high, arm: left, approach: 1 m, pick: {xyz: [0.5, 0, 0.2], rpy: [180 deg, 0, 0]}, "
        "place: {xyz: [0.5, 0, 0.2], rpy: [180 deg, 0, 0]}}",
    )
    assert "the start of the 1000 mm approach is" in text


def test_a_robot_without_a_platform_is_told_of_turns_of_its_tool(refusal):
    """Target and end of the line are in reach, each at other turns."""
    tcp = "tools: {left: {tcp: {xyz: [0, 0, 100 mm]}}}"
    pick = "pick: {xyz: [0.16, 0.02, 0.34], rpy: [180 deg, 0, 0], free: yaw}"
    place = "place: {xyz: [0.22, 0.3, 0.34], rpy: [180 deg, 0, 0], free: yaw}"
    task = f"{{id: t, arm: left, approach: 50 mm, {pick}, {place}}}"
    text = refusal(f"robot: openarm\n{tcp}", task)
    assert "not at one turn of the tool" in text and "platform" not in text


def test_only_the_arm_at_fault_is_blamed(refusal):
    """The left arm's target is easy; the right one's is out of the world."""
    text = refusal(
        f"robot: sda10f\ntools: {GRIPPERS}",
        "{id: easy, arm: left, move: {xyz: [0.45, 0.2, 0.8], rpy: [180 deg, 0, 0]}}",
        "{id: far, arm: right, move: {xyz: [2.5, 0.2, 0.8], rpy: [180 deg, 0, 0]}}",
    )
    assert "far" in text
    assert "easy" not in text


def test_two_arms_that_need_different_angles_are_both_named(refusal):
    """Both wrists level with the shoulders and 0.98 m ahead, 23 mm less than R0 + 0.72 m.

    Either shoulder must point there, and they are 138.65 degrees apart.
    """
    text = refusal(
        f"robot: sda10f\ntools: {GRIPPERS}",
        "{id: a, arm: left, move: {xyz: [0.98, 0, 0.925], rpy: [180 deg, 0, 0], free: yaw}}",
        "{id: b, arm: right, move: {xyz: [0.98, 0, 0.925], rpy: [180 deg, 0, 0], free: yaw}}",
    )
    assert text.count("at no platform angle that suits both arms") == 2


def test_a_platform_solver_that_cannot_serve_the_robot_is_refused(tasks_folder):
    """Two robots with bases of their own have no platform to turn."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    with pytest.raises(UnsupportedError, match="platform exact cannot plan KUKA"):
        plan(job, PlanSettings(platform="exact"))


def test_a_stage_that_no_solver_angle_serves_is_noted(tmp_path):
    """Behind the robot: the platform turns although the solver says nothing of it."""
    (tmp_path / ".git").mkdir()
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    (tmp_path / "tasks.yaml").write_text(
        HEAD + "  - {id: a, arm: left, move: {xyz: [-0.3, -0.6, 1.0], rpy: [180 deg, 0, 0]}}\n"
    )
    schedule = plan(load_job(tmp_path / "tasks.yaml"), PlanSettings(platform="fixed"))
    assert any(
        "in stages 1 the solver's angles do not let every arm reach" in note
        for note in schedule.notes
    )


@pytest.mark.parametrize(
    ("length", "text"),
    [
        (0.0, "less than 0.1 mm"),
        (-4e-5, "less than 0.1 mm"),
        (6e-5, "0.1 mm"),
        (-0.0123, "12.3 mm"),
    ],
)
def test_no_length_that_is_missing_is_told_as_nothing(length, text):
    """Half a tenth of a millimetre is where rounding begins."""
    assert millimetres(length) == text
