# ruff: noqa: E501 (tables of exact messages, one a line)
"""Meshes: the same box in every format, what is refused and why, and thousands of damaged files."""

from __future__ import annotations

import importlib.util
import json
import os
import resource
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import link_solids
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.meshes import read_hull
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.projects import BadReferenceError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.shape import Hull

FUZZER = Path(__file__).parent / "mesh_fuzzer.py"
ROOT = FUZZER.parents[2]
FORMATS = ("stl text", "stl binary", "obj", "ply text", "ply little", "ply big", "dae")


@pytest.fixture(scope="module")
def boxes() -> ModuleType:
    """The fuzzer's sound files."""
    spec = importlib.util.spec_from_file_location("mesh_fuzzer", FUZZER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def hull_of(tmp_path: Path) -> Callable[..., Hull]:
    """Reads the hull of a file's bytes."""

    def read(data: bytes, suffix: str, scale: FloatArray | None = None) -> Hull:
        file = tmp_path / f"mesh{suffix}"
        file.write_bytes(data)
        return read_hull(file, file.name, np.ones(3) if scale is None else scale)

    return read


def _volume(hull: Hull) -> float:
    """Sum of the signed tetrahedra from the origin: negative where faces look inward."""
    a, b, c = (hull.corners[hull.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_box(
    name: str, boxes: ModuleType, hull_of: Callable[..., Hull]
) -> None:
    """0.4 × 0.3 × 0.2 m; the scene of the COLLADA file is moved by 0.1 m, a scale may mirror."""
    suffix, make = boxes.SOUND[name]
    shift = np.array([0.1 if name == "dae" else 0.0, 0.0, 0.0])
    for scale in (np.ones(3), np.array([-2.0, 0.5, 1.0])):
        hull = hull_of(make(), suffix, scale)
        wanted = (np.array(boxes.CORNERS) + shift) * scale
        found = hull.corners[np.lexsort(hull.corners.round(6).T)]
        assert found == pytest.approx(wanted[np.lexsort(wanted.round(6).T)], abs=1e-6)
        assert _volume(hull) == pytest.approx(0.4 * 0.3 * 0.2 * abs(np.prod(scale)), rel=1e-6)


def test_a_hull_contains_its_points_and_has_no_more_corners(hull_of: Callable[..., Hull]) -> None:
    """Every point is behind every face, and every corner is one of the points."""
    dice = np.random.default_rng(5)
    for _ in range(20):
        points = dice.normal(size=(int(dice.integers(5, 200)), 3)).round(2)
        rows = ["v {:.2f} {:.2f} {:.2f}".format(*point) for point in points]
        hull = hull_of("\n".join([*rows, "f 1 2 3"]).encode(), ".obj")
        a, b, c = (hull.corners[hull.triangles[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        heights = points @ normals.T - np.einsum("ij,ij->i", normals, a)
        assert heights.max() < 1e-12
        assert {*map(tuple, hull.corners)} <= {*map(tuple, points)}


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("stl text", b"vertex 0.4 0 0\n", b"vertex 1e20 0 0\n", "has a corner at 1e+20 m; at most 1 km from the origin is allowed; check its unit and the scale"),
        ("stl text", b"vertex 0.4 0 0\n", b"vertex 0.4 0 nan\n", "line 18: a vertex holds 'nan', which is not a finite number"),
        ("stl text", b"vertex 0.4 0 0\n", b"vertex 0.4 0 q\n", "line 18: a vertex holds 'q', which is not a finite number"),
        ("stl text", b"vertex 0.4 0 0\n", b"vertx 0.4 0 0\n", "is not a whole STL file: 12 times facet, 12 times endfacet, 35 corners"),
        ("stl text", b"endsolid box", b"", "is not a whole STL file: 1 times solid, 0 times endsolid"),
        ("stl binary", struct.pack("<f", 0.4), struct.pack("<f", 1e15), "has a corner at 1e+15 m; at most 1 km from the origin is allowed; check its unit and the scale"),
        ("stl binary", struct.pack("<f", 0.4), struct.pack("<f", np.nan), "has a corner that is not finite; export it again"),
        ("stl binary", struct.pack("<I", 12), struct.pack("<I", 13), "is not a whole STL file: 13 triangles in 684 bytes"),
        ("obj", b"v 0.4 0 0\n", b"v 1e20 0 0\n", "has a corner at 1e+20 m; at most 1 km from the origin is allowed; check its unit and the scale"),
        ("obj", b"f 1/1/1 2//1 4", b"f 9/1/1 2//1 4", "has a face with corner number 8, of 8 corners counted from 0"),
        ("obj", b"f 1/1/1 2//1 4", b"f 0 2 4", "line 14: f holds '0', which names no corner"),
        ("obj", b"f 1/1/1 2//1 4", b"f -9 2 4", "line 14: f names corner -9 of 8 corners so far"),
        ("obj", b"f 1/1/1 2//1 4", b"f 1 2", "line 14: a face needs 3 corners or more, not 2"),
        ("obj", b"v 0.4 0 0\n", b"v 0.4 0\n", "line 8: v needs x, y and z, not 2 numbers"),
        ("ply text", b"0.4 0 0 9", b"1e20 0 0 9", "has a corner at 1e+20 m; at most 1 km from the origin is allowed; check its unit and the scale"),
        ("ply text", b"element vertex 8", b"element vertex 4000000000", "line 36: 'vertex' needs 4 numbers, not 5"),
        ("ply text", b"element face 16", b"element face 17", "is not a whole PLY file: 25 rows, and its header says 26"),
        ("ply text", b"element face 16", b"element face 0", "has no face"),
        ("ply text", b"0.4 0 0 9", b"0.4 nan 0 9", "line 19: 'vertex' holds 'nan', which is not a finite number"),
        ("ply text", b"comment a box", b"element lens 0", "has 'lens' before 'vertex'; export it with its vertices first"),
        ("ply text", b"property uchar red", b"property uchar z", "line 8: 'property uchar z' is not supported in a PLY header"),
        ("ply little", b"element vertex 8", b"element vertex 4000000000", "is not a whole PLY file: 4000000000 times 'vertex' in 644 bytes"),
        ("ply big", struct.pack(">f", 0.4), struct.pack(">f", np.inf), "has a corner that is not finite; export it again"),
        ("ply text", b"property double z\n", b"", "has vertices without x, y and z, or with lists"),
        ("dae", b"0.4 0 0 ", b"1e20 0 0 ", "has a corner at 1e+20 m; at most 1 km from the origin is allowed; check its unit and the scale"),
        ("dae", b'count="8"', b'count="80000000"', "line 6: <accessor> needs 80000000 times 3 numbers from 0 on, but its array has 24"),
        ("dae", b'<instance_node url="#l"/>', b'<instance_node url="#m"/>', "line 15: more than 10000 nodes, or deeper than 100"),
        ("dae", b'<instance_node url="#l"/>', b'<instance_node url="file:///etc/passwd"/>', "line 16: <instance_node> names 'file:///etc/passwd', which is not in the file"),
        ("dae", b"<scale>1 1 1</scale>", b"<skew>1 1 1</skew>", "line 14: <skew> is not read; export the mesh as it stands, with its nodes' matrices"),
        ("dae", b"<COLLADA ", b'<!DOCTYPE a [<!ENTITY b "c">]><COLLADA ', "line 2: a DOCTYPE or entity is not allowed; remove it"),
    ],
)  # fmt: skip
def test_a_damaged_mesh_is_refused_and_named(
    name: str,
    old: bytes,
    new: bytes,
    message: str,
    boxes: ModuleType,
    hull_of: Callable[..., Hull],
) -> None:
    """Nothing is left out silently: a lost corner would make the hull smaller than the thing."""
    suffix, make = boxes.SOUND[name]
    data = make()
    assert old in data
    with pytest.raises(BadReferenceError) as caught:
        hull_of(data.replace(old, new, 1), suffix)
    assert str(caught.value) == f"'mesh{suffix}' {message}"


def test_a_mesh_without_volume_is_refused(hull_of: Callable[..., Hull]) -> None:
    """A plane, and all corners in one place."""
    for rows in ("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0", "v 1 1 1\nv 1 1 1\nv 1 1 1"):
        with pytest.raises(BadReferenceError, match="has no volume"):
            hull_of(f"{rows}\nf 1 2 3\n".encode(), ".obj")


def test_nodes_that_show_each_other_twice_end_soon(
    boxes: ModuleType, hull_of: Callable[..., Hull]
) -> None:
    """Forty nodes, each of which shows the next one twice, would be 2^40."""
    nodes = "".join(
        f'<node id="d{k}">' + f'<instance_node url="#d{k + 1}"/>' * 2 + "</node>" for k in range(40)
    )
    data = boxes.dae().replace(
        b"<library_nodes>", f"<library_nodes>{nodes}<node id='d40'/>".encode()
    )
    with pytest.raises(BadReferenceError, match="more than 10000 nodes"):
        hull_of(data.replace(b'url="#l"', b'url="#d0"'), ".dae")


def test_a_mesh_that_cannot_be_used_is_named_where_the_cell_names_it(
    project: Path, change: Callable[..., None], messages: Callable[..., list[str]]
) -> None:
    """File, line and column of the cell file; nothing is planned."""
    (project / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    change("cell.yaml", "box: [1, 2, 40 mm]", "mesh: flat.obj")
    assert messages(lambda: load_cell("cell.yaml")) == [
        "cell.yaml:9:17: E500 'flat.obj' has no volume: its corners lie in a plane or closer together than rounding"
    ]


def test_a_robots_meshes_are_hulls_in_their_links(
    project: Path,
    change: Callable[..., None],
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Read beside the URDF wherever the command runs, and no longer in the text that pinocchio gets; looks are not read."""
    (project / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    (project / "look.dae").write_text("anything")
    shape = '<geometry><mesh filename="a.obj" scale="0.1 0.1 -0.1"/></geometry>'
    change(
        "tiny.urdf",
        '<link name="la"/>',
        f'<link name="la"><collision><origin xyz="0 0 1"/>{shape}</collision>'
        '<visual><geometry><mesh filename="look.dae"/></geometry></visual></link>',
    )
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    loaded = load_robot(project / "robot.yaml")
    robot = loaded.robot
    assert "mesh" not in robot.urdf
    assert "collision meshes are taken as their convex hulls: la" in loaded.notes
    (solid,) = link_solids(pin.buildModelFromXML(robot.urdf), robot)
    assert solid.body == "la"
    assert isinstance(solid.geometry, coal.ConvexBase)
    corners = np.array([solid.pose.act(corner) for corner in solid.geometry.points()])
    assert corners.min(axis=0) == pytest.approx([0.0, 0.0, 0.9])
    assert corners.max(axis=0) == pytest.approx([0.1, 0.1, 1.0])


def _fuzz(seed: int, count: int, folder: Path) -> None:
    """Runs the fuzzer in a process that may have 1 GB more than Python and its libraries map."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    ended = subprocess.run(
        [sys.executable, str(FUZZER), str(seed), str(count), str(folder)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        preexec_fn=limit,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["wrong"] == []
    assert found["read"] > 0.03 * count
    assert found["refused"] > 0.5 * count
    assert found["seconds"] < 10.0
    assert found["megabytes"] < 1000.0


def test_damaged_meshes_are_read_or_refused(tmp_path: Path) -> None:
    """No signal, no traceback, no memory, no waiting."""
    _fuzz(20, 600, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_many_damaged_meshes_are_read_or_refused(seed: int, tmp_path: Path) -> None:
    """The same, a thousand at a time."""
    _fuzz(seed, 1000, tmp_path)
