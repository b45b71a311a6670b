"""Meshes of ROS packages, and meshes that nobody needs."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import link_solids
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.projects import BadReferenceError, Project

Change = Callable[..., None]
Messages = Callable[..., list[str]]
LINK = '<link name="la"/>'
CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]])


def tetrahedron() -> bytes:
    """Returns a binary STL file with four triangles."""
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *CORNERS[list(face)].ravel().tolist(), 0) for face in faces
    )
    return bytes(80) + struct.pack("<I", len(faces)) + body


def link(tag: str, shape: str) -> str:
    return f'<link name="la"><{tag}><geometry>{shape}</geometry></{tag}></link>'


@pytest.mark.parametrize("place", ["arm/meshes", "above/arm/meshes"])
def test_a_package_is_found_by_its_name(project: Path, change: Change, place: str) -> None:
    """Beside the URDF, and in a folder above it that has the package's name."""
    folder = project / place
    folder.mkdir(parents=True)
    (folder / "a.stl").write_bytes(tetrahedron())
    change("tiny.urdf", LINK, link("collision", '<mesh filename="package://arm/meshes/a.stl"/>'))
    if place.startswith("above"):
        home = project / "above/arm/urdf"
        home.mkdir()
        (project / "tiny.urdf").rename(home / "tiny.urdf")
        change("robot.yaml", "urdf: tiny.urdf", "urdf: above/arm/urdf/tiny.urdf")
    (shape,) = load_robot(Path("robot.yaml")).robot.meshes["la"]
    assert shape.hull is not None
    assert sorted(shape.hull.corners.round(6).tolist()) == sorted(CORNERS.tolist())


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_a_package_is_found_where_ros_has_it(
    project: Path,
    change: Change,
    variable: str,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """ROS 1 lists folders of packages; ROS 2 installs them in `share`."""
    outside = tmp_path_factory.mktemp("ros")
    packages = outside / "share" if variable == "AMENT_PREFIX_PATH" else outside
    (packages / "arm").mkdir(parents=True)
    (packages / "arm/a.stl").write_bytes(tetrahedron())
    change("tiny.urdf", LINK, link("collision", '<mesh filename="package://arm/a.stl"/>'))
    monkeypatch.setenv(variable, os.pathsep.join(["/nowhere", str(outside)]))
    assert list(load_robot(Path("robot.yaml")).robot.meshes) == ["la"]


def test_a_package_that_the_user_names_comes_first(tmp_path: Path) -> None:
    """Its own folder or the one that holds it; a file elsewhere is not reached, not by `..` and not by a link."""
    for name in ("one", "two"):
        (tmp_path / name / "arm").mkdir(parents=True)
        (tmp_path / name / "arm/a.stl").write_bytes(b"")
    (tmp_path / "secret.stl").write_bytes(b"")
    (tmp_path / "one/arm/link.stl").symlink_to(tmp_path / "secret.stl")
    urdf = tmp_path / "one/robot.urdf"
    for folder in (tmp_path / "two", tmp_path / "two/arm"):
        finder = PackageFinder(Project(tmp_path), urdf, (folder,))
        assert finder.mesh("package://arm/a.stl") == tmp_path / "two/arm/a.stl"
    finder = PackageFinder(Project(tmp_path), urdf)
    assert finder.mesh("package://arm/a.stl") == tmp_path / "one/arm/a.stl"
    for reference in ("package://arm/../../secret.stl", "package://arm/link.stl", "package://arm"):
        with pytest.raises(BadReferenceError):
            finder.mesh(reference)


def test_an_import_finds_packages_by_the_name_in_package_xml(tmp_path: Path) -> None:
    """In a repository of another name beside the URDF, and three levels down in the workspace that the user names."""
    for repository, name in (("beside/Arm_Repository", "arm"), ("src/a/b/hand_repository", "hand")):
        (tmp_path / repository / "meshes").mkdir(parents=True)
        (tmp_path / repository / "package.xml").write_text(
            f"<package><name>{name}</name></package>"
        )
        (tmp_path / repository / "meshes/a.stl").write_bytes(b"")
    urdf = tmp_path / "beside/urdf/robot.urdf"
    finder = PackageFinder(Project(urdf.parent), urdf, beyond=True)
    arm = tmp_path / "beside/Arm_Repository/meshes/a.stl"
    assert finder.mesh("package://arm/meshes/a.stl") == arm
    with pytest.raises(
        BadReferenceError, match=f"'meshes/b.stl' in package 'arm', which is {arm.parents[1]}$"
    ):
        finder.mesh("package://arm/meshes/b.stl")
    with pytest.raises(BadReferenceError, match="package 'hand' is not in the folder of the URDF"):
        finder.mesh("package://hand/meshes/a.stl")
    named = PackageFinder(Project(urdf.parent), urdf, (tmp_path / "src",), beyond=True)
    hand = tmp_path / "src/a/b/hand_repository/meshes/a.stl"
    assert named.mesh("package://hand/meshes/a.stl") == hand
    for reference in (f"file://{arm}", str(arm)):
        assert finder.mesh(reference) == arm
        with pytest.raises(BadReferenceError):
            PackageFinder(Project(tmp_path), urdf).mesh(reference)


def test_links_are_followed_in_packages_that_the_user_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As colcon installs them: each mesh is a link to the sources."""
    (tmp_path / "source").mkdir()
    (tmp_path / "source/a.stl").write_bytes(b"")
    (tmp_path / "install/arm").mkdir(parents=True)
    (tmp_path / "install/arm/a.stl").symlink_to(tmp_path / "source/a.stl")
    urdf = tmp_path / "install/robot.urdf"
    with pytest.raises(BadReferenceError, match="by a symbolic link; name the package's folder"):
        PackageFinder(Project(tmp_path), urdf).mesh("package://arm/a.stl")
    expected = tmp_path / "install/arm/a.stl"
    named = PackageFinder(Project(tmp_path), urdf, (tmp_path / "install",))
    assert named.mesh("package://arm/a.stl") == expected
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "install"))
    assert PackageFinder(Project(tmp_path), urdf).mesh("package://arm/a.stl") == expected


def test_a_mesh_that_is_only_looked_at_may_be_missing(project: Path, change: Change) -> None:
    change("tiny.urdf", LINK, link("visual", '<mesh filename="package://gone/a.dae"/>'))
    assert load_robot(Path("robot.yaml")).robot.meshes == {}


def test_a_capsule_of_urdf_1_2_is_one(project: Path, change: Change) -> None:
    """Radius 50 mm, 200 mm between the centres of its caps, lying along y at x = 0.3: a quarter turn about x."""
    solid = (
        '<link name="la"><collision><origin xyz="0.3 0 0" rpy="1.5707963267948966 0 0"/>'
        '<geometry><capsule radius="0.05" length="0.2"/></geometry></collision></link>'
    )
    change("tiny.urdf", LINK, solid)
    robot = load_robot(Path("robot.yaml")).robot
    model = pin.buildModelFromXML(robot.urdf)
    (found,) = link_solids(model, robot)
    assert type(found.geometry).__name__ == "Capsule"
    assert found.geometry.radius == pytest.approx(0.05, abs=2e-6)
    assert found.geometry.halfLength == pytest.approx(0.1)
    frame = model.frames[model.getFrameId("la", pin.FrameType.BODY)].placement
    pose = frame.inverse() * found.pose
    assert pose.translation == pytest.approx([0.3, 0.0, 0.0])
    assert abs(pose.rotation[:, 2]) == pytest.approx([0.0, 1.0, 0.0])
