"""Visual meshes of a URDF, and simplified copies to draw.

They are decoration. A mesh that is missing or damaged is left out, never an error, and nothing is checked with it.
Simplification merges the corners in each cell of a grid.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from dualarm_cli.files.robots.mesh_formats import MeshError, stl_bytes, stl_corners
from dualarm_cli.files.robots.meshes import element_pose, mesh_scale
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements
from dualarm_cli.files.source.projects import BadReferenceError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.shape import Hull, VisualMesh
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class DrawingLimits:
    """Limits of drawn meshes, for small and quickly made pages."""

    bytes: int = 30_000_000
    """Largest mesh file that is read [bytes]."""
    triangles: int = 40_000
    """Maximum number of triangles of a robot: some 1 MB of a page."""
    finest: int = 160
    """Cells along the diagonal of a mesh in the first attempt to simplify it."""
    coarser: float = 0.8
    """Ratio of the numbers of cells of two successive attempts."""
    seconds: float = 60.0
    """Longest time to convert the meshes of a robot to STL [s]."""
    fewest: int = 8
    """Cells along the diagonal below which a mesh is left out."""


DRAWING = DrawingLimits()


def visual_meshes(urdf: Urdf, finder: PackageFinder) -> tuple[VisualMesh, ...]:
    """Find the visual meshes of a URDF; missing files are left out.

    Args:
        urdf: a checked URDF.
        finder: finds its mesh files.
    """
    meshes = []
    for name, link in urdf.links.items():
        for solid in link.all("visual"):
            for mesh in mesh_elements(solid):
                try:
                    path = finder.mesh(mesh.get("filename"))
                except BadReferenceError:
                    continue
                scale = tuple(mesh_scale(mesh).tolist())
                meshes.append(VisualMesh(name, path, scale, element_pose(solid)))
    return tuple(meshes)


def drawn_meshes(meshes: Sequence[VisualMesh]) -> dict[tuple[Path, tuple[float, ...]], Hull]:
    """Read and simplify the STL files of visual meshes, each once.

    Other formats are left out.

    Returns:
        Surfaces by file and scale; together they have at most `DRAWING.triangles` triangles if each is drawn as often
        as it is used.
    """
    surfaces = {}
    share = DRAWING.triangles // max(len(meshes), 1)
    for mesh in meshes:
        key = (mesh.file, mesh.scale)
        if key not in surfaces and (surface := _surface(mesh, share)) is not None:
            surfaces[key] = surface
    return surfaces


def _surface(mesh: VisualMesh, most: int) -> Hull | None:
    """Read an STL file with at most `most` triangles, or None if unreadable."""
    try:
        if mesh.file.suffix.lower() != ".stl" or mesh.file.stat().st_size > DRAWING.bytes:
            return None
        corners = stl_corners(mesh.file.read_bytes()) * np.array(mesh.scale)
    except (OSError, MeshError):
        return None
    if len(corners) == 0 or not np.isfinite(corners).all():
        return None
    return _simplified(corners, np.arange(len(corners)).reshape(-1, 3), most)


def stl_copies(files: Iterable[Path], folder: Path) -> dict[Path, Path]:
    """Copy meshes of other formats to STL files in a folder.

    Unreadable meshes are left out.

    Assimp reads them in a process of its own: some damaged files crash it or never end.

    Returns:
        Copies by file.
    """
    others = [file for file in dict.fromkeys(files) if file.suffix.lower() != ".stl"]
    copies = {file: folder / f"{k}.stl" for k, file in enumerate(others)}
    if copies:
        names = [str(path) for pair in copies.items() for path in pair]
        code = f"from {__name__} import convert; import sys; convert(sys.argv[1:])"
        with suppress(subprocess.TimeoutExpired):
            command = [sys.executable, "-c", code, *names]
            subprocess.run(command, capture_output=True, timeout=DRAWING.seconds, check=False)
    return {file: copy for file, copy in copies.items() if copy.is_file()}


def convert(names: Sequence[str]) -> None:
    """Convert mesh files to binary STL, given as source and copy in turn."""
    import coal

    for source, copy in zip(names[::2], names[1::2], strict=True):
        with suppress(ValueError, RuntimeError, OSError):
            if Path(source).stat().st_size > DRAWING.bytes:
                continue
            model = coal.MeshLoader().load(source, np.ones(3))
            corners = np.array(model.vertices(), dtype=np.float64).reshape(-1, 3)
            faces = [model.tri_indices(k) for k in range(model.num_tris)]
            triangles = np.array([(f[0], f[1], f[2]) for f in faces], dtype=np.int64)
            whole = Path(f"{copy}.part")
            whole.write_bytes(stl_bytes(Hull(corners, triangles.reshape(-1, 3))))
            whole.rename(copy)


def _simplified(corners: FloatArray, triangles: IntArray, most: int) -> Hull | None:
    """Merge corners on ever coarser grids until at most `most` triangles remain."""
    low = corners.min(axis=0)
    size = float(norm(corners.max(axis=0) - low))
    cells = float(DRAWING.finest)
    while cells >= DRAWING.fewest and size > 0.0:
        grid = np.floor((corners - low) * (cells / size)).astype(np.int64)
        keys = np.ravel_multi_index(tuple(grid.T), (int(cells) + 1,) * 3)
        merged = np.unique(keys, return_inverse=True)[1]
        counts = np.bincount(merged)
        means = np.stack([np.bincount(merged, weights=c) / counts for c in corners.T], axis=1)
        faces = merged[triangles]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        keys = np.ravel_multi_index(tuple(np.sort(faces, axis=1).T), (len(means),) * 3)
        places = np.sort(np.unique(keys, return_index=True)[1])
        if 0 < len(places) <= most:
            return Hull(means, faces[places])
        cells *= DRAWING.coarser
    return None
