# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import bundled_robots, robots_folder

Change = Callable[..., None]
Messages = Callable[..., list[str]]


def test_a_robot_file_becomes_a_robot(project: Path) -> None:
    """Joints in document order, limits from URDF and file, postures with zeros filled in."""
    loaded = load_robot(Path("robot.yaml"))
    robot = loaded.robot
    assert robot.joints == ("turn", "l1", "l2", "r1", "r2")
    assert robot.platform == ("turn",)
    assert [arm.name for arm in robot.arms] == ["left", "right"]
    assert robot.limits.lower.tolist() == [-3.0] * 5
    assert robot.limits.velocity.tolist() == [2.0] * 5
    assert robot.limits.acceleration.tolist() == [5.0, 10.0, 10.0, 10.0, 10.0]
    assert robot.limits.jerk.tolist() == [50.0, math.inf, 100.0, math.inf, math.inf]
    assert robot.limits.source[:3] == ("assumed", "datasheet", "measured")
    assert robot.postures["bent"] == pytest.approx([0, math.pi / 2, 0, -1.5, 0])
    assert robot.postures["home"].tolist() == [0.0] * 5
    assert (set(loaded.inputs), loaded.notes) == ({"robot.yaml", "tiny.urdf"}, ())


def test_the_urdf_text_is_complete_and_moves_only_the_robots_joints(
    project: Path, change: Change
) -> None:
    """Axes are units, one position per joint, unnamed joints fixed, endless joints limited, noted."""
    change("tiny.urdf", 'name="l2" type="revolute"', 'name="l2" type="continuous"')
    change("tiny.urdf", 'name="lf" type="fixed"', 'name="lf" type="prismatic"')
    change("tiny.urdf", "</robot>", "<transmission name='t'/><gazebo/></robot>")
    loaded = load_robot(Path("robot.yaml"))
    model = pin.buildModelFromXML(loaded.robot.urdf)
    assert (model.nq, model.nv) == (5, 5)
    assert "transmission" not in loaded.robot.urdf
    # The file's axes are (0, 0, 2).
    assert loaded.robot.urdf.count('<axis xyz="0.0 0.0 1.0"/>') == 5
    assert loaded.robot.limits.upper[2] == 1000.0
    assert loaded.notes == (
        "joint 'l2' is continuous; its position is kept within ±1000 rad",
        "joints that neither platform nor arms name are fixed: lf at 0",
    )
    # Three joints turned by a, b, c about z, each 0.1 along x from the last, then 0.1 to the tool.
    a, b, c = 0.3, -0.4, 0.8
    q = pin.neutral(model)
    for name, value in (("turn", a), ("l1", b), ("l2", c)):
        q[model.idx_qs[model.getJointId(name)]] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    angles = np.cumsum([0.0, a, b, c])
    expected = [0.1 * np.cos(angles).sum(), 0.1 * np.sin(angles).sum(), 0.8]
    assert data.oMf[model.getFrameId("l_tool")].translation == pytest.approx(expected)


