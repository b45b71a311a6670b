"""Reader of recorded motions: trajectory_msgs/JointTrajectory as YAML or JSON, or CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import TextSource, quote, read_text, suggest
from dualarm_cli.files.source.yaml_source import MAX_NUMBER_LENGTH, parse_yaml
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.joint_motion import LoggedMotion
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LogLimits:
    """Limits of recorded motions."""

    max_bytes: int = 100_000_000
    """Maximum file size [bytes]."""
    max_samples: int = 500_000
    """Maximum number of samples: eight minutes at 1 kHz."""
    batch: int = 10_000
    """Number of table rows that are kept as text at a time."""
    min_step: float = 0.5e-9
    """Least time between samples [s]: messages count whole nanoseconds."""
    max_value: float = 1e9
    """Largest absolute value that is read [s, rad, m and their rates]."""


LOG = LogLimits()


RATES = ("position", "velocity", "acceleration")
SUFFIXES = (".csv", ".json", ".yaml", ".yml")


def read_logged_motion(path: Path, joints: Sequence[str]) -> LoggedMotion:
    """Read the motion in a file.

    A JointTrajectory may stand below `trajectory`, as in the goal of a FollowJointTrajectory action. A CSV has a column
    `time` [s] and `<joint>_position` or `<joint>` [rad], with `<joint>_velocity` and `<joint>_acceleration` or without;
    other columns are not read, nor lines that begin with `#`.

    Args:
        path: of the file; its suffix says what it is.
        joints: of the robot.

    Raises:
        InputError: the file cannot be read, with the line or the point.
    """
    reader = _Reader(str(path), joints)
    if path.suffix.lower() not in SUFFIXES:
        reader.fail(0, f"is neither .csv nor a JointTrajectory in {', '.join(SUFFIXES[1:])}")
    source = read_text(path, str(path), LOG.max_bytes)
    return reader.table(source) if path.suffix.lower() == ".csv" else reader.message(source)


class _Reader:
    """Reader of one file."""

    def __init__(self, file: str, joints: Sequence[str]) -> None:
        self._file, self._joints = file, list(joints)

    def fail(self, line: int, what: str) -> NoReturn:
        """Raise InputError; line 0 stands for the whole file."""
        raise InputError([Diagnostic(self._file, line, 0, "E110", what)])

    def table(self, source: TextSource) -> LoggedMotion:
        """Read the motion in a CSV."""
        rows = self._rows_of(source)
        first, header = next(rows, (0, []))
        if not header:
            self.fail(0, "is empty; the first line names columns: time and <joint>_position")
        header = [name.strip() for name in header]
        if "time" not in header:
            self.fail(first, f"has no column 'time'; it has {', '.join(map(quote, header[:6]))}")
        columns_of: dict[str, list[int | None]] = {}
        for joint in self._joints:
            names = ((f"{joint}_position", joint), (f"{joint}_velocity",))
            joint_columns = [
                next((header.index(name) for name in alternatives if name in header), None)
                for alternatives in (*names, (f"{joint}_acceleration",))
            ]
            if joint_columns[0] is not None:
                columns_of[joint] = joint_columns
        if not columns_of:
            examples = ", ".join(f"{joint}_position" for joint in self._joints[:3])
            self.fail(first, f"has no column of a joint of the robot, such as {examples}")
        # Positions, velocities, accelerations: columns of all joints, or none if a joint lacks that kind.
        kinds = list(zip(*columns_of.values(), strict=True))
        columns = [[c for c in kind if c is not None] if None not in kind else [] for kind in kinds]
        used = [header.index("time"), *columns[0], *columns[1], *columns[2]]
        twice = next((name for name in (header[c] for c in used) if header.count(name) > 1), None)
        if twice is not None:
            self.fail(first, f"has two columns {quote(twice)}; rename one")
        lines, values = self._numbers(rows, len(header), used)
        self._check_time(values[:, 0], lambda k: (lines[k], ""))
        ends = np.cumsum([1, *map(len, columns)])
        position, velocity, acceleration = (
            values[:, start:end] if end > start else None for start, end in pairwise(ends)
        )
        assert position is not None
        return LoggedMotion(tuple(columns_of), values[:, 0], position, velocity, acceleration)

    def _rows_of(self, source: TextSource) -> Iterator[tuple[int, list[str]]]:
        """Yield the rows of a CSV with their line numbers, without comments."""
        table = csv.reader(source.text.splitlines(keepends=True), strict=True)
        while True:
            line = table.line_num + 1
            try:
                row = next(table)
            except StopIteration:
                return
            except csv.Error as error:
                self.fail(line, f"is no CSV: {error}; is a quotation mark open?")
            if row and not row[0].lstrip().startswith("#"):
                yield line, row

    def _numbers(
        self, rows: Iterator[tuple[int, list[str]]], width: int, used: Sequence[int]
    ) -> tuple[list[int], FloatArray]:
        """Read the lines (k,) and used columns (k, n) below the header."""
        lines: list[int] = []
        parts: list[FloatArray] = [np.empty((0, len(used)))]
        batch: list[list[float]] = []
        for line, row in rows:
            if len(row) != width:
                self.fail(line, f"has {len(row)} columns, the header {width}")
            if len(lines) == LOG.max_samples:
                self.fail(line, f"has more samples than the {LOG.max_samples:,} that are read")
            lines.append(line)
            batch.append([_number(row[column]) for column in used])
            if not all(abs(value) <= LOG.max_value for value in batch[-1]):
                self.fail(line, f"must hold finite numbers up to {LOG.max_value:g}")
            if len(batch) == LOG.batch:
                parts.append(np.array(batch))
                batch = []
        return lines, np.concatenate([*parts, np.array(batch).reshape(-1, len(used))])

    def message(self, source: TextSource) -> LoggedMotion:
        """Read the motion in a JointTrajectory."""
        document = self._document(source)
        if isinstance(document, dict) and isinstance(document.get("trajectory"), dict):
            document = document["trajectory"]
        if not isinstance(document, dict) or not {"joint_names", "points"} <= set(document):
            self.fail(0, "is not a JointTrajectory: joint_names or points is missing")
        names, points = document["joint_names"], document["points"]
        named = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if not named or not names or len(set(names)) != len(names):
            self.fail(0, "joint_names: must name every joint once")
        for name in names:
            if name not in self._joints:
                hint = suggest(name, self._joints, "the robot's joints")
                self.fail(0, f"joint_names: the robot has no joint {quote(name)}{hint}")
        if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
            self.fail(0, "points: must be a list of points")
        if len(points) > LOG.max_samples:
            self.fail(0, f"points: are {len(points):,}; at most {LOG.max_samples:,} are read")
        time = np.array([self._time(point, k) for k, point in enumerate(points)])
        self._check_time(time, lambda k: (0, f"points[{k}].time_from_start: "))
        position = self._rows(points, "positions", len(names))
        if position is None:
            self.fail(0, "points: positions are missing")
        velocity = self._rows(points, "velocities", len(names))
        return LoggedMotion(
            tuple(names), time, position, velocity, self._rows(points, "accelerations", len(names))
        )

    def _document(self, source: TextSource) -> Any:
        """Parse a file of YAML or JSON.

        JSON has its own reader, which is faster.
        """
        if source.text.lstrip().startswith("{"):
            try:
                return json.loads(source.text, parse_int=_whole)
            except (json.JSONDecodeError, RecursionError):
                pass  # it may be YAML in braces
            except ValueError as error:
                self.fail(0, f"is no JointTrajectory: {error}")
        document = parse_yaml(source)
        if document.diagnostics:
            raise InputError(document.diagnostics)
        return document.data

    def _time(self, point: dict[str, Any], number: int) -> float:
        stamp = point.get("time_from_start")
        parts = stamp if isinstance(stamp, dict) else {}
        seconds, nanoseconds = parts.get("sec"), parts.get("nanosec")
        if (
            type(seconds) is not int
            or type(nanoseconds) is not int
            or abs(seconds) > LOG.max_value
            or not 0 <= nanoseconds < 1_000_000_000
        ):
            where = f"points[{number}].time_from_start"
            allowed = f"{{sec: up to {LOG.max_value:g}, nanosec: 0 to 999999999}}"
            self.fail(0, f"{where}: must be {allowed}, not {_shown(stamp)}")
        return seconds + nanoseconds * 1e-9

    def _rows(self, points: Sequence[dict[str, Any]], key: str, count: int) -> FloatArray | None:
        """Read one kind of values of all points, or None without any."""
        rows = [point.get(key) or [] for point in points]
        if not any(rows):
            return None
        for k, row in enumerate(rows):
            good = isinstance(row, list) and all(type(value) in (int, float) for value in row)
            if not good or len(row) != count:
                self.fail(0, f"points[{k}].{key}: must be {count} numbers")
            if not all(abs(value) <= LOG.max_value for value in row):
                self.fail(0, f"points[{k}].{key}: must be finite numbers up to {LOG.max_value:g}")
        return np.array(rows, dtype=np.float64)

    def _check_time(self, time: FloatArray, where: Callable[[int], tuple[int, str]]) -> None:
        """Require two instants or more, each 1 ns or more after another."""
        if len(time) < 2:
            self.fail(0, f"has {len(time)} samples; at least 2 are required")
        back = np.flatnonzero(np.diff(time) < LOG.min_step)
        if len(back):
            k = int(back[0])
            line, prefix = where(k + 1)
            self.fail(
                line,
                f"{prefix}time {time[k + 1]:.9g} s must be at least 1 ns after {time[k]:.9g} s",
            )


def _shown(stamp: Any) -> str:
    """Format a time stamp for messages."""
    parts = stamp if isinstance(stamp, dict) else {}
    pair = ", ".join(f"{key}: {quote(parts[key])}" for key in ("sec", "nanosec") if key in parts)
    return f"{{{pair}}}" if pair else quote(stamp)


def _whole(text: str) -> int:
    if len(text) > MAX_NUMBER_LENGTH:
        raise ValueError(f"number of {len(text)} characters; at most {MAX_NUMBER_LENGTH} are read")
    return int(text)


def _number(text: str) -> float:
    """Parse the number in a cell; NaN where something else stands in it."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
