"""Readers of corners from STL, OBJ and PLY files; a writer of STL.

A file that cannot be read completely is refused: a lost corner would make a hull smaller than the body.
"""

from __future__ import annotations

import io
import math
import re
import struct
from array import array
from collections.abc import Iterator

import numpy as np

from dualarm_cli.files.source.text_source import quote
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.shape import Hull

STL_HEADER, _STL_TRIANGLE = 84, 50
_STL_ROWS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_SOLID = re.compile(rb"^[ \t]*(end[ \t]*)?solid\b[^\r\n]*", re.IGNORECASE | re.MULTILINE)
_STL_CORNER = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_STL_WORD = re.compile(rb"\b(?:vertex|facet|endfacet)\b", re.IGNORECASE)
_WHOLE = re.compile(rb"-?[0-9]{1,11}")
_PLY_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_FACES = ("face", "tristrips")
_PLY_MOST_HEADER = 100_000


class MeshError(ValueError):
    """A mesh file that cannot be used.

    Its text says why and is put after the file's name.
    """


def mesh_number(word: bytes, where: str) -> float:
    """Parse a number of a text format.

    Args:
        word: as it is written.
        where: what is put before the message.

    Raises:
        MeshError: it is no number.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or b"_" in word:
        shown = quote(word.decode("latin-1"))
        raise MeshError(f"{where} holds {shown}, which is not a finite number")
    return value


def stl_corners(data: bytes) -> FloatArray:
    """Read the corners of an STL file, text or binary, shape (n, 3).

    Args:
        data: the whole file.

    Raises:
        MeshError: it is damaged.
    """
    count = struct.unpack_from("<I", data, STL_HEADER - 4)[0] if len(data) >= STL_HEADER else 0
    whole = STL_HEADER + _STL_TRIANGLE * count
    if data.lstrip()[:5].lower() == b"solid" and len(data) != whole:
        return _stl_text_corners(data)
    if count == 0 or len(data) < whole:
        raise MeshError(f"is not a whole STL file: {count} triangles in {len(data)} bytes")
    triangles = np.frombuffer(data, _STL_ROWS, count=count, offset=STL_HEADER)
    with np.errstate(invalid="ignore"):  # what is not finite is refused with the coordinates
        return triangles["corners"].reshape(-1, 3).astype(np.float64)


def _stl_text_corners(data: bytes) -> FloatArray:
    ends = [match[1] is not None for match in _STL_SOLID.finditer(data)]
    if sum(ends) * 2 != len(ends):
        raise MeshError(
            f"is not a whole STL file: {len(ends) - sum(ends)} times solid, {sum(ends)} times endsolid"
        )
    # Names of solids may be anything.
    data = _STL_SOLID.sub(b"", data)
    words = {b"vertex": 0, b"facet": 0, b"endfacet": 0}
    for match in _STL_WORD.finditer(data):
        words[match[0].lower()] += 1
    values = array("d")
    for match in _STL_CORNER.finditer(data):
        try:
            values.extend(mesh_number(word, "a vertex") for word in match.groups())
        except MeshError as error:
            line = data.count(b"\n", 0, match.start()) + 1
            raise MeshError(f"line {line}: {error}") from None
    corners = np.array(values).reshape(-1, 3)
    facets = words[b"facet"]
    if not 3 * facets == words[b"vertex"] == len(corners) or facets != words[b"endfacet"]:
        raise MeshError(
            f"is not a whole STL file: {facets} times facet, {words[b'endfacet']} times endfacet, "
            f"{len(corners)} corners"
        )
    if not facets:
        raise MeshError("has no face")
    return corners


def obj_corners(data: bytes) -> FloatArray:
    """Read the corners of an OBJ file, shape (n, 3), used or not.

    Args:
        data: the whole file.

    Raises:
        MeshError: it is damaged.
    """
    values, numbers = array("d"), array("q")
    for line, words in _obj_lines(data):
        if words[0] == b"v":
            if not 4 <= len(words) <= 8:
                raise MeshError(f"line {line}: v needs x, y and z, not {len(words) - 1} numbers")
            values.extend(mesh_number(word, f"line {line}: v") for word in words[1:4])
        elif words[0] == b"f":
            if len(words) < 4:
                raise MeshError(
                    f"line {line}: a face needs 3 corners or more, not {len(words) - 1}"
                )
            numbers.extend(_obj_number(word, len(values) // 3, line) for word in words[1:])
    corners = np.array(values).reshape(-1, 3)
    if not numbers:
        raise MeshError("has no face")
    if (last := max(numbers)) >= len(corners):
        raise MeshError(
            f"has a face with corner number {last}, of {len(corners)} corners counted from 0"
        )
    return corners


def _obj_lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Yield line numbers and words of lines with content, joined at trailing backslashes."""
    words: list[bytes] = []
    for number, text in enumerate(io.BytesIO(data), 1):
        line = text.rstrip()
        continued = line.endswith(b"\\")
        words += line.removesuffix(b"\\").split()
        if words and not continued:
            yield number, words
        if not continued:
            words = []


