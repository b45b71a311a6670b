"""Visual meshes: found, simplified within limits, left out where they cannot be read, and kept by an import."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.files.robots.mesh_formats import stl_bytes
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.robots.visual_meshes import DRAWING, drawn_meshes, stl_copies
from dualarm_cli.files.source.bundled import robots_folder
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.shape import Hull, VisualMesh


def ball(rings: int, radius: float = 0.1) -> Hull:
    """A ball of quadrilaterals between parallels and meridians, as pairs of triangles."""
    polar = np.linspace(0.0, np.pi, rings + 1)[:, None]
    round_ = np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1)[None, :]
    ones = np.ones_like(round_)
    corners = np.stack(
        [np.sin(polar) * np.cos(round_), np.sin(polar) * np.sin(round_), np.cos(polar) * ones],
        axis=-1,
    )
    index = np.arange(corners.shape[0] * corners.shape[1]).reshape(corners.shape[:2])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return Hull(radius * corners.reshape(-1, 3), faces.reshape(-1, 3))


def volume(surface: Hull) -> float:
    """Sum of the signed tetrahedra from the origin."""
    a, b, c = (surface.corners[surface.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def mesh_of(file: Path, scale: float = 1.0) -> VisualMesh:
    return VisualMesh("link", file, (scale, scale, scale), pin.SE3.Identity())


def test_a_fine_ball_keeps_its_form_with_few_triangles(tmp_path: Path) -> None:
    """57,600 triangles become 40,000 at most; the ball's volume is 4/3 π r³."""
    file = tmp_path / "ball.stl"
    file.write_bytes(stl_bytes(ball(120)))
    (surface,) = drawn_meshes([mesh_of(file)]).values()
    assert 5_000 < len(surface.triangles) <= DRAWING.triangles
    assert volume(surface) == pytest.approx(4.0 / 3.0 * np.pi * 0.1**3, rel=0.02)
    lengths: FloatArray = np.linalg.norm(surface.corners, axis=1)
    assert 0.096 < lengths.min() <= lengths.max() <= 0.1 + 1e-6


def test_all_meshes_of_a_robot_share_the_triangles(tmp_path: Path) -> None:
    """Twenty times the same file is read once, and drawn with a twentieth of the triangles each time."""
    file = tmp_path / "ball.stl"
    file.write_bytes(stl_bytes(ball(100)))
    surfaces = drawn_meshes([mesh_of(file)] * 20)
    assert len(surfaces) == 1
    (surface,) = surfaces.values()
    assert 200 < len(surface.triangles) <= DRAWING.triangles // 20


def test_scales_are_applied(tmp_path: Path) -> None:
    file = tmp_path / "ball.stl"
    file.write_bytes(stl_bytes(ball(20, radius=100.0)))
    (surface,) = drawn_meshes([mesh_of(file, 1e-3)]).values()
    assert np.abs(surface.corners).max() == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("content", [b"", b"solid nothing\nendsolid nothing\n", b"\0" * 90, None])
def test_what_cannot_be_read_is_left_out(content: bytes | None, tmp_path: Path) -> None:
    file = tmp_path / "broken.stl"
    if content is not None:
        file.write_bytes(content)
    assert drawn_meshes([mesh_of(file)]) == {}


def test_a_larger_file_than_the_limit_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "ball.stl"
    file.write_bytes(stl_bytes(ball(12)))
    for bytes_, number in ((file.stat().st_size, 1), (file.stat().st_size - 1, 0)):
        limits = replace(DRAWING, bytes=bytes_)
        monkeypatch.setattr("dualarm_cli.files.robots.visual_meshes.DRAWING", limits)
        assert len(drawn_meshes([mesh_of(file)])) == number


def test_other_formats_are_copied_and_unreadable_files_left_out(tmp_path: Path) -> None:
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "good.obj").write_text(tetrahedron)
    (tmp_path / "bad.dae").write_bytes(b"\0" * 50)
    files = [tmp_path / name for name in ("good.obj", "bad.dae", "gone.ply")]
    copies = stl_copies(files, tmp_path)
    assert list(copies) == files[:1]
    (surface,) = drawn_meshes([mesh_of(copies[files[0]])]).values()
    assert volume(surface) == pytest.approx(1.0 / 6.0)


@pytest.fixture
def dressed(tmp_path: Path) -> Path:
    """The bundled iiwa7 with a ball on its flange, and a mesh that is missing; returns its URDF."""
    folder = tmp_path / "dressed"
    shutil.copytree(robots_folder() / "iiwa7", folder)
    urdf = folder / "iiwa7.urdf"
    at = '<origin xyz="0 0 0.05" rpy="0 0 0"/>'
    looks = "".join(
        f"<visual>{origin}<geometry><mesh {mesh}/></geometry></visual>"
        for origin, mesh in (
            (at, 'filename="ball.stl" scale="2 2 2"'),
            ("", 'filename="gone.dae"'),
        )
    )
    link = '<link name="link_7">'
    urdf.write_text(urdf.read_text().replace(link, link + looks))
    (folder / "ball.stl").write_bytes(stl_bytes(ball(12)))
    return urdf


def test_a_robot_has_its_meshes_without_the_missing_one(dressed: Path) -> None:
    (mesh,) = load_robot(dressed.parent / "robot.yaml").robot.visuals
    assert (mesh.link, mesh.file.name, mesh.scale) == ("link_7", "ball.stl", (2.0, 2.0, 2.0))
    assert mesh.pose.translation.tolist() == [0.0, 0.0, 0.05]


def test_an_import_keeps_simplified_meshes(
    dressed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The written project has its own file, in metres, at the same pose."""
    monkeypatch.chdir(tmp_path)
    assert run(["robot", "import", str(dressed), "--left-tip", "flange", "--out", "own"]) == 0
    assert "1 visual mesh: simplified for the page" in capsys.readouterr().err
    (mesh,) = load_robot(Path("own/robot.yaml")).robot.visuals
    assert (mesh.link, mesh.scale) == ("link_7", (1.0, 1.0, 1.0))
    assert mesh.file.resolve().is_relative_to(tmp_path / "own")
    (surface,) = drawn_meshes([mesh]).values()
    assert np.abs(surface.corners).max() == pytest.approx(0.2, rel=0.02)
    assert mesh.pose.translation == pytest.approx([0.0, 0.0, 0.05])
