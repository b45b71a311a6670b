"""Damaged meshes by the thousand, read as a cell reads them and given to coal; run by test_meshes.py.

    python mesh_fuzzer.py SEED COUNT FOLDER

Prints one JSON object: how many were read and refused, the longest processor time [s], the most
memory [MB], and what went wrong.
"""

from __future__ import annotations

import json
import random
import resource
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

CORNERS = [(x, y, z) for x in (0.0, 0.4) for y in (0.0, 0.3) for z in (0.0, 0.2)]
"""Those of a box."""
FACES = [
    (0, 1, 3),
    (0, 3, 2),
    (4, 6, 7),
    (4, 7, 5),
    (0, 4, 5),
    (0, 5, 1),
    (2, 3, 7),
    (2, 7, 6),
    (0, 2, 6),
    (0, 6, 4),
    (1, 5, 7),
    (1, 7, 3),
]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
WORDS = [
    *("nan", "inf", "-inf", "1e20", "1e39", "1e308", "1e400", "-1", "-2147483649", "0", "99"),
    *(
        "4294967295",
        "2147483648",
        "9223372036854775808",
        "1_0",
        "#g",
        "",
        "1e-320",
        "1000.1",
        "0x10",
    ),
    *("٣", "1,5", "--1", "+1", "1e15", "18446744073709551616", "q" * 5000, "\0", "<", "&a;", "\\"),
]


def stl_text() -> bytes:
    """Returns a box as a text STL file."""
    rows = ["solid box"]
    for face in FACES:
        rows += ["facet normal 0 0 0", "outer loop"]
        rows += ["vertex {:g} {:g} {:g}".format(*CORNERS[k]) for k in face]
        rows += ["endloop", "endfacet"]
    return "\n".join([*rows, "endsolid box", ""]).encode()


def stl_binary() -> bytes:
    """Returns a box as a binary STL file."""
    rows = [
        struct.pack("<12fH", 0, 0, 0, *(v for k in face for v in CORNERS[k]), 0) for face in FACES
    ]
    return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def obj() -> bytes:
    """Returns a box as an OBJ file: triangles, quadrilaterals, numbers from the end, a continued line."""
    rows = ["# box", "mtllib none.mtl", "o box", *("v {:g} {:g} {:g}".format(*c) for c in CORNERS)]
    rows += ["vt 0 0", "vn 0 0 1", *(f"f {a + 1}/1/1 {b + 1}//1 {c + 1}" for a, b, c in FACES)]
    rows += [*("f " + " ".join(str(k - 8) for k in quad) for quad in QUADS), "f 1 2 \\", "3"]
    return "\n".join([*rows, ""]).encode()


def ply(form: str) -> bytes:
    """Returns a box as a PLY file, its faces of 3 and of 4 corners, with an element in between.

    Args:
        form: ascii, binary_little_endian or binary_big_endian.
    """
    faces = [*FACES, *QUADS]
    head = [
        *("ply", f"format {form} 1.0", "comment a box", f"element vertex {len(CORNERS)}"),
        *("property float x", "property float y", "property double z", "property uchar red"),
        *("element camera 1", "property uchar id", "property list uint8 short far"),
        *(f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""),
    ]
    if form == "ascii":
        rows = [*("{:g} {:g} {:g} 9".format(*c) for c in CORNERS), "7 2 1 1"]
        rows += [f"{len(f)} " + " ".join(map(str, f)) for f in faces]
        return "\n".join([*head[:-1], *rows, ""]).encode()
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(f"{order}ffdB", *c, 9) for c in CORNERS)
    body += struct.pack(f"{order}BBhh", 7, 2, 1, 1)
    body += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    return "\n".join(head).encode() + body