def _obj_number(word: bytes, so_far: int, line: int) -> int:
    """Convert a face's corner reference to an index from 0.

    References count from 1, or backwards from the last corner.
    """
    text = word.split(b"/", 1)[0]
    if not _WHOLE.fullmatch(text) or int(text) == 0:
        raise MeshError(
            f"line {line}: f holds {quote(word.decode('latin-1'))}, which names no corner"
        )
    number = int(text)
    if number > 0:
        return number - 1
    if so_far + number < 0:
        raise MeshError(f"line {line}: f names corner {number} of {so_far} corners so far")
    return so_far + number


def ply_corners(data: bytes) -> FloatArray:
    """Read the corners of a PLY file, text or binary, shape (n, 3).

    Corners without a face are included.

    Elements after the corners, such as faces, are counted and not read: a hull needs none.

    Args:
        data: the whole file.

    Raises:
        MeshError: it is damaged, or begins with other elements than its corners.
    """
    end = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE).search(data, 0, _PLY_MOST_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise MeshError("is not a PLY file: it does not begin with 'ply', or has no 'end_header'")
    order, elements = _ply_header(data[: end.start()])
    if not any(elements.get(name, (0,))[0] for name in _PLY_FACES):
        raise MeshError("has no face")
    name, (count, properties) = next(iter(elements.items()))
    if name != "vertex":
        raise MeshError(f"has {quote(name)} before 'vertex'; export it with its vertices first")
    if not {"x", "y", "z"} <= properties.keys() or "" in properties.values():
        raise MeshError("has vertices without x, y and z, or with lists")
    row = np.dtype([(name, order + kind) for name, kind in properties.items()])
    start, total = end.end(), sum(rows for rows, _ in elements.values())
    if not order:
        return _text_values(data, start, (count, total), list(properties))
    # A row of any other element has a byte at least.
    if row.itemsize * count + total - count > len(data) - start:
        raise MeshError(f"is not a whole PLY file: {count} times 'vertex' in {len(data)} bytes")
    rows = np.frombuffer(data, row, count=count, offset=start)
    with np.errstate(invalid="ignore"):
        return np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])


def _ply_header(header: bytes) -> tuple[str, dict[str, tuple[int, dict[str, str]]]]:
    """Read the byte order and the elements of a PLY header.

    The byte order is empty for text. Each element has its count and the types of its properties,
    empty for lists.
    """
    order = None
    elements: dict[str, tuple[int, dict[str, str]]] = {}
    properties: dict[str, str] = {}
    for line, text in enumerate(header.decode("latin-1").split("\n")[1:], 2):
        match text.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in _PLY_ORDERS:
                order = _PLY_ORDERS[name]
            case ["element", name, count] if (
                count.isascii() and count.isdigit() and len(count) < 12 and name not in elements
            ):
                properties = {}
                elements[name] = int(count), properties
            case ["property", kind, name] if (
                kind in _PLY_TYPES and elements and name not in properties
            ):
                properties[name] = _PLY_TYPES[kind]
            case ["property", "list", _, _, name] if elements:
                properties[name] = ""
            case _:
                raise MeshError(
                    f"line {line}: {quote(text.strip())} is not supported in a PLY header"
                )
    if order is None:
        raise MeshError("is not a PLY file: its header has no 'format'")
    return order, elements


def _text_values(data: bytes, start: int, counts: tuple[int, int], names: list[str]) -> FloatArray:
    """Read x, y and z of the first rows of a text file.

    `counts` has the numbers of these and of all rows, without empty lines.
    """
    places, values, rows = [names.index(axis) for axis in "xyz"], array("d"), 0
    first = data.count(b"\n", 0, start) + 1
    for line, text in enumerate(io.BytesIO(data[start:]), first):
        words = text.split()
        rows += bool(words)
        if not words or rows > counts[0]:
            continue
        if len(words) != len(names):
            raise MeshError(f"line {line}: 'vertex' needs {len(names)} numbers, not {len(words)}")
        values.extend(mesh_number(words[k], f"line {line}: 'vertex'") for k in places)
    if rows != counts[1]:
        raise MeshError(f"is not a whole PLY file: {rows} rows, and its header says {counts[1]}")
    return np.array(values).reshape(-1, 3)


def stl_bytes(hull: Hull) -> bytes:
    """Write a hull as a binary STL file."""
    faces = hull.corners[hull.triangles]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.maximum(norm(normals, axis=1, keepdims=True), 1e-300)
    rows = np.zeros(len(faces), dtype=[("vectors", "<f4", (12,)), ("more", "<u2")])
    rows["vectors"] = np.concatenate([normals, faces.reshape(-1, 9)], axis=1)
    return bytes(80) + struct.pack("<I", len(faces)) + rows.tobytes()
