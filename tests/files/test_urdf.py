# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.robots.robots import load_robot

Change = Callable[..., None]
Messages = Callable[..., list[str]]
LINK = '<link name="la"/>'


def _solid(shape: str) -> str:
    return f'<link name="la"><collision><geometry>{shape}</geometry></collision></link>'


def _mass(mass: str, ixx: str = "1") -> str:
    inertia = f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    return f'<link name="la"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "tiny.urdf: E400 is empty; a URDF is required"),
        ("<robot>", "tiny.urdf:1:8: E400 not XML: no element found"),
        ("<link/>", "tiny.urdf:1:1: E400 root element must be <robot>, not <link>"),
        ("<sdf/>", "tiny.urdf:1:1: E400 Gazebo (SDF) is not read; give the maker's URDF or xacro file"),
        ("<mujoco/>", "tiny.urdf:1:1: E400 MuJoCo (MJCF) is not read; give the maker's URDF or xacro file"),
        ("<robot/>", "tiny.urdf:1:1: E400 there is no <link>"),
        ("<robot name='&e;'/>", "tiny.urdf:1:1: E400 not XML: undefined entity"),
        ("<a>" * 100_000, "tiny.urdf:1:121: E100 exceeds the limits of XML files (50000 elements, 40 deep)"),
        ("<robot><xacro:macro/></robot>", "tiny.urdf:1:8: E400 <xacro:macro>: this is a xacro file; `dualarm robot import` expands it"),
    ],
)  # fmt: skip
def test_what_is_no_urdf_is_refused(
    text: str, message: str, project: Path, messages: Messages
) -> None:
    """Empty, cut off, other formats, bombs."""
    (project / "tiny.urdf").write_text(text)
    assert messages(lambda: load_robot(Path("robot.yaml"))) == [message]


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE r SYSTEM "file:///x.dtd">',
    ],
)
def test_a_doctype_is_refused_before_any_entity_is_read(
    doctype: str, project: Path, messages: Messages
) -> None:
    """Neither external files nor entity bombs are reachable."""
    (project / "tiny.urdf").write_text(doctype + '\n<robot name="a"/>')
    (message,) = messages(lambda: load_robot(Path("robot.yaml")))
    assert message.startswith("tiny.urdf:1:")
    assert message.endswith("E400 a DOCTYPE or entity is not allowed; remove it")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('axis xyz="0 0 2"', 'axis xyz="0 0 0"', "11:101: E400 joint 'turn': axis must not be zero"),
        ('lower="-3" upper="3"', 'lower="3" upper="-3"', "11:120: E400 joint 'turn': lower limit 3 is above upper limit -3"),
        ('lower="-3"', 'lower="-3,0"', "11:120: E400 joint 'turn': lower holds '-3,0', which is not a finite number; write a decimal point"),
        ('upper="3"', 'upper="inf"', "11:120: E400 joint 'turn': upper holds 'inf', which is not a finite number"),
        ('velocity="2"', 'velocity="nan"', "11:120: E400 joint 'turn': velocity holds 'nan', which is not a finite number"),
        ('velocity="2"', 'velocity="0"', "11:120: E400 joint 'turn': velocity limit must be above 0, not 0"),
        ('velocity="2" ', "", "11:120: E400 joint 'turn': velocity must be a number, not nothing"),
        ('<limit lower="-3" upper="3" velocity="2" effort="1"/>', "", "11:1: E400 joint 'turn' has no <limit>; give lower, upper and velocity"),
        ('xyz="0.1 0 0.2"', 'xyz="0.1 0"', "11:36: E400 joint 'turn': xyz must be 3 numbers, not '0.1 0'"),
        ('<parent link="base"/>', '<parent link="bas"/>', "11:61: E400 joint 'turn': there is no link 'bas', did you mean 'base'?"),
        ('<parent link="base"/>', '<parent link="l_tool"/>', "11:1: E400 joints form a cycle through link 'top'"),
        ('<parent link="base"/>', "", "11:1: E400 joint 'turn': <parent link=\"…\"/> is missing"),
        ('<child link="lb"/>', '<child link="la"/>', None),
        ('name="l2" type', 'name="l1" type', "13:1: E400 duplicate joint 'l1', first at line 12"),
        ('name="l2" type="revolute"', 'name="l2" type="fixed"', "13:1: E400 joint 'l2' is fixed; the robot file needs one that turns or slides"),
        ('name="l2" type="revolute">', 'name="l2" type="revolute"><mimic joint="l1"/>', "13:34: E400 joint 'l2' mimics 'l1'; joints that follow others cannot be planned"),
        (LINK, f"{LINK}\n{LINK}", "6:1: E400 duplicate link 'la', first at line 5"),
        (LINK, f'{LINK}\n<link name="lost"/>', "6:1: E400 2 root links: 'base', 'lost'; join them by joints"),
        (LINK, _mass("-1"), "5:27: E400 link 'la': mass must not be negative, not -1 kg"),
        (LINK, _mass("1", "-2"), "5:44: E400 link 'la': ixx must not be negative, not -2"),
        (LINK, _solid('<sphere radius="-0.1"/>'), "5:38: E400 link 'la': sphere radius must be above 0, not -0.1"),
        (LINK, _solid('<box size="1 2"/>'), "5:38: E400 link 'la': size must be 3 numbers, not '1 2'"),
        (LINK, _solid('<mesh filename="package://../../etc/passwd"/>'), "5:38: E400 mesh: 'package://../../etc/passwd' must be package://name/path"),
        (LINK, _solid('<mesh filename="file:///etc/passwd"/>'), "5:38: E400 mesh: 'file:///etc/passwd' is valid only on the machine that wrote it; write a path relative to the URDF"),
        (LINK, _solid('<mesh filename="package://arm/meshes/none.stl"/>'), "5:38: E400 mesh: package 'arm' is not in the folder of the URDF, in those above it, or in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH; name its folder with `dualarm robot import --package-dir`"),
        ('velocity="2"', 'velocity="2" acceleration="0"', "11:120: E400 joint 'turn': acceleration limit must be above 0, not 0"),
        (LINK, _solid('<capsule radius="0" length="1"/>'), "5:38: E400 link 'la': capsule radius must be above 0, not 0"),
        (LINK, _solid('<mesh filename="none.stl"/>'), "5:38: E400 mesh: there is no file 'none.stl' here"),
        (LINK, _solid('<mesh filename="huge.stl"/>'), "5:38: E400 mesh: 'huge.stl' is not a whole STL file: 4000000000 triangles in 84 bytes"),
        (LINK, _solid('<mesh filename="robot.yaml"/>'), "5:38: E400 mesh: 'robot.yaml' is not a mesh file; allowed: .stl, .obj, .ply, .dae"),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_line(
    old: str, new: str, expected: str | None, project: Path, change: Change, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    (project / "huge.stl").write_bytes(bytes(80) + struct.pack("<I", 4_000_000_000))
    change("tiny.urdf", old, new)
    found = messages(lambda: load_robot(Path("robot.yaml")))
    if expected is None:
        assert found == [
            "tiny.urdf:6:1: E400 2 root links: 'base', 'lb'; join them by joints",
            "tiny.urdf:13:1: E400 link 'la' is the child of two joints: 'l1' and 'l2'",
        ]
        return
    assert found == [f"tiny.urdf:{expected}"]


def test_a_mesh_behind_a_symbolic_link_out_of_the_folder_is_refused(
    project: Path, change: Change, messages: Messages, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Links are resolved before the folder is compared."""
    outside = tmp_path_factory.mktemp("outside") / "a.stl"
    outside.write_text("solid a\nendsolid a\n")
    (project / "a.stl").symlink_to(outside)
    change("tiny.urdf", LINK, _solid('<mesh filename="a.stl"/>'))
    (message,) = messages(lambda: load_robot(Path("robot.yaml")))
    assert message.startswith("tiny.urdf:5:38: E400 mesh: 'a.stl' leaves the project folder")
