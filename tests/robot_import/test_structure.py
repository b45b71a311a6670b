"""Which rows of joints are arms: by names, options, groups of an SRDF and mimic joints; what is told of the others."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.errors import InputError, UsageError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.robot_import.importing import Imported
from dualarm_cli.robot_import.structure import GRIPPER, NO_ARM, side_of, word_among

Row = Callable[..., str]
Write = Callable[..., Path]
Import = Callable[..., Imported]
FOLLOWER = (
    '<link name="tip"/><joint name="follow" type="revolute"><parent link="l6"/><child link="tip"/><axis xyz="0 0 1"/>'
    '<limit lower="-3" upper="3" velocity="1" effort="1"/><mimic joint="mid"/></joint><link name="side"/>'
    '<joint name="mid" type="revolute"><parent link="base"/><child link="side"/><axis xyz="0 0 1"/>'
    '<limit lower="-3" upper="3" velocity="1" effort="1"/><mimic joint="joint1"/></joint>'
)
"""A flange whose joint mimics one beside the arm, which mimics the arm's first joint."""


def sides(found: Imported) -> dict[str, str]:
    """Returns the flanges by side."""
    return {arm.name: arm.flange for arm in found.loaded.robot.arms}


def told(found: Imported) -> str:
    return "\n".join(found.reasons)


@pytest.mark.parametrize(
    ("name", "side", "part", "gripper"),
    [
        ("handling_joint1", "", "", ""),
        ("overhead_l6", "", "", ""),
        ("HEAD_JOINT1", "", "head", ""),
        ("RLEG_JOINT0", "right", "leg", ""),
        ("LAnkleRoll", "left", "ankle", ""),
        ("bl_caster_rotation_joint", "", "caster", ""),
        ("panda_leftfinger", "left", "", "finger"),
        ("l_gripper_r_finger_joint", "", "", "gripper"),
        ("leftarm2", "left", "", ""),
        ("LARM_JOINT0", "left", "", ""),
        ("r_shoulder_pan_joint", "right", "", ""),
        ("yumi_joint_1_l", "left", "", ""),
        ("right_l", "right", "", ""),
        ("right_l6", "right", "", ""),
        ("l6", "", "", ""),
        ("arm_left_torso", "left", "", ""),
        ("upright", "", "", ""),
        ("legs", "", "leg", ""),
    ],
)
def test_names_are_read_word_by_word(name: str, side: str, part: str, gripper: str) -> None:
    """Names of real robots: NAO, HRP-2, PR2, Panda, YuMi, SDA10F; and words that only contain one of the parts."""
    assert (side_of(name), word_among(name, NO_ARM), word_among(name, GRIPPER)) == (
        side,
        part,
        gripper,
    )


def group(name: str, tip: str) -> str:
    return f'<group name="{name}"><chain base_link="base" tip_link="{tip}"/></group>\n'


