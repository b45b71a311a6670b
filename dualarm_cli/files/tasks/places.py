"""Rows of CSV files as places of parts: poses, ids and kinds of parts."""

from __future__ import annotations

import csv

import pinocchio as pin

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.quantities import (
    ANGLE,
    LENGTH,
    QuantityError,
    parse_quantity,
)
from dualarm_cli.files.source.text_source import TextSource, quote, suggest
from dualarm_cli.records import dataclass

_LENGTHS, _ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")
_TEXTS = ("id", "part")
COLUMNS = (*_TEXTS, *_LENGTHS, *_ANGLES)
"""Names of the columns, in the order in which messages list them."""


@dataclass(frozen=True)
class ListedPlace:
    """A place of a list: where a part lies, or goes."""

    label: str
    """Its id in the names of tasks."""
    pose: pin.SE3
    """Pose in the target's frame."""
    part: str = ""
    """Kind of part there; empty if the list does not say."""


def read_places(
    source: TextSource, findings: Findings, parts: tuple[str, list[str]] | None = None
) -> list[ListedPlace] | None:
    """Read the places in a CSV file, or None after noting errors.

    The first row names the columns, lengths and angles with a unit if it is not m or rad: `x [mm]`. The separator is
    a comma, or a semicolon.

    Args:
        source: the file.
        findings: where errors are noted.
        parts: task that is repeated, and the parts that the list may name; None for any.
    """
    head = source.lines[0] if source.lines else ""
    separator = ";" if ";" in head and "," not in head else ","
    rows = [
        (number, row)
        for number, row in enumerate(csv.reader(source.lines, delimiter=separator), 1)
        if any(cell.strip() for cell in row)
    ]
    if len(rows) < 2:
        message = f"has no places: the first row names the columns ({', '.join(COLUMNS)})"
        findings.extend([source.diagnostic(1, 1, "E101", message)])
        return None
    reader = _Reader(source, findings, separator)
    columns = reader.columns(rows[0][1])
    places = [reader.place(columns, number, row) for number, row in rows[1:]]
    for place, (number, row) in zip(places, rows[1:], strict=True):
        if parts is not None and place.part and place.part not in parts[1]:
            task, hint = quote(f"{parts[0]}[{place.label}]"), suggest(place.part, parts[1], "parts")
            message = f"the cell has no part {quote(place.part)} for task {task}{hint}"
            reader.note(number, row, list(dict(columns)).index("part"), message, "E300")
    if reader.failed:
        return None
    return places


class _Reader:
    """Converter of the cells of one CSV file; notes errors."""

    def __init__(self, source: TextSource, findings: Findings, separator: str) -> None:
        self._source, self._findings, self._separator = source, findings, separator
        self._first: dict[str, int] = {}
        self.failed = False

    def note(self, line: int, row: list[str], k: int, message: str, code: str = "E200") -> None:
        """Note an error of the k-th cell of a row."""
        column = 1 + sum(len(cell) + len(self._separator) for cell in row[:k])
        self._findings.extend([self._source.diagnostic(line, column, code, message)])
        self.failed = True

    def columns(self, row: list[str]) -> list[tuple[str, str]]:
        """Read name and unit of each column."""
        columns: list[tuple[str, str]] = []
        for k, cell in enumerate(row):
            name, _, rest = cell.strip().partition("[")
            name, unit = name.strip(), rest.rstrip("]").strip()
            dimension = LENGTH if name in _LENGTHS else ANGLE
            if name not in COLUMNS:
                message = f"no column {quote(name)}{suggest(name, list(COLUMNS))}"
                self.note(1, row, k, message, "E201")
            elif name in dict(columns):
                self.note(1, row, k, f"column {quote(name)} is given twice; remove one", "E102")
            elif unit and (name in _TEXTS or unit not in dimension.units):
                right = name if name in _TEXTS else f"{name} [{dimension.meant}]"
                self.note(1, row, k, f"{quote(unit)} is no unit of {name}; write {right}")
                unit = dimension.meant  # the rows have no error by that
            columns.append((name, unit))
        if not self.failed and not any(name in (*_LENGTHS, *_ANGLES) for name, _ in columns):
            self.note(1, row, 0, "no column gives a pose; name x, y and z", "E202")
        return columns

    def place(self, columns: list[tuple[str, str]], line: int, row: list[str]) -> ListedPlace:
        """Read the place in a row; identity where it has errors."""
        if len(row) != len(columns):
            self.note(line, row, 0, f"{len(row)} values; the first row names {len(columns)}")
        numbers, texts = dict.fromkeys((*_LENGTHS, *_ANGLES), 0.0), dict.fromkeys(_TEXTS, "")
        for k, ((name, unit), cell) in enumerate(zip(columns, row, strict=False)):
            text = cell.strip()
            if name in texts:
                texts[name] = text
            elif name in numbers:
                try:
                    dimension = LENGTH if name in _LENGTHS else ANGLE
                    numbers[name] = parse_quantity(_with_unit(text, unit), dimension)
                except QuantityError as error:
                    self.note(line, row, k, f"{name}: {error}")
        label = texts["id"] or str(len(self._first) + 1)
        if label in self._first:
            message = f"duplicate id {quote(label)}, first at line {self._first[label]}"
            self.note(line, row, 0, message, "E102")
        self._first.setdefault(label, line)
        x, y, z, roll, pitch, yaw = numbers.values()
        pose = pin.XYZQUATToSE3(
            [x, y, z, *pin.Quaternion(pin.rpy.rpyToMatrix(roll, pitch, yaw)).coeffs()]
        )
        return ListedPlace(label, pose, texts["part"])


def _with_unit(text: str, unit: str) -> str:
    """Append a column's unit to a number that has none."""
    return f"{text} {unit}".rstrip() if text and (text[-1].isdigit() or text[-1] == ".") else text
