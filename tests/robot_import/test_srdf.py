# ruff: noqa: E501 (tables of exact messages, one a line)
"""What an SRDF says of postures and contacts: each is taken after a check, or it is told why not."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import geometry_model, link_solids
from dualarm_cli.errors import InputError
from dualarm_cli.robot_import.importing import Imported

Row = Callable[..., str]
Write = Callable[..., Path]
Import = Callable[..., Imported]


def state(name: str, values: dict[str, float], group: str = "arm") -> str:
    joints = "".join(f'<joint name="{joint}" value="{value}"/>' for joint, value in values.items())
    return f'<group_state name="{name}" group="{group}">{joints}</group_state>\n'


def arm(*values: float, prefix: str = "") -> dict[str, float]:
    return {f"{prefix}joint{k}": value for k, value in enumerate(values, start=1)}


def told(found: Imported, posture: str) -> str:
    """Returns the one reason that is given for a posture."""
    (reason,) = (r for r in found.reasons if re.match(rf"posture {posture}( of the SRDF|:)", r))
    return reason


def test_states_are_taken_where_the_robot_can_be_in_them(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """Each other one is told with its reason: a limit is 2.9 rad; 2.9 rad thrice folds the arm onto itself."""
    ready = arm(0.2, 0.1, 0.3, 0.2, 0.4, 0.2)
    states = [
        state("ready", ready),
        state("far", arm(0, 0, 0, 0, 0, 2.95)),
        state("folded", arm(0, 2.9, 2.9, 0, 2.9, 0)),
        state("part", {"joint1": 0.5}),
        state("free", ready),
        state("two", arm(0.2, 0.1, 0.2, 0.2, 0.2, 0.2), "a"),
        state("two", arm(0.2, 0.7, 0.2, 0.2, 0.2, 0.2), "b"),
    ]
    found = import_with(write_rows(row("", 0)), "".join(states))
    robot = found.loaded.robot
    assert set(robot.postures) == {"home", "ready"}
    assert robot.postures["ready"] == pytest.approx(list(ready.values()))
    assert told(found, "ready") == "posture ready: group state of the SRDF"
    assert "joint6 at 2.95 is outside its limits, -2.9 to 2.9" in told(found, "far")
    assert "collide or are nearer than 10 mm" in told(found, "folded")
    assert "it does not name all joints of an arm" in told(found, "part")
    assert "`free` cannot name a posture" in told(found, "free")
    assert "joint2 is at 0.1 and at 0.7" in told(found, "two")
    assert told(found, "home").startswith("posture home: proposed")


def test_a_home_that_collides_is_not_taken(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """The one that is proposed in its place keeps all links 10 mm apart, by coal's distances."""
    urdf = write_rows(row("", 0))
    found = import_with(urdf, state("home", arm(0, 2.9, 2.9, 0, 2.9, 0)))
    reasons = [reason for reason in found.reasons if reason.startswith("posture home")]
    assert reasons[0].startswith("posture home of the SRDF is not taken: l1 and l5 and 4 more")
    assert reasons[1].startswith("posture home: proposed")
    robot = found.loaded.robot
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    pairs = [(i, j) for i in range(6) for j in range(i + 2, 6)]
    geometry = geometry_model(solids, pairs)
    results = pin.GeometryData(geometry)
    pin.computeDistances(model, model.createData(), geometry, results, robot.postures["home"])
    assert min(result.min_distance for result in results.distanceResults) > 0.01
    sound = arm(0.2, 0.1, 0.3, 0.2, 0.4, 0.2)
    taken = import_with(urdf, state("home", sound))
    assert taken.loaded.robot.postures["home"] == pytest.approx(list(sound.values()))
    assert told(taken, "home") == "posture home: group state of the SRDF"