def test_words_that_only_contain_a_part_are_arms(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """'hand' in handling, 'head' in overhead."""
    for name in ("handling_", "overhead_"):
        assert sides(import_with(write_rows(row(name, 0)))) == {"left": f"{name}l6"}


def test_rows_of_legs_are_told(row: Row, write_rows: Write, import_with: Import) -> None:
    arms = [row("left_", 0.3), row("right_", -0.3)]
    legs = [row("left_leg_", 0.9), row("right_leg_", -0.9)]
    found = import_with(write_rows(*legs, *arms))
    assert sides(found) == {"left": "left_l6", "right": "right_l6"}
    assert "no arm: left_leg_joint1 to left_leg_joint6 ('leg' in left_leg_joint1)" in told(found)
    with pytest.raises(UsageError, match=r"no arm was found.*'leg' in right_leg_joint1"):
        import_with(write_rows(*legs))


def test_groups_of_legs_are_no_arms(row: Row, write_rows: Write, import_with: Import) -> None:
    """Legs first, as in the SRDF of a humanoid; messages name the group and the file that name the flange."""
    rows = [row(f"{s}_{k}", y) for s, y in (("left", 0.3), ("right", -0.3)) for k in ("", "leg_")]
    names = [("left_leg", "left_leg_l6"), ("right_leg", "right_leg_l6")]
    names += [("left_arm", "left_l6"), ("right_arm", "right_l6")]
    found = import_with(write_rows(*rows), "\n".join(group(*pair) for pair in names))
    assert sides(found) == {"left": "left_l6", "right": "right_l6"}
    assert re.search(
        r"left arm: .*; flange left_l6 \(group 'left_arm' of robot.srdf\)", told(found)
    )


@pytest.mark.parametrize(
    "names", [("l_arm", "r_arm"), ("arm_left_torso", "arm_right_torso"), ("LeftArm", "RightArm")]
)
def test_groups_tell_their_side_by_the_usual_marks(
    names: tuple[str, str], row: Row, write_rows: Write, import_with: Import
) -> None:
    """PR2 and TALOS, TIAGo, capitals; the tree alone does not tell these rows apart."""
    urdf = write_rows(row("a_", 0.3), row("b_", -0.3))
    srdf = group(names[0], "b_l6") + group(names[1], "a_l6")
    assert sides(import_with(urdf, srdf)) == {"left": "b_l6", "right": "a_l6"}


def test_groups_with_arm_in_their_name_come_first_and_two_are_refused(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """A group that is not called an arm does not count beside one that is; of two arms an option chooses."""
    urdf = write_rows(row("left_", 0.3), row("right_", -0.3), row("left_second_", 0.9))
    both = group("right_arm", "right_l6") + group("left_arm", "left_l6")
    found = import_with(urdf, group("left_side", "left_second_l6") + both)
    assert sides(found)["left"] == "left_l6"
    two = both + group("left_arm_2", "left_second_l6")
    message = r"left_l6 \(group 'left_arm' of .*\), left_second_l6 \(group 'left_arm_2' of .*\); say which with"
    with pytest.raises(UsageError, match=message):
        import_with(urdf, two)
    assert (
        sides(import_with(urdf, two, tips={"left": "left_second_l6"}))["left"] == "left_second_l6"
    )
    same = group("left_arm_and_torso", "left_l6") + both
    assert sides(import_with(urdf, same))["left"] == "left_l6"


def test_the_tree_tells_the_arm_that_nobody_names(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """An SRDF with a chain for one side only, and --left-tip alone."""
    urdf = write_rows(row("left_", 0.3), row("right_", -0.3))
    half = (
        group("left_arm", "left_l6")
        + '<group name="right_arm"><joint name="right_joint1"/></group>'
    )
    both = {"left": "left_l6", "right": "right_l6"}
    assert sides(import_with(urdf, half)) == both
    found = import_with(urdf, tips={"left": "left_l6"})
    assert sides(found) == both
    assert "flange left_l6 (--left-tip)" in told(found)
    assert sides(import_with(urdf, tips={"left": "left_l6", "right": "none"})) == {
        "left": "left_l6"
    }


def test_an_arm_that_the_tree_does_not_tell_is_told(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    urdf = write_rows(row("left_", 0.3), row("a_", -0.3), row("b_", -0.6))
    found = import_with(urdf, tips={"left": "left_l6"})
    assert sides(found) == {"left": "left_l6"}
    assert "no right arm: " in told(found)
    assert "end in a_l6, b_l6; name its end with --right-tip" in told(found)


@pytest.mark.parametrize(
    ("tips", "message"),
    [
        ({"left": "left_l6", "right": "left_l6"}, "--left-tip and --right-tip both name 'left_l6'"),
        (
            {"left": "left_l3", "right": "left_l6"},
            "--left-tip: link 'left_l3' is moved by 3 joints",
        ),
        ({"left": "left_l1"}, "--left-tip: link 'left_l1' is moved by 1 joint "),
    ],
)
def test_tips_of_one_arm_are_refused(
    tips: dict[str, str], message: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    urdf = write_rows(row("left_", 0.3), row("right_", -0.3))
    with pytest.raises(UsageError, match=message):
        import_with(urdf, tips=tips)


def waist(*axes: str) -> str:
    """Returns joints on one another below the link `base`, `waist1` with the first axis first; 0.1 to 0.5 rad."""
    text = ""
    for k, axis in enumerate(axes, 1):
        parent, child = f"w{k}", "base" if k == len(axes) else f"w{k + 1}"
        text += (
            f'<link name="{parent}"/><joint name="waist{k}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="0 0 0.1" rpy="0 0 1"/><axis xyz="{axis}"/>'
            '<limit lower="0.1" upper="0.5" velocity="2" effort="1"/></joint>'
        )
    return text


@pytest.mark.parametrize(
    ("axes", "platform"),
    [
        (("0 0 1", "0 1 0", "1 0 0"), "waist1"),
        (("0 1 0", "0 0 -1", "1 0 0"), "waist2"),
        (("0 0 1", "0 1 0", "0 0 1"), "waist3"),
        (("1 0 0", "0 1 0"), "waist2"),
    ],
)
def test_the_vertical_joint_of_a_waist_is_the_platform(
    axes: tuple[str, ...], platform: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    """Of equal ones that nearest to the arms; the others are held at their least angle, 0.1 rad, and told."""
    rows = [row("left_", 0.3), row("right_", -0.3)]
    found = import_with(write_rows(*rows, more=waist(*axes)))
    assert found.loaded.robot.platform == (platform,)
    assert f"platform: {platform}: turns and carries both arms" in told(found)
    file = found.files["robot.yaml"].decode()
    for name in (f"waist{k}" for k in range(1, len(axes) + 1)):
        assert (f"{name}: turns and carries both arms; held at 5.72958 deg" in told(found)) == (
            name != platform
        )
        assert (f"  {name}: 5.72958 deg\n" in file) == (name != platform)


def test_a_held_joint_may_have_no_position_limits(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """The upper joint of the waist turns without end."""
    lower, _, upper = waist("0 0 1", "0 1 0").partition('name="waist2"')
    endless = f'{lower}name="waist2"{upper.replace("revolute", "continuous")}'
    rows = [row("left_", 0.3), row("right_", -0.3)]
    file = import_with(write_rows(*rows, more=endless)).files["robot.yaml"].decode()
    assert "# it carries both arms, without position limits; to let it move" in file
    assert "  waist2: 0 deg\n" in file


def test_a_row_with_a_mimic_joint_is_told_and_the_other_arm_keeps_its_side(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    found = import_with(write_rows(row("left_", 0.3, "left_joint2"), row("right_", -0.3)))
    assert sides(found) == {"right": "right_l6"}
    assert "no arm: left_joint1 to left_joint6, as left_joint4 mimics left_joint2" in told(found)
    with pytest.raises(UsageError, match=r"no arm was found.*joint4 mimics joint2"):
        import_with(write_rows(row("", 0, "joint2")))


def test_a_flange_that_follows_through_another_joint_is_refused(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """By the import, and by the reader of robot files at the arm's joints."""
    urdf = write_rows(row("", 0), more=FOLLOWER)
    with pytest.raises(
        UsageError, match="link 'tip' is moved by joint 'follow', which mimics 'joint1'"
    ):
        import_with(urdf, tips={"left": "tip"})
    found = import_with(urdf)
    assert sides(found) == {"left": "l6"}
    still = "joints that mimic moving ones stand still, their links' shapes with them: follow (joint1), mid (joint1)"
    assert still in found.loaded.notes
    joints = ", ".join(f"joint{k}" for k in range(1, 7))
    file = urdf.parent / "robot.yaml"
    file.write_text(
        f"dualarm: robot/1\nname: odd\nurdf: robot.urdf\narms: {{left: {{joints: [{joints}], flange: tip}}}}\n"
        "limits: {default: {acceleration: 1, jerk: 10}}\n"
    )
    with pytest.raises(
        InputError, match=r"robot.yaml:4.*'follow', which moves flange 'tip', mimics 'joint1'"
    ):
        load_robot(file)


def test_errors_of_the_files_that_are_written_name_the_urdf(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """A link and a joint of one name cannot be told apart in a flange: the joint's line, no temporary file."""
    urdf = write_rows(row("", 0).replace('"l6"', '"joint6"').replace("\n", ""), more="\n")
    with pytest.raises(
        InputError, match=r"robot\.urdf:1:\d+: .* a link and a joint named 'joint6'"
    ) as refused:
        import_with(urdf)
    assert "robot.yaml" not in str(refused.value)


def test_one_arm_has_no_side(row: Row, write_rows: Write, import_with: Import) -> None:
    """Its files call it `left`; no sentence does, also not that of a rail before it."""
    rail = (
        '<link name="car"/><joint name="rail" type="prismatic"><parent link="base"/><child link="car"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    )
    arm = row("", 0.0).replace('parent link="base"', 'parent link="car"')
    found = import_with(write_rows(arm, more=rail))
    assert list(sides(found)) == ["left"]
    assert "left" not in told(found)
    for sentence in (
        "one arm: joint1, ",
        "\ntool: along +z of l6 ",
        "rail: slides and carries the arm;",
    ):
        assert sentence in told(found)
