"""STL, OBJ and PLY to the corners of their faces, all or none.

What cannot be read whole is refused: a lost corner would make a hull smaller than the thing.
"""

from __future__ import annotations

import io
import math
import re
import struct
from array import array
from collections.abc import Iterator
from dataclasses import field

import numpy as np

from dualarm_cli.files.source.text_source import quote
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass

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
_PLY_FACES = {"face": 0, "tristrips": -1}
"""Elements that list corners, and the least number that they may hold: -1 begins a new strip."""
_PLY_LISTS = ("vertex_indices", "vertex_index")
_PLY_MOST_HEADER = 100_000
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
"""The struct module's names of numpy's types."""
_FEWEST = 3
"""How many corners a face needs; also what stands for the least length where no list has corners."""


class MeshError(ValueError):
    """A mesh file that cannot be used; its text says why and is put after the file's name."""


def mesh_number(word: bytes, where: str) -> float:
    """Returns a number of a text format.

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


def check_numbers_of_corners(numbers: IntArray, count: int, least: int = 0) -> None:
    """Makes sure that faces name corners that there are.

    Args:
        numbers: as the faces name them, counted from 0.
        count: how many corners there are.
        least: the lowest number that is allowed.

    Raises:
        MeshError: no face, or a number of no corner.
    """
    if not len(numbers):
        raise MeshError("has no face")
    wrong = numbers[(numbers < least) | (numbers >= count)]
    if len(wrong):
        raise MeshError(
            f"has a face with corner number {wrong[0]}, of {count} corners counted from 0"
        )


def stl_corners(data: bytes) -> FloatArray:
    """Returns the corners of an STL file, text or binary, shape (n, 3).

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
    """Returns the corners of an OBJ file, shape (n, 3): all that are in it.

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
    check_numbers_of_corners(np.array(numbers, dtype=np.int64), len(corners))
    return corners


def _obj_lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Yields the number and the words of every line that has some; after a backslash the next line belongs to it."""
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
    """Returns the number from 0 of a corner that a face names: from 1, or from the last one backwards."""
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


@dataclass
class _Element:
    """An element of a PLY file: what the header says of it."""

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)
    """Name, type and the type of its length, empty for a single value; types as numpy's, without their order."""

    @property
    def has_lists(self) -> bool:
        return any(length for *_, length in self.properties)

    @property
    def list_place(self) -> int:
        """Which property lists corners, -1 for none."""
        if self.name not in _PLY_FACES:
            return -1
        names = [name if length else "" for name, _, length in self.properties]
        return next((names.index(name) for name in _PLY_LISTS if name in names), -1)


def ply_corners(data: bytes) -> FloatArray:
    """Returns the corners of a PLY file, text or binary, shape (n, 3): all that are in it.

    Args:
        data: the whole file.

    Raises:
        MeshError: it is damaged.
    """
    order, elements, start = _ply_header(data)
    corners, seen = None, False
    lines = enumerate(io.BytesIO(data[start:]), data.count(b"\n", 0, start) + 1)
    wanted = [e for e in elements if e.name == "vertex" or e.list_place >= 0]
    for element in elements[: elements.index(wanted[-1]) + 1] if wanted else []:
        if not element.properties:
            continue
        if not element.has_lists:
            if order:
                values, start = _binary_values(element, data, start, order)
            else:
                values = _text_values(element, lines)
            corners = values if element.name == "vertex" else corners
            continue
        if order:
            numbers, shortest, start = _binary_lists(element, data, start, order)
        else:
            numbers, shortest = _text_lists(element, lines)
        if element.list_place < 0 or not element.count:
            continue
        if shortest < _FEWEST:
            raise MeshError(f"has a {quote(element.name)} of {shortest} corners; 3 are needed")
        if corners is None:
            raise MeshError(f"has {quote(element.name)} before 'vertex'")
        check_numbers_of_corners(numbers, len(corners), _PLY_FACES[element.name])
        seen = True
    if corners is None or not seen:
        raise MeshError("has no face")
    return corners