def dae() -> bytes:
    """Returns a box as a COLLADA file: two primitives, nodes within nodes, one of a library."""
    numbers = " ".join(f"{v:g}" for corner in CORNERS for v in corner)
    quads = " ".join(f"{k} 0" for quad in QUADS for k in quad)
    triangles = " ".join(str(k) for face in FACES for k in face)
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="24">{numbers}</float_array>
<technique_common><accessor source="#a" count="8" stride="3"/></technique_common></source>
<source id="n"><float_array id="b" count="3">0 0 1</float_array>
<technique_common><accessor source="#b" count="1" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{triangles}</p></triangles>
<polylist count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/><vcount>4 4 4 4</vcount><p>{quads}</p></polylist>
</mesh></geometry></library_geometries>
<library_nodes><node id="l"><scale>1 1 1</scale><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="w"><node id="m"><translate>0.1 0 0</translate>
<rotate>0 0 1 0</rotate><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_node url="#l"/>
<node id="c"><instance_camera url="#k"/></node></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>
""".encode()


SOUND: dict[str, tuple[str, Callable[[], bytes]]] = {
    "stl text": (".stl", stl_text),
    "stl binary": (".stl", stl_binary),
    "obj": (".obj", obj),
    "ply text": (".ply", lambda: ply("ascii")),
    "ply little": (".ply", lambda: ply("binary_little_endian")),
    "ply big": (".ply", lambda: ply("binary_big_endian")),
    "dae": (".dae", dae),
}
"""Files of the same box, by their formats."""


def damaged(data: bytes, dice: random.Random) -> bytes:
    """Returns a file with one to four places changed."""
    for _ in range(dice.randint(1, 4)):
        at = dice.randrange(len(data) + 1)
        end = min(len(data), at + dice.choice((1, 2, 4, 8, 40, 400)))
        part = data[at:end]
        match dice.randrange(9):
            case 0:
                data = data[:at] + bytes(dice.randrange(256) for _ in part) + data[end:]
            case 1:
                data = data[:at] + data[end:]
            case 2:
                data = data[:at] + part * dice.choice((2, 3, 50, 2000)) + data[end:]
            case 3:
                data = data[: at or 1]
            case 4:
                value = dice.choice((1e15, -1e20, 3.4e38, np.inf, np.nan, 1e-40, 1000.5))
                data = data[:at] + struct.pack("<f", value) + data[at + 4 :]
            case 5:
                value = dice.choice((0, -1, 1, 2**31 - 1, -(2**31), 255, 65535))
                data = data[:at] + struct.pack("<i", value) + data[at + 4 :]
            case _:
                data = _other_word(data, dice)
        data = data or b"s"
    return data


def _other_word(data: bytes, dice: random.Random) -> bytes:
    """Returns a file with one of its words replaced, by one that is no number mostly, or by another of its own."""
    words = data.split(b" ")
    ends = [k for k, word in enumerate(words) if len(word) < 40]
    if not ends:
        return data
    other = dice.choice([dice.choice(WORDS).encode(), words[dice.choice(ends)]])
    words[dice.choice(ends)] = other
    return b" ".join(words)


def main(seed: int, count: int, folder: Path) -> dict[str, object]:
    """Reads damaged files and returns what came of it."""
    import coal
    import pinocchio as pin

    from dualarm_cli.collision.solids import WORLD, shape_solid
    from dualarm_cli.files.robots.meshes import MESH, read_hull
    from dualarm_cli.files.source.projects import BadReferenceError
    from dualarm_cli.model.shape import Shape

    dice = random.Random(seed)
    ball, here = coal.Sphere(0.1), coal.Transform3s()
    there = coal.Transform3s(np.eye(3), np.array([5.0, 0.0, 0.0]))
    found: dict[str, object] = {"read": 0, "refused": 0, "wrong": []}
    read = refused = 0
    wrong: list[str] = []
    longest = 0.0
    for number in range(count):
        kind = dice.choice(sorted(SOUND))
        suffix, make = SOUND[kind]
        # Now and then a file of one kind is called by another's name.
        if dice.random() < 0.03:
            suffix = dice.choice((".stl", ".obj", ".ply", ".dae"))
        file = folder / f"mesh{suffix}"
        file.write_bytes(damaged(make(), dice))
        start = time.process_time()
        try:
            hull = read_hull(file, file.name, np.ones(3))
            solid = shape_solid(
                "x", WORLD, pin.SE3.Identity(), Shape("mesh", (), pin.SE3.Identity(), hull)
            )
            distance = coal.distance(
                solid.geometry, here, ball, there, coal.DistanceRequest(), coal.DistanceResult()
            )
            read += 1
            if not (np.isfinite(distance) and np.abs(hull.corners).max() <= MESH.coordinate):
                wrong.append(f"{seed} {number} {kind}: {distance}")
        except BadReferenceError as error:
            refused += 1
            if len(str(error)) > 300 or not str(error).isprintable():
                wrong.append(f"{seed} {number} {kind}: {str(error)[:400]}")
        except Exception as error:
            (folder / f"wrong-{seed}-{number}{suffix}").write_bytes(file.read_bytes())
            wrong.append(f"{seed} {number} {kind}: {type(error).__name__}: {error}")
        longest = max(longest, time.process_time() - start)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    found |= {
        "read": read,
        "refused": refused,
        "seconds": longest,
        "megabytes": memory,
        "wrong": wrong,
    }
    return found


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))))
