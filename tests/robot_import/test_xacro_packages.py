"""Makers' xacro files: packages found without ROS, arguments, and what is missing in one line each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError, UsageError
from dualarm_cli.files.robots.meshes import link_meshes
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.urdf import read_urdf
from dualarm_cli.files.source.projects import Project
from dualarm_cli.robot_import.confined import XacroInput
from dualarm_cli.robot_import.expanded_text import (
    check_arguments,
    parse_arguments,
    program_notes,
    read_expanded,
)
from dualarm_cli.robot_import.importing import ImportRequest
from dualarm_cli.starting.robot_source import robot_source
from tests.robot_import.makers_xacro import (
    REFERENCE,
    ROBOTS,
    robot,
    write_installed,
    write_workspace,
)
from tests.robot_import.test_confined import LANDLOCK, program


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the top files, in a workspace without ROS."""
    return write_workspace(tmp_path_factory.mktemp("workspace"))


@pytest.fixture(scope="module")
def references(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What xacro makes of each top file where the packages are installed with ROS's index."""
    folder = tmp_path_factory.mktemp("ros")
    write_installed(folder)
    home = folder / "share/maker_arm/urdf"
    work = [(str(home / f"{name}.urdf.xacro"), a) for name, (_, a) in ROBOTS.items()]
    path = os.pathsep.join([str(folder / "python"), *filter(None, sys.path)])
    ended = subprocess.run(
        [sys.executable, "-c", dedent(REFERENCE)],
        input=json.dumps(work),
        env={"AMENT_PREFIX_PATH": str(folder), "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(ROBOTS, json.loads(ended.stdout), strict=True))


@pytest.mark.parametrize("name", ROBOTS)
def test_links_are_where_xacro_puts_them_with_ros(
    name: str, workspace: Path, references: dict[str, str]
) -> None:
    """Expanded in a maker's repository without ROS: the same links, joints and limits, at random positions."""
    given = XacroInput(ROBOTS[name][1], (workspace.parents[1],))
    text = read_expanded(workspace / f"{name}.urdf.xacro", given).text
    ours, theirs = (pin.buildModelFromXML(urdf) for urdf in (text, references[name]))
    assert [frame.name for frame in ours.frames] == [frame.name for frame in theirs.frames]
    assert ours.nq > 0
    for attribute in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit"):
        assert np.array_equal(getattr(ours, attribute), getattr(theirs, attribute))
    q = np.random.default_rng(0).uniform(-1.0, 1.0, ours.nq)
    data = [model.createData() for model in (ours, theirs)]
    for model, values in zip((ours, theirs), data, strict=True):
        pin.framesForwardKinematics(model, values, q)
    for own, other in zip(data[0].oMf, data[1].oMf, strict=True):
        assert np.array_equal(own.homogeneous, other.homogeneous)


@pytest.mark.parametrize("name", ["gripper", "file_meshes", "absolute_meshes"])
def test_a_mesh_is_read_however_its_package_is_named(name: str, workspace: Path) -> None:
    """By package://, by file:// and by the path that $(find …) gives; scaled by a half."""
    file, packages = workspace / f"{name}.urdf.xacro", (workspace.parents[1],)
    urdf = read_urdf(read_expanded(file, XacroInput({}, packages)))
    finder = PackageFinder(Project.of(file), file, packages, beyond=True)
    (shape,) = link_meshes(urdf, finder).shapes["gripper"]
    assert shape.hull is not None
    corners = sorted(shape.hull.corners.round(6).tolist())
    assert corners == [[0.0, 0.0, 0.0], [0.0, 0.0, 0.05], [0.0, 0.05, 0.0], [0.05, 0.0, 0.0]]


def test_a_package_is_named_once_however_many_meshes_it_has(
    tmp_path: Path, row: Callable[..., str]
) -> None:
    """Six of a package and six of another machine's folder: two lines, each with what to do."""
    path = tmp_path / "arm.urdf"
    solids = [
        f'<collision><geometry><mesh filename="{place}/part{{}}.stl"/></geometry></collision>'
        for place in ("package://gone", "file:///none/of/this")
    ]
    rows = [row(prefix, 0.0, shape=solid) for prefix, solid in zip("ab", solids, strict=True)]
    path.write_text(f'<robot name="a"><link name="base"/>{"".join(rows)}</robot>')
    finder = PackageFinder(Project.of(path), path, beyond=True)
    with pytest.raises(InputError) as refused:
        link_meshes(read_urdf(read_expanded(path)), finder)
    package, folder = (entry.message for entry in refused.value.diagnostics)
    assert package.startswith("mesh: package 'gone' is not in ")
    assert package.endswith("name its folder with `dualarm robot import --package-dir` (6 meshes)")
    assert folder.startswith("mesh: there is no folder '/none/of/this' on this machine; ")
    assert folder.endswith(" (6 meshes)")


def test_arguments_are_named_with_their_defaults(
    workspace: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The one-armed variant says which argument gives six joints more; with it there are two arms."""
    monkeypatch.chdir(workspace)
    file = "one_armed.urdf.xacro"
    assert run(["robot", "import", file, "--out", "arm"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert f"{file}: arguments with which more joints move: bimanual:=true (6 more)" in lines
    defaults = f"{file}: arguments at their defaults: bimanual 'false', simulated 'true'; "
    assert any(line.startswith(defaults) for line in lines)
    reasons = robot_source(ImportRequest(Path(file), arguments={"bimanual": "true"})).reasons
    assert [r.split(":")[0] for r in reasons if " arm: " in r] == ["left arm", "right arm"]
    assert not any("bimanual" in reason for reason in reasons)
    with pytest.raises(UsageError, match="only a URDF or xacro file takes options of the import"):
        robot_source(ImportRequest(Path("yumi"), arguments={"bimanual": "true"}))


def test_an_argument_that_is_missing_or_unknown_is_named(tmp_path: Path) -> None:
    """The robot's name is used before its default is set, as makers do; a typing error gets a suggestion."""
    path = tmp_path / "arm.urdf.xacro"
    content = (
        '<xacro:arg name="name" default="ur"/><xacro:arg name="kind" default="5"/><link name="b"/>'
    )
    path.write_text(robot(content, "$(arg name)"))
    needed = "it needs a value of its argument `name`: add --xacro-arg name:=VALUE"
    changes = "; arguments at their defaults, which --xacro-arg NAME:=VALUE changes: kind '5'$"
    with pytest.raises(InputError, match=f"E400 xacro cannot expand it: {needed}{changes}"):
        read_expanded(path)
    unset = '<xacro:arg name="side"/><xacro:arg name="mesh" default="$(arg side)"/>'
    path.write_text(robot(content + unset, "$(arg name)"))
    both = "values of its arguments `name`, `side`: add --xacro-arg name:=VALUE --xacro-arg side"
    with pytest.raises(InputError, match=f"it needs {both}:=VALUE{changes}"):
        read_expanded(path)
    path.write_text(robot(content, "$(arg name)"))
    source = read_expanded(path, XacroInput({"name": "mine"}))
    assert read_urdf(source).root.name == "mine"
    assert "arguments at their defaults: kind '5';" in program_notes(source)[1]
    check_arguments({"name": "mine"}, source)
    with pytest.raises(
        UsageError, match=r"--xacro-arg kid: .* no such argument, did you mean 'kind'"
    ):
        check_arguments({"kid": "7"}, source)
    path.write_text('<robot name="a"><link name="b"/></robot>')
    with pytest.raises(UsageError, match=r"--xacro-arg kind: .*arm.urdf.xacro is not a xacro file"):
        check_arguments({"kind": "7"}, read_expanded(path))
    path.write_text(
        robot('<xacro:arg name="file" default="no"/><xacro:include filename="$(arg file)"/>')
    )
    with pytest.raises(
        InputError, match=r"No such file.*--xacro-arg NAME:=VALUE changes: file 'no'"
    ):
        read_expanded(path)


def test_arguments_of_a_pair_are_of_both_or_of_one_side() -> None:
    texts = ["name:=a", "left:type:=ur5e", "right:type:=ur10e", "empty:="]
    assert parse_arguments(texts, "left") == {"name": "a", "type": "ur5e", "empty": ""}
    assert parse_arguments(texts, "right") == {"name": "a", "type": "ur10e", "empty": ""}
    for text, side in (
        ("type=ur5e", ""),
        (":=a", "left"),
        ("left:type:=a", ""),
        ("up:a:=b", "left"),
    ):
        with pytest.raises(UsageError, match="must be NAME:=VALUE"):
            parse_arguments([text], side)


@LANDLOCK
def test_a_file_includes_from_packages_only(tmp_path: Path) -> None:
    """A folder without package.xml above the file is none, whatever its name; the user may name it."""
    (tmp_path / "private").mkdir()
    (tmp_path / "private/part.xacro").write_text(robot('<link name="part"/>'))
    file = tmp_path / "downloads/arm/urdf/arm.xacro"
    file.parent.mkdir(parents=True)
    (tmp_path / "downloads/arm/package.xml").write_text("<package><name>arm</name></package>")
    # Its own package is no folder more.
    mine = '<link name="$(find arm)"/>'
    file.write_text(robot(f'{mine}<xacro:include filename="$(find private)/part.xacro"/>'))
    with pytest.raises(InputError, match="package 'private' is not in the folder of the URDF"):
        read_expanded(file)
    named = read_expanded(file, XacroInput({}, (tmp_path / "private",)))
    assert '<link name="part"/>' in named.text
    (tmp_path / "private/package.xml").write_text("<package><name>private</name></package>")
    source = read_expanded(file)
    assert program_notes(source) == (
        f"{file} is a program: xacro ran it confined to reading {file.parents[1]}, {tmp_path / 'private'}",
    )


@pytest.mark.parametrize(
    "answer",
    [
        '{"text": "", "error": "again", "package": "arm", "defaults": {}, "arguments": [], "joints": []}',
        '{"text": "", "error": "up", "package": "..", "defaults": {}, "arguments": [], "joints": []}',
        '{"text": "<robot/>", "error": "", "package": "", "defaults": 3, "arguments": [], "joints": []}',
        '["text"]',
    ],
)
def test_an_answer_that_a_program_writes_itself_is_refused(tmp_path: Path, answer: str) -> None:
    """Asking for a package again and again, for one that is no name, and of another form."""
    (tmp_path / "package.xml").write_text("<package><name>arm</name></package>")
    file = tmp_path / "arm.xacro"
    file.write_text(
        program(f"__import__('os').write(1, {answer.encode()!r}); __import__('os')._exit(0)")
    )
    with pytest.raises(InputError, match="E400 xacro cannot expand it: "):
        read_expanded(file)
