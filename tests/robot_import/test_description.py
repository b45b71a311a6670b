# ruff: noqa: E501 (tables of exact messages, one a line)
"""The description that an import writes: angles, hulls, units of meshes; and errors in what xacro expands."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.robot_import.importing import Imported

Row = Callable[..., str]
Write = Callable[..., Path]
Import = Callable[..., Imported]


@pytest.mark.parametrize("exact", [math.pi / 2, math.pi, -1.5 * math.pi])
@pytest.mark.parametrize("digits", range(4, 12))
def test_multiples_of_a_quarter_turn_are_exact_and_all_else_stays(
    exact: float, digits: int, row: Row, write_rows: Write, import_with: Import
) -> None:
    """Rounded, cut off, padded, or half of what was rounded; seven of the last digit more stay: a calibration."""
    step = 10.0**-digits
    cut = math.trunc(exact / step) * step
    near = [f"{exact + units * step:.{digits}f}" for units in (7.2, 8.2)]
    measured = next(word for word in near if not word.endswith("0"))
    half = 0.5 * float(f"{2 * exact:.{digits}f}")
    words = [f"{exact:.{digits}f}", f"{cut:.{digits}f}", f"{half:.{digits + 1}f}"]
    words += [f"{exact:.{digits}f}00", measured, "0.00004"]
    words += ["-1e-7", "3e-10", "1.57"]
    wanted = [*[exact] * 4, float(words[4]), 4e-5, -1e-7, 3e-10, 1.57]
    text = row("", 0)
    for k, (first, second, third) in enumerate(zip(*[iter(words)] * 3, strict=True)):
        origin = f'<child link="l{k + 2}"/><origin rpy="{first} {second} {third}" '
        text = text.replace(f'<child link="l{k + 2}"/><origin ', origin)
    written = import_with(write_rows(text)).files["odd.urdf"].decode()
    found = [float(word) for rpy in re.findall(r'rpy="([^"]*)"', written) for word in rpy.split()]
    if abs(wanted[4] - exact) < 1e-9:  # noise
        wanted[4] = exact
    assert [w for w in found if w != 0.0] == wanted


def test_a_calibrated_angle_near_zero_moves_the_flange(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """0.04 mrad at the second joint, 0.9 m of links beyond it: 0.036 mm, by pinocchio on the file as it is."""
    text = row("", 0).replace(
        '<child link="l2"/><origin ', '<child link="l2"/><origin rpy="0.00004 0 0" '
    )
    urdf = write_rows(text)
    poses = []
    for source in (urdf.read_text(), import_with(urdf).loaded.robot.urdf):
        model = pin.buildModelFromXML(source)
        data = model.createData()
        pin.framesForwardKinematics(model, data, np.zeros(model.nq))
        poses.append(data.oMf[model.getFrameId("l6")].translation)
    assert abs(poses[0][1]) > 3e-5
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-12)


COLLADA = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"
version="1.4.1"><asset>{unit}<up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="24">{corners}</float_array>
<technique_common><accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="12">
<input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 3 0 3 2 4 6 7 4 7 5 0 4 5 0 5 1 2 3 7 2 7 6 0 2 6 0 6 4 1 5 7 1 7 3</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
BOX = np.array([[x, y, z] for x in (-20, 20) for y in (-30, 30) for z in (0, 100)])
"""Corners of a box of 40 by 60 by 100 units."""


def with_box(row: Row, write_rows: Write, unit: str, up: str = "Z_UP", scale: str = "") -> Path:
    """Writes a robot whose third link is the box."""
    mesh = f'<collision><geometry><mesh filename="box.dae"{scale}/></geometry></collision>'
    text = re.sub(r'(<link name="l3">).*', rf"\1{mesh}</link>", row("", 0))
    path = write_rows(text)
    corners = " ".join(map(str, BOX.ravel()))
    (path.parent / "box.dae").write_text(COLLADA.format(unit=unit, up=up, corners=corners))
    return path


@pytest.mark.parametrize("up", ["Z_UP", "Y_UP", "X_UP"])
@pytest.mark.parametrize(
    ("unit", "scale", "factors"),
    [
        ('<unit meter="0.001"/>', "", [1e-3, 1e-3, 1e-3]),
        ('<unit meter="0.0254" name="inch"/>', ' scale="1 -1 1"', [0.0254, -0.0254, 0.0254]),
        ('<unit meter="1"/>', ' scale="0.001 0.001 0.002"', [1e-3, 1e-3, 2e-3]),
        ("", ' scale="0.001 0.001 0.001"', [1e-3, 1e-3, 1e-3]),
    ],
)
def test_the_unit_of_a_collada_file_counts_and_its_upward_axis_does_not(
    unit: str, scale: str, factors: list[float], up: str, row: Row, write_rows: Write, import_with: Import
) -> None:  # fmt: skip
    """As in RViz: coordinates times unit and scale, by hand; axes as written, as in trimesh and coal as well."""
    path = with_box(row, write_rows, unit, up, scale)
    found = import_with(path)
    (shape,) = found.loaded.robot.meshes["l3"]
    assert shape.hull is not None
    wanted = BOX * factors
    np.testing.assert_allclose(
        [shape.hull.corners.min(axis=0), shape.hull.corners.max(axis=0)],
        [wanted.min(axis=0), wanted.max(axis=0)],
        rtol=1e-6,
    )
    told = [reason for reason in found.reasons if "units of COLLADA files" in reason]
    assert len(told) == ("0.001" in unit or "0.0254" in unit)
    bounds = trimesh.load_mesh(path.parent / "box.dae").bounds
    np.testing.assert_allclose(bounds, [BOX.min(axis=0), BOX.max(axis=0)])


def test_the_unit_counts_in_robot_files_and_convex_parts(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    path = with_box(row, write_rows, '<unit meter="0.001"/>')
    found = import_with(path, divided=("l3",))
    corners = np.concatenate([s.hull.corners for s in found.loaded.robot.meshes["l3"] if s.hull])
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.04, 0.06, 0.1], atol=1e-6)
    told = "\n".join(found.reasons)
    assert "l3: 1 convex part, in meshes/" in told
    assert "hulls" not in told
    joints = ", ".join(f"joint{k}" for k in range(1, 7))
    file = path.parent / "robot.yaml"
    file.write_text(
        f"dualarm: robot/1\nname: odd\nurdf: robot.urdf\narms: {{left: {{joints: [{joints}], flange: l6}}}}\n"
        "limits: {default: {acceleration: 1, jerk: 10}}\n"
    )
    loaded = load_robot(file)
    (shape,) = loaded.robot.meshes["l3"]
    assert shape.hull is not None
    np.testing.assert_allclose(np.ptp(shape.hull.corners, axis=0), [0.04, 0.06, 0.1], atol=1e-6)
    assert any("box.dae (0.001 m)" in note for note in loaded.notes)


@pytest.mark.parametrize(
    ("unit", "scale", "message"),
    [
        ('<unit meter="0.001"/>', ' scale="0.001 0.001 0.001"', "'box.dae' has a unit of 0.001 m and a scale of 0.001 0.001 0.001 in the URDF"),
        ('<unit meter="0"/>', "", "<unit> must be above 0 m, not 0 m"),
        ('<unit meter="mm"/>', "", "<unit> holds 'mm', which is not a finite number"),
    ],
)  # fmt: skip
def test_units_that_can_mean_two_things_are_refused_at_the_mesh(
    unit: str, scale: str, message: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    with pytest.raises(InputError, match=rf"robot\.urdf:\d+:\d+: .*{re.escape(message)}"):
        import_with(with_box(row, write_rows, unit, scale=scale))


def test_an_srdf_is_expanded_as_well(row: Row, write_rows: Write, import_with: Import) -> None:
    """Its macros hold the groups; without the expansion they would be passed over without a word."""
    path = write_rows(row("a_", 0.3), row("b_", -0.3))
    group = '<group name="${side}_arm"><chain base_link="base" tip_link="${tip}"/></group>'
    calls = '<xacro:group side="left" tip="b_l6"/><xacro:group side="right" tip="a_l6"/>'
    found = import_with(
        path, f'<xacro:macro name="group" params="side tip">{group}</xacro:macro>{calls}'
    )
    assert found.loaded.robot.arm("left").flange == "b_l6"


def test_errors_after_xacro_name_the_file_and_the_element(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """The expanded text has lines that the file does not have."""
    text = row("", 0).replace('xyz="0 1 0"', 'xyz="0 0 0"', 1)
    path = write_rows(f'<xacro:macro name="m">{text}</xacro:macro><xacro:m/>')
    with pytest.raises(InputError) as refused:
        import_with(path)
    (found,) = refused.value.diagnostics
    assert found.place == str(path)
    assert found.message == (
        "joint 'joint2': axis must not be zero; the element, as xacro expands it: <axis xyz=\"0 0 0\"/>"
    )