def test_a_state_of_one_arm_leaves_the_other_at_home(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    urdf = write_rows(row("left_", 0.3), row("right_", -0.3))
    found = import_with(urdf, state("ready", arm(0.2, 0.1, 0.3, 0.2, 0.4, 0.2, prefix="left_")))
    robot = found.loaded.robot
    right = robot.columns(robot.arm("right").joints)
    assert np.any(robot.postures["home"][right] != 0.0)
    assert robot.postures["ready"][right] == pytest.approx(robot.postures["home"][right])
    assert told(found, "ready").endswith("right arm as in home")


def test_joints_of_several_positions_are_passed_over(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """The base of a humanoid, which the URDF does not have."""
    free = '<joint name="root_joint" value="0 0 1 0 0 0 1"/></group_state>'
    text = state("ready", arm(0.2, 0.1, 0.3, 0.2, 0.4, 0.2)).replace("</group_state>", free)
    assert "ready" in import_with(write_rows(row("", 0)), text).loaded.robot.postures


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('\n<disable_collisions link1="l1" reason="User"/>', r"robot.srdf:2:1: .*has no link2; it needs two links"),
        ("\n\n<disable_collisions/>", r"robot.srdf:3:1: .*has no link1"),
        ('\n<disable_collisions link1="l1" link2="l9"/>', r"robot.srdf:2:1: .*no link 'l9'"),
        ('\n<end_effector name="e" parent_link="l9"/>', r"robot.srdf:2:1: .*no link 'l9'"),
        ('\n<group_state><joint name="joint1" value="0"/></group_state>', r"robot.srdf:2:1: .*<group_state> has no name"),
        ('\n<group_state name="a">\n<joint name="joint1"/></group_state>', r"robot.srdf:3:1: .*value must be a number, not nothing"),
    ],
)  # fmt: skip
def test_what_is_missing_is_told_at_its_line(
    text: str, message: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    with pytest.raises(InputError, match=message):
        import_with(write_rows(row("", 0)), text)


def test_pairs_that_the_srdf_leaves_out_are_judged_by_sampling(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """A plate of 0.5 m on the flange, a ball in the arm's base: touched never, in some postures, always.

    The plate turns with the flange and passes the first link in some postures only (coal, 300 postures of its own).
    """
    ball = (
        '<link name="{}"><collision><geometry><sphere radius="{}"/></geometry></collision></link>'
    )
    fixed = (
        '<joint name="{0}_joint" type="fixed"><parent link="base"/><child link="{0}"/>'
        '<origin xyz="0 0 {1}"/></joint>'
    )
    more = (
        ball.format("wide", 0.35) + fixed.format("wide", 0.3)
        + ball.format("far", 0.1) + fixed.format("far", 9)
        + '<link name="plate"><collision><geometry><box size="0.5 0.5 0.01"/></geometry></collision></link>'
        '<joint name="plate_joint" type="fixed"><parent link="l6"/><child link="plate"/></joint>'
    )  # fmt: skip
    pairs = {"far": "l6", "wide": "l2", "plate": "l1"}
    lines = [
        f'<disable_collisions link1="{one}" link2="{other}" reason="User"/>\n'
        for one, other in pairs.items()
    ]
    found = import_with(write_rows(row("", 0), more=more), "".join(lines))
    robot = found.loaded.robot
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    bodies = [solid.body for solid in solids]
    indices = [
        (min(bodies.index(a), bodies.index(b)), max(bodies.index(a), bodies.index(b)))
        for a, b in pairs.items()
    ]
    geometry = geometry_model(solids, indices)
    results = pin.GeometryData(geometry)
    touched = np.zeros(3)
    for q in np.random.default_rng(3).uniform(-2.9, 2.9, (300, 6)):
        pin.computeDistances(model, model.createData(), geometry, results, q)
        touched += [result.min_distance < 0.01 for result in results.distanceResults]
    assert touched[0] == 0
    assert touched[1] == 300
    assert 0 < touched[2] < 250
    text = found.files["robot.yaml"].decode()
    allowed, assumed = text.split("allowed_contacts:")[1].split("assumed_contacts:")
    assert re.search(r"\[(far, l6|l6, far)\]  # SRDF: User; touch in 0% of 10000 postures", allowed)
    assert re.search(r"\[(wide, l2|l2, wide)\]  # SRDF: User; touch in 100% of 10000", allowed)
    (share,) = re.findall(r"(?:l1, plate|plate, l1)\]  # SRDF: User; touch in ([\d.]+)%", assumed)
    assert float(share) == pytest.approx(100 * touched[2] / 300, abs=8.0)
    assert any("plate" in note and "l1" in note for note in found.loaded.notes)