def test_one_arm_is_enough(project: Path, change: Change) -> None:
    """The right arm's joints are then fixed."""
    change("robot.yaml", "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n", "")
    change(
        "robot.yaml",
        "  r1: {acceleration: 10, jerk: none, source: datasheet}\n",
        "",
        ", r1: -1.5",
        "",
    )
    change("robot.yaml", "  r2: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    loaded = load_robot(Path("robot.yaml"))
    assert loaded.robot.joints == ("turn", "l1", "l2")
    assert loaded.notes == ("joints that neither platform nor arms name are fixed: r1, r2 at 0",)


def test_a_platform_may_slide(project: Path, change: Change) -> None:
    """Its positions, accelerations and jerks are lengths; 200 mm along z lift the tool by 0.2."""
    change("tiny.urdf", 'name="turn" type="revolute"', 'name="turn" type="prismatic"')
    change("robot.yaml", "acceleration: 5, jerk: 50", "acceleration: 500 mm/s^2, jerk: 5 m/s^3")
    change("robot.yaml", "bent: {l1: 90 deg", "bent: {turn: 200 mm, l1: 90 deg")
    robot = load_robot(Path("robot.yaml")).robot
    assert (robot.limits.acceleration[0], robot.limits.jerk[0]) == (0.5, 5.0)
    assert robot.postures["bent"][0] == 0.2
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = pin.neutral(model)
    q[model.idx_qs[model.getJointId("turn")]] = 0.2
    pin.framesForwardKinematics(model, data, q)
    # Four steps of 0.2 up, one for each joint on the way, and the lift.
    assert data.oMf[model.getFrameId("l_tool")].translation[2] == pytest.approx(1.0)


def test_a_posture_outside_by_rounding_only_is_put_onto_the_limit(
    project: Path, change: Change
) -> None:
    """3.0000000001 rad is within 1e-9 of the limit of 3 rad."""
    change("robot.yaml", "l1: 90 deg", "l1: 3.0000000001")
    assert load_robot(Path("robot.yaml")).robot.postures["bent"][1] == 3.0


def test_limits_come_from_the_joint_then_the_urdf_then_the_default(
    project: Path, change: Change
) -> None:
    """By hand: 2 rad/s in 0.25 s is 8 rad/s², reached in 0.1 s 80 rad/s³; the URDF's 20 rad/s² in 0.1 s 200 rad/s³."""
    change("robot.yaml", "limits:", "limits:\n  default: {acceleration: top speed in 250 ms}")
    change("robot.yaml", "  l1: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    change("robot.yaml", "  r1: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    change("robot.yaml", "  r2: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    text = Path("tiny.urdf").read_text()
    at = text.index("<limit", text.index('name="r1"'))
    text = f'{text[:at]}<limit acceleration="20"{text[at + 6 :]}'
    at = text.index("<limit", text.index('name="r2"'))
    Path("tiny.urdf").write_text(f'{text[:at]}<limit acceleration="20" jerk="50"{text[at + 6 :]}')
    loaded = load_robot(Path("robot.yaml"))
    limits = loaded.robot.limits
    assert limits.joints == ("turn", "l1", "l2", "r1", "r2")
    assert limits.acceleration.tolist() == [5.0, 8.0, 10.0, 20.0, 20.0]
    assert limits.jerk.tolist() == pytest.approx([50.0, 80.0, 100.0, 200.0, 50.0])
    assert limits.source == ("assumed", "assumed", "measured", "urdf, jerk assumed", "urdf")
    assert loaded.notes == (
        "no jerk limit is given for l1, r1: `acceleration in 0.1 s` is assumed; "
        "give `jerk`, or `jerk: none` for no limit",
    )


def _soften(joint: str, controller: str) -> None:
    """Gives a joint of the URDF a `<safety_controller>`."""
    text = Path("tiny.urdf").read_text()
    at = text.index("<limit", text.index(f'name="{joint}"'))
    Path("tiny.urdf").write_text(f"{text[:at]}<safety_controller {controller}/>{text[at:]}")


def test_soft_limits_and_margins_narrow_positions(project: Path, change: Change) -> None:
    """The URDF's limits are ±3 rad; by hand the narrower range, less the margin at both ends."""
    _soften("turn", 'soft_lower_limit="-4" soft_upper_limit="4"')
    _soften("l1", 'k_velocity="20" soft_lower_limit="-1.5" soft_upper_limit="2.5"')
    _soften("l2", 'soft_upper_limit="1.25" soft_lower_limit="-3.5"')
    _soften("r1", 'k_velocity="20"')
    _soften("r2", 'soft_upper_limit="0" soft_lower_limit="0"')
    change("robot.yaml", "limits:", "limits:\n  default: {position_margin: 0.125}")
    change("robot.yaml", "l2: {", "l2: {position_margin: 0, ")
    change("robot.yaml", "r1: {", "r1: {position_margin: 0.5 rad, ")
    loaded = load_robot(Path("robot.yaml"))
    limits = loaded.robot.limits
    assert limits.lower.tolist() == [-2.875, -1.375, -3.0, -2.5, -2.875]
    assert limits.upper.tolist() == [2.875, 2.375, 1.25, 2.5, 2.875]
    model = pin.buildModelFromXML(loaded.robot.urdf)
    assert sorted(model.upperPositionLimit) == sorted(limits.upper)
    assert set(loaded.notes) == {
        "joint 'r2': its soft limits are equal and ignored, because they allow no motion",
        "position limits are narrowed by soft limits of the URDF: l1, l2",
        "position limits are narrowed by position_margin: turn, l1, r1, r2",
    }


def test_joints_that_controllers_slow_down_are_named(project: Path, change: Change) -> None:
    """2 rad/s by a gain of 20 and 10 per second: from 0.1 and 0.2 rad before the soft limit; not with a margin."""
    text = Path("tiny.urdf").read_text()
    Path("tiny.urdf").write_text(re.sub(r'velocity="[^"]*"', 'velocity="2"', text))
    for joint, gain in (("turn", 0), ("l1", 20), ("l2", 10), ("r1", 5)):
        _soften(
            joint, f'k_velocity="1" k_position="{gain}" soft_lower_limit="-3" soft_upper_limit="3"'
        )
    _soften("r2", 'k_velocity="1" k_position="5"')
    change("robot.yaml", "r1: {", "r1: {position_margin: 0.5 rad, ")
    assert (
        "controllers slow joints down before their soft limits (k_position of the URDF), which plans do not: from "
        "11.5 deg on, l1, l2; `position_margin` keeps away from there"
        in load_robot(Path("robot.yaml")).notes
    )


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        ('soft_lower_limit="4" soft_upper_limit="5"', "12:1: E400 joint 'l1': soft limits 4 to 5 and limits -3 to 3 have no position in common"),
        ('soft_lower_limit="1" soft_upper_limit="-1"', "12:116: E400 joint 'l1': soft limit 1 is above soft limit -1"),
        ('soft_lower_limit="1" soft_upper_limit="x"', "12:116: E400 joint 'l1': soft_upper_limit holds 'x', which is not a finite number"),
        ('soft_lower_limit="nan"', "12:116: E400 joint 'l1': soft_lower_limit holds 'nan', which is not a finite number"),
    ],
)  # fmt: skip
def test_impossible_soft_limits_are_refused(
    controller: str, message: str, project: Path, messages: Messages
) -> None:
    """Empty ranges and texts that are no numbers, at their places."""
    _soften("l1", controller)
    assert messages(lambda: load_robot(Path("robot.yaml"))) == [f"tiny.urdf:{message}"]


def test_a_deceleration_of_the_urdf_limits_as_well(project: Path, change: Change) -> None:
    """URDF 1.2 states both; the smaller one holds in both directions of time."""
    change("robot.yaml", "  r1: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    text = Path("tiny.urdf").read_text()
    at = text.index("<limit", text.index('name="r1"'))
    stated = '<limit acceleration="20" deceleration="12" jerk="90"'
    Path("tiny.urdf").write_text(f"{text[:at]}{stated}{text[at + 6 :]}")
    limits = load_robot(Path("robot.yaml")).robot.limits
    assert (limits.acceleration[3], limits.source[3]) == (12.0, "urdf")


def test_frozen_joints_stand_where_the_file_says(project: Path, change: Change) -> None:
    """r1 at 90 deg turns what follows about z; r2 mimics it: minus half of it and 0.1 rad more."""
    change("robot.yaml", "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n", "")
    change(
        "robot.yaml",
        "  r1: {acceleration: 10, jerk: none, source: datasheet}\n",
        "",
        ", r1: -1.5",
        "",
    )
    change(
        "robot.yaml",
        "  r2: {acceleration: 10, jerk: none, source: datasheet}\n",
        "frozen: {r1: 90 deg}\n",
    )
    text = Path("tiny.urdf").read_text()
    at = text.index("<axis", text.index('name="r2"'))
    mimic = '<mimic joint="r1" multiplier="-0.5" offset="0.1"/>'
    Path("tiny.urdf").write_text(text[:at] + mimic + text[at:])
    loaded = load_robot(Path("robot.yaml"))
    second = math.degrees(0.1 - math.pi / 4)
    assert loaded.notes == (
        "joints that neither platform nor arms name are fixed: "
        f"r1 at 90 deg, r2 at {second:.6g} deg",
    )
    model = pin.buildModelFromXML(loaded.robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    angles = np.array([0.0, 0.0, np.pi / 2, np.pi / 2 + 0.1 - np.pi / 4])
    expected = [0.1 * np.cos(angles).sum(), 0.1 * np.sin(angles).sum(), 0.8]
    found = data.oMf[model.getFrameId("r_tool")].translation
    assert found == pytest.approx(expected)


def test_a_frozen_joint_whose_limits_exclude_0_stands_at_the_nearest(
    project: Path, change: Change
) -> None:
    change("robot.yaml", "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n", "")
    change(
        "robot.yaml",
        "  r1: {acceleration: 10, jerk: none, source: datasheet}\n",
        "",
        ", r1: -1.5",
        "",
    )
    change("robot.yaml", "  r2: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    text = Path("tiny.urdf").read_text()
    at = text.index('lower="-3"', text.index('name="r2"'))
    Path("tiny.urdf").write_text(text[:at] + 'lower="0.5"' + text[at + 10 :])
    notes = load_robot(Path("robot.yaml")).notes
    assert notes == (
        "joints that neither platform nor arms name are fixed: r1 at 0; r2 at 28.6479 deg",
    )


@pytest.mark.parametrize("name", bundled_robots())
def test_the_kind_of_an_arm_is_measured_where_the_file_does_not_say(
    name: str, tmp_path: Path
) -> None:
    """What the bundled files say was found by hand or printed by makers; YuMi's and OpenArm's arms are no others."""
    folder = tmp_path / name
    shutil.copytree(robots_folder() / name, folder)
    stated = [arm.kind for arm in load_robot(name).robot.arms]
    text = (folder / "robot.yaml").read_text()
    (folder / "robot.yaml").write_text(re.sub(r", kind: \w+", "", text))
    assert [arm.kind for arm in load_robot(folder / "robot.yaml").robot.arms] == stated


def test_an_arm_with_a_joint_that_follows_another_one_is_refused(
    project: Path, change: Change, messages: Messages
) -> None:
    change(
        "robot.yaml",
        "[l1, l2]",
        "[l1]",
        "  l2: {acceleration: 10, jerk: 100, source: measured}\n",
        "",
    )
    text = Path("tiny.urdf").read_text()
    at = text.index("<axis", text.index('name="l2"'))
    Path("tiny.urdf").write_text(text[:at] + '<mimic joint="l1"/>' + text[at:])
    assert messages(lambda: load_robot(Path("robot.yaml"))) == [
        "robot.yaml:6:19: E300 joint 'l2', which moves flange 'l_tool', mimics 'l1'; "
        "arms with joints that follow others cannot be planned"
    ]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[l1, l2]", "[l2, l1]", "6:19: E300 the URDF moves flange 'l_tool' by [turn, l1, l2], platform and arm name [turn, l2, l1]"),
        ("[l1, l2]", "[l1, 'l 2']", "6:24: E300 the URDF has no joint 'l 2', did you mean 'l2'?"),
        ("[l1, l2]", "[l1, r1]", "7:20: E300 joint 'r1' is named twice, first at line 6"),
        ("flange: l_tool", "flange: l_tol", "6:37: E300 the URDF has no link 'l_tol', did you mean 'l_tool'?"),
        ("kind: general", "kind: srs", "6:19: E300 kind srs needs 7 joints, found 2"),
        ("kind: general", "kind: srss", "6:51: E200 'srss' is not allowed, did you mean 'srs'? Allowed: srs, spherical_wrist, parallel_axes, general"),
        ("  l2: {acceleration: 10, jerk: 100, source: measured}\n", "", "8:1: E202 no acceleration limit for l2; give one with its source, or one rule for all: `default: {acceleration: top speed in 0.3 s}`"),
        ("acceleration: 5", "acceleration: 0", "9:24: E200 0: angular acceleration must be positive"),
        ("acceleration: 5", "acceleration: -5 deg/s^2", "9:24: E200 '-5 deg/s^2': angular acceleration must be positive"),
        ("acceleration: 5", "acceleration: 5 m/s^2", "9:24: E200 unit 'm/s^2' in '5 m/s^2' is not one of angular acceleration; allowed: rad/s^2, deg/s^2"),
        ("jerk: 50", "jerk: .inf", "9:33: E104 non-finite number '.inf' is not allowed"),
        ("source: assumed", "source: guess", "9:45: E200 'guess' is not allowed; allowed: datasheet, measured, joint_limits, assumed"),
        ("jerk: 50", "jerk: top speed in 0.1 s", "9:33: E200 'top speed in 0.1 s' is no rule for jerk; write `acceleration in 0.2 s`"),
        ("acceleration: 5", "acceleration: top speed in 3 m", "9:24: E200 unit 'm' in '3 m' is not one of time; allowed: s, ms, min"),
        ("acceleration: 5", "acceleration: top speed in 0 s", "9:24: E200 'top speed in 0 s': the time must be at least 1 ms"),
        ("platform: [turn]", "platform: [turn]\nfrozen: {turn: 1}", "5:10: E300 'turn' belongs to the platform or an arm; to freeze it, take its name out there"),
        ("platform: [turn]", "platform: [turn]\nfrozen: {tur: 1}", "5:10: E300 the URDF moves no joint 'tur'; others that move: none"),
        ("l1: 90 deg", "l1: 3.00001 rad", "14:23: E300 '3.00001 rad' is outside the limits of 'l1': -3 to 3 rad (-171.887338539 to 171.887338539 deg)"),
        ("l1: 90 deg", "l1: 190 deg", "14:23: E300 '190 deg' is outside the limits of 'l1': -3 to 3 rad (-171.887 to 171.887 deg)"),
        ("l1: 90 deg", "l_1: 90 deg", "14:19: E300 'l_1' is no joint of platform or arms, did you mean 'l1'?"),
        ("bent:", "free:", "14:12: E300 'free' cannot name a posture; it lets the planner choose the start"),
        ("acceleration: 5", "position_margin: 3.1, acceleration: 5", "9:27: E200 margin of 'turn': 3.1 must not be negative, nor more than half of -3 to 3"),
        ("acceleration: 5", "position_margin: -1 deg, acceleration: 5", "9:27: E200 margin of 'turn': '-1 deg' must not be negative, nor more than half of -3 to 3"),
        ("acceleration: 5", "position_margin: 5 mm, acceleration: 5", "9:27: E200 margin of 'turn': unit 'mm' in '5 mm' is not one of angle; allowed: rad, mrad, deg"),
        ("  l1: {", "  l1: {position_margin: 1.5, ", "14:23: E300 '90 deg' is outside the limits of 'l1': -1.5 to 1.5 rad (-85.9437 to 85.9437 deg), narrowed by position_margin"),
        ("urdf: tiny.urdf", "urdf: tiny.urd", "3:7: E500 there is no file 'tiny.urd' here"),
        ("platform: [turn]", "platform: turn", "4:11: E200 must be a list, such as [a, b], not 'turn'"),
        ("platform: [turn]", "platform: [turn, l1, l2]", "4:11: E200 a list of 3 is too long; at most 2 are allowed"),
        ("name: Tiny", "nmae: Tiny", None),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    old: str, new: str, expected: str | None, project: Path, change: Change, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    change("robot.yaml", old, new)
    found = messages(lambda: load_robot(Path("robot.yaml")))
    if expected is None:
        assert found == [
            "robot.yaml:1:1: E202 'name' is missing",
            "robot.yaml:2:1: E201 unknown key 'nmae', did you mean 'name'? "
            "Allowed: dualarm, name, urdf, dh, platform, arms, limits, torques, frozen, postures, allowed_contacts, assumed_contacts",
        ]
        return
    assert found == [f"robot.yaml:{expected}"]


def test_home_must_be_given_where_zero_is_outside_the_limits(
    project: Path, change: Change, messages: Messages
) -> None:
    """Both home and bent leave the platform at 0, below its lower limit of 1."""
    change("tiny.urdf", 'lower="-3"', 'lower="1"')
    rest = "does not name turn, and 0 is outside their limits; give their positions"
    assert messages(lambda: load_robot(Path("robot.yaml"))) == [
        f"robot.yaml:14:1: E300 posture 'home' {rest}",
        f"robot.yaml:14:12: E300 posture 'bent' {rest}",
    ]


def test_an_unknown_bundled_robot_gets_the_names_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, messages: Messages
) -> None:
    """With the closest name, and how a path would look."""
    for name in ("alpha", "beta"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "robot.yaml").write_text("")
    monkeypatch.setattr("dualarm_cli.files.source.bundled.robots_folder", lambda: tmp_path)
    assert messages(lambda: load_robot("alfa")) == [
        "alfa: E500 no bundled robot 'alfa', did you mean 'alpha'? Bundled: alpha, beta; "
        "the path of a robot file ends with .yaml"
    ]


def test_torques_are_those_of_the_urdf_and_of_the_robot_file(project: Path, change: Change) -> None:
    """The file's effort instead of the URDF's, derated; `default` for keys that a joint does not state."""
    urdf = project / "tiny.urdf"
    urdf.write_text(urdf.read_text().replace('effort="1"', 'effort="40"'))
    assert load_robot(Path("robot.yaml")).robot.torques.effort.tolist() == [40.0] * 5
    change(
        "robot.yaml",
        "postures:",
        "torques:\n"
        "  default: {derating: 50 %, viscous_friction: 0.5}\n"
        "  l1: {effort: 0.1 kNm, rated_effort: 30 Nm, coulomb_friction: 2, rotor_inertia: 0.3, spring: -4 Nm,"
        " spring_stiffness: 6}\n"
        "postures:",
    )
    torques = load_robot(Path("robot.yaml")).robot.torques
    assert torques.effort.tolist() == [20.0, 50.0, 20.0, 20.0, 20.0]
    assert torques.rated.tolist() == [math.inf, 30.0, math.inf, math.inf, math.inf]
    assert torques.coulomb.tolist() == [0.0, 2.0, 0.0, 0.0, 0.0]
    assert torques.viscous.tolist() == [0.5, 0.5, 0.5, 0.5, 0.5]
    assert torques.rotor.tolist() == [0.0, 0.3, 0.0, 0.0, 0.0]
    assert torques.spring.tolist() == [0.0, -4.0, 0.0, 0.0, 0.0]
    assert torques.stiffness.tolist() == [0.0, 6.0, 0.0, 0.0, 0.0]


def test_friction_beyond_the_effort_is_refused(project: Path, change: Change) -> None:
    """The tiny robot's efforts are 1 N m; half of it is left by derating."""
    change(
        "robot.yaml",
        "postures:",
        "torques: {l1: {derating: 50 %, coulomb_friction: 0.5}}\npostures:",
    )
    with pytest.raises(InputError, match=r"leaves 'l1' nothing of its effort of 0\.5"):
        load_robot(Path("robot.yaml"))


def test_torques_of_unknown_joints_are_refused(project: Path, change: Change) -> None:
    """With the joint that is meant."""
    change("robot.yaml", "postures:", "torques: {l3: {effort: 4}}\npostures:")
    with pytest.raises(InputError, match="'l3' is no joint of platform or arms"):
        load_robot(Path("robot.yaml"))