def _ply_header(data: bytes) -> tuple[str, list[_Element], int]:
    """Returns the byte order, empty for text, the elements and where they begin."""
    end = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE).search(data, 0, _PLY_MOST_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise MeshError("is not a PLY file: it does not begin with 'ply', or has no 'end_header'")
    order = None
    elements: list[_Element] = []
    for line, text in enumerate(data[: end.start()].decode("latin-1").split("\n")[1:], 2):
        match text.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in _PLY_ORDERS:
                order = _PLY_ORDERS[name]
            case ["element", name, count] if (
                count.isascii() and count.isdigit() and len(count) < 12
            ):
                elements.append(_Element(name, int(count)))
            case ["property", kind, name] if kind in _PLY_TYPES and elements:
                elements[-1].properties.append((name, _PLY_TYPES[kind], ""))
            case ["property", "list", size, kind, name] if (
                _PLY_TYPES.get(size, "f")[0] in "iu" and kind in _PLY_TYPES and elements
            ):
                elements[-1].properties.append((name, _PLY_TYPES[kind], _PLY_TYPES[size]))
            case _:
                raise MeshError(f"line {line}: {quote(text.strip())} is not known in a PLY header")
    if order is None:
        raise MeshError("is not a PLY file: its header has no 'format'")
    if len({e.name for e in elements}) != len(elements):
        raise MeshError("has two elements of one name")
    for element in elements:
        _check_element(element, len(data))
    return order, elements, end.end()


def _check_element(element: _Element, size: int) -> None:
    names = [name for name, *_ in element.properties]
    if len(set(names)) != len(names):
        raise MeshError(f"has two properties of one name in {quote(element.name)}")
    # A row has a byte at least.
    if element.properties and element.count > size:
        raise MeshError(
            f"is not a whole PLY file: {element.count} times {quote(element.name)} in {size} bytes"
        )
    if element.name == "vertex" and (not {"x", "y", "z"} <= {*names} or element.has_lists):
        raise MeshError("has vertices without x, y and z, or with lists")
    place = element.list_place
    if place >= 0 and element.properties[place][1][0] not in "iu":
        raise MeshError("has faces whose corner numbers are not whole numbers")


def _cut_off(element: _Element) -> MeshError:
    return MeshError(
        f"is not a whole PLY file: it ends within its {element.count} {quote(element.name)}"
    )


def _binary_values(
    element: _Element, data: bytes, start: int, order: str
) -> tuple[FloatArray, int]:
    """Returns x, y and z of a binary element, nothing for one without them, and where the next one begins."""
    row = np.dtype([(name, order + kind) for name, kind, _ in element.properties])
    end = start + row.itemsize * element.count
    if end > len(data):
        raise _cut_off(element)
    if element.name != "vertex":
        return np.empty((0, 3)), end
    rows = np.frombuffer(data, row, count=element.count, offset=start)
    with np.errstate(invalid="ignore"):
        return np.column_stack([rows[name].astype(np.float64) for name in "xyz"]), end


def _binary_lists(
    element: _Element, data: bytes, start: int, order: str
) -> tuple[IntArray, int, int]:
    """Returns what the lists of corners hold, the least length of one, and where the next element begins."""
    numbers, shortest = array("q"), _FEWEST
    for row in range(element.count):
        found, end, lengths = _binary_row(element, data, start, order)
        if row == 0:
            # Mostly all lists are as long as the first: then they are read at once.
            table = _equal_rows(element, data[start:], end - start, lengths, order)
            if table is not None:
                least = len(found) if element.list_place >= 0 else _FEWEST
                return table, least, start + (end - start) * element.count
        numbers.extend(found)
        start = end
        if element.list_place >= 0:
            shortest = min(shortest, len(found))
    return np.array(numbers, dtype=np.int64), shortest, start


def _binary_row(
    element: _Element, data: bytes, start: int, order: str
) -> tuple[tuple[int, ...], int, list[int]]:
    """Returns the list of corners of one row, where the next row begins, and how many values each property has."""
    wanted, counts = element.list_place, []
    found: tuple[int, ...] = ()
    for place, (_, kind, length) in enumerate(element.properties):
        count = 1
        if length:
            code = _CODES[length]
            end = start + struct.calcsize(code)
            count = struct.unpack_from(order + code, data, start)[0] if end <= len(data) else -1
            start = end
        end = start + count * int(kind[1])
        if count < 0 or end > len(data):
            raise _cut_off(element)
        if place == wanted:
            found = struct.unpack_from(f"{order}{count}{_CODES[kind]}", data, start)
        start = end
        counts.append(count)
    return found, start, counts


def _equal_rows(
    element: _Element, data: bytes, size: int, counts: list[int], order: str
) -> IntArray | None:
    """Returns all lists of corners where every list of a property is as long as in the first row, else None."""
    if size * element.count > len(data):
        return None
    parts: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for k, (_, kind, length) in enumerate(element.properties):
        if length:
            parts.append((f"length {k}", order + length))
        parts.append((f"values {k}", order + kind, (counts[k],)))
    rows = np.frombuffer(data, np.dtype(parts), count=element.count)
    for k, (*_, length) in enumerate(element.properties):
        if length and (rows[f"length {k}"] != counts[k]).any():
            return None
    if element.list_place < 0:
        return np.empty(0, dtype=np.int64)
    return rows[f"values {element.list_place}"].astype(np.int64).ravel()


def _text_rows(
    element: _Element, lines: Iterator[tuple[int, bytes]]
) -> Iterator[tuple[int, list[bytes]]]:
    """Yields the number and the words of each row of an element; empty lines are none."""
    left = element.count
    while left:
        line, text = next(lines, (0, b""))
        if not line:
            raise _cut_off(element)
        words = text.split()
        if words:
            left -= 1
            yield line, words


def _text_values(element: _Element, lines: Iterator[tuple[int, bytes]]) -> FloatArray:
    """Returns x, y and z of a text element, nothing for one without them."""
    names = [name for name, *_ in element.properties]
    places = [names.index(axis) for axis in "xyz"] if element.name == "vertex" else []
    values = array("d")
    for line, words in _text_rows(element, lines):
        if len(words) != len(names):
            raise MeshError(
                f"line {line}: {quote(element.name)} needs {len(names)} numbers, not {len(words)}"
            )
        values.extend(mesh_number(words[k], f"line {line}: {quote(element.name)}") for k in places)
    return np.array(values).reshape(-1, 3)


def _text_lists(element: _Element, lines: Iterator[tuple[int, bytes]]) -> tuple[IntArray, int]:
    """Returns what the lists of corners hold, and the least length of one."""
    numbers, shortest = array("q"), _FEWEST
    for line, words in _text_rows(element, lines):
        at = 0
        for place, (*_, length) in enumerate(element.properties):
            count = _whole(words, at, line) if length else 1
            at += bool(length)
            if not 0 <= count <= len(words) - at:
                raise MeshError(f"line {line}: a list of {count} has {len(words) - at} numbers")
            if place == element.list_place:
                numbers.extend(_whole(words, k, line) for k in range(at, at + count))
                shortest = min(shortest, count)
            at += count
        if at != len(words):
            raise MeshError(
                f"line {line}: {quote(element.name)} needs {at} numbers, not {len(words)}"
            )
    return np.array(numbers, dtype=np.int64), shortest


def _whole(words: list[bytes], place: int, line: int) -> int:
    """Returns a whole number of a text row."""
    word = words[place] if place < len(words) else b""
    if not _WHOLE.fullmatch(word):
        raise MeshError(
            f"line {line}: holds {quote(word.decode('latin-1'))}, which is not a whole number"
        )
    return int(word)
