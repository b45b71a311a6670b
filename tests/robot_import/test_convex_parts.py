"""Convex parts of meshes: together they hold all of the surface, and little else."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from dualarm_cli.errors import MissingDependencyError, UsageError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.robot_import.convex_parts import divided
from dualarm_cli.robot_import.importing import ImportRequest, import_robot

OUTLINE = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.1
"""An L, counter-clockwise: 0.05 m² [m]."""
FLAT = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
"""Triangles that fill it."""


def bracket() -> tuple[FloatArray, np.ndarray]:
    """Returns an L of 0.1 m thickness as corners and triangles that face outwards."""
    low = np.column_stack([OUTLINE, np.zeros(6)])
    corners = np.concatenate([low, low + np.array([0.0, 0.0, 0.1])])
    faces = [(a, c, b) for a, b, c in FLAT] + [(a + 6, b + 6, c + 6) for a, b, c in FLAT]
    for k in range(6):
        m = (k + 1) % 6
        faces += [(k, m, m + 6), (k, m + 6, k + 6)]
    return corners, np.array(faces)


def inside(parts: list[ConvexHull], points: FloatArray) -> np.ndarray:
    """Returns which points are in one of the parts, by 1 µm."""
    heights = [points @ p.equations[:, :3].T + p.equations[:, 3] for p in parts]
    return np.any([(h <= 1e-6).all(axis=1) for h in heights], axis=0)


def test_parts_hold_the_surface_and_leave_the_notch_free() -> None:
    """Random points of all faces are in a part; the middle of the notch, in the hull of all, is in none."""
    corners, faces = bracket()
    parts = [ConvexHull(hull.corners) for hull in divided(corners, faces)]
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), (50, len(faces)))
    surface = np.einsum("nfk,fkx->nfx", weights, corners[faces]).reshape(-1, 3)
    assert inside(parts, surface).all()
    assert not inside(parts, np.array([[0.2, 0.2, 0.05]])).any()
    assert inside([ConvexHull(corners)], np.array([[0.19, 0.19, 0.05]])).all()
    # The parts are two boxes or so; the hull of all has 0.05 + 0.02 m² of base.
    assert 0.005 <= sum(part.volume for part in parts) < 0.006


def _with_bracket(folder: Path) -> tuple[Path, str]:
    """Writes the URDF of an arm with the bracket on a link, and returns it with the link's name."""
    corners, faces = bracket()
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "bracket.obj").write_text("\n".join(lines))
    robot = load_robot("iiwa7").robot
    link = robot.arms[0].flange
    mesh = '<mesh filename="bracket.obj" scale="2 2 2"/>'
    solid = f'<link name="{link}"><collision><geometry>{mesh}</geometry></collision>'
    text = robot.urdf.replace(f'<link name="{link}"/>', f'<link name="{link}"></link>')
    path = folder / "arm.urdf"
    path.write_text(text.replace(f'<link name="{link}">', solid, 1))
    return path, link


def test_an_import_divides_the_meshes_of_named_links(tmp_path: Path) -> None:
    """In the mesh's scale: eight times the volume."""
    path, link = _with_bracket(tmp_path)
    whole = import_robot(ImportRequest(path)).loaded.robot.meshes[link]
    parts = import_robot(ImportRequest(path, divided=(link,))).loaded.robot.meshes[link]
    volumes = [sum(ConvexHull(s.hull.corners).volume for s in of) for of in (whole, parts)]
    # The hull's base is the L and the triangle of its notch, 0.2 m by 0.2 m.
    assert volumes[0] == pytest.approx(8 * 0.1 * 0.07, rel=1e-4)
    assert volumes[1] == pytest.approx(8 * 0.1 * 0.05, rel=0.1)


def test_links_that_cannot_be_divided_are_named(tmp_path: Path) -> None:
    path, _ = _with_bracket(tmp_path)
    with pytest.raises(UsageError, match="--convex-parts: the URDF has no link 'no_link'"):
        import_robot(ImportRequest(path, divided=("no_link",)))
    root = load_robot("iiwa7").robot.urdf.split('<link name="')[1].split('"')[0]
    with pytest.raises(UsageError, match=f"--convex-parts: link '{root}' has no collision mesh"):
        import_robot(ImportRequest(path, divided=(root,)))


@pytest.mark.parametrize("library", ["coacd", "trimesh"])
def test_a_missing_library_names_the_extra(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    path, link = _with_bracket(tmp_path)
    with pytest.raises(MissingDependencyError, match=rf"{library} .*dualarm\[coacd\]"):
        import_robot(ImportRequest(path, divided=(link,)))
