"""Reads a motion that comes back from elsewhere: trajectory_msgs/JointTrajectory as YAML or JSON, or CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import yaml

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.logged_motion import LoggedMotion

MOST_BYTES = 500_000_000
"""Largest file that is read [bytes]."""
RATES = ("position", "velocity", "acceleration")
SUFFIXES = (".csv", ".json", ".yaml", ".yml")


def read_logged_motion(path: Path, joints: Sequence[str]) -> LoggedMotion:
    """Returns the motion in a file.

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
    try:
        if path.stat().st_size > MOST_BYTES:
            reader.fail(0, f"is larger than {MOST_BYTES // 1_000_000} MB")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        reader.fail(0, f"cannot be read: {error.strerror}")
    except UnicodeDecodeError:
        reader.fail(0, "is not text in UTF-8")
    return reader.table(text) if path.suffix.lower() == ".csv" else reader.message(text)


class _Reader:
    """Reads one file."""

    def __init__(self, file: str, joints: Sequence[str]) -> None:
        self._file, self._joints = file, list(joints)

    def fail(self, line: int, what: str) -> NoReturn:
        """Raises InputError; line 0 stands for the whole file."""
        raise InputError([Diagnostic(self._file, line, 0, "E110", what)])

    def table(self, text: str) -> LoggedMotion:
        """Returns the motion in a CSV."""
        lines = [(n, row) for n, row in enumerate(csv.reader(io.StringIO(text)), start=1)]
        lines = [(n, row) for n, row in lines if row and not row[0].lstrip().startswith("#")]
        if not lines:
            self.fail(0, "is empty; the first line names columns: time and <joint>_position")
        header = [name.strip() for name in lines[0][1]]
        if "time" not in header:
            self.fail(lines[0][0], f"has no column 'time'; it has {', '.join(header[:6])}")
        found: dict[str, list[int | None]] = {}
        for joint in self._joints:
            names = ((f"{joint}_position", joint), (f"{joint}_velocity",))
            columns = [
                next((header.index(name) for name in some if name in header), None)
                for some in (*names, (f"{joint}_acceleration",))
            ]
            if columns[0] is not None:
                found[joint] = columns
        if not found:
            known = ", ".join(f"{joint}_position" for joint in self._joints[:3])
            self.fail(lines[0][0], f"has no column of a joint of the robot, such as {known}")
        values = self._numbers(lines[1:], len(header))
        numbers = [line for line, _ in lines[1:]]
        time = values[:, header.index("time")]
        rates: list[FloatArray | None] = []
        for k in range(len(RATES)):
            some = [columns[k] for columns in found.values()]
            complete = [column for column in some if column is not None]
            rates.append(values[:, complete] if len(complete) == len(some) else None)
        for k, what in enumerate(np.isfinite(values[:, [header.index("time"), *_of(found)]])):
            if not what.all():
                self.fail(numbers[k], "has a number that is not finite")
        self._check_time(time, lambda k: (numbers[k], ""))
        assert rates[0] is not None
        return LoggedMotion(tuple(found), time, rates[0], rates[1], rates[2])

    def _numbers(self, lines: Sequence[tuple[int, list[str]]], width: int) -> FloatArray:
        """Returns the rows below the header; text in a column is NaN."""
        rows = np.full((len(lines), width), np.nan)
        for k, (line, row) in enumerate(lines):
            if len(row) != width:
                self.fail(line, f"has {len(row)} columns, the header {width}")
            try:
                rows[k] = [float(value) for value in row]
            except ValueError:
                rows[k] = [_number(value) for value in row]
        return rows

    def message(self, text: str) -> LoggedMotion:
        """Returns the motion in a JointTrajectory."""
        document = self._document(text)
        if isinstance(document, dict) and isinstance(document.get("trajectory"), dict):
            document = document["trajectory"]
        if not isinstance(document, dict) or not {"joint_names", "points"} <= set(document):
            self.fail(0, "is no JointTrajectory: joint_names and points are missing")
        names, points = document["joint_names"], document["points"]
        if not isinstance(names, list) or not names or len(set(map(str, names))) != len(names):
            self.fail(0, "joint_names: must name every joint once")
        for name in names:
            if name not in self._joints:
                hint = suggest(str(name), self._joints, "the robot's joints")
                self.fail(0, f"joint_names: the robot has no joint {quote(name)}{hint}")
        if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
            self.fail(0, "points: must be a list of points")
        time = np.array([self._time(point, k) for k, point in enumerate(points)])
        self._check_time(time, lambda k: (0, f"points[{k}].time_from_start: "))
        position = self._rows(points, "positions", len(names))
        if position is None:
            self.fail(0, "points: there are no positions")
        velocity = self._rows(points, "velocities", len(names))
        return LoggedMotion(
            tuple(names), time, position, velocity, self._rows(points, "accelerations", len(names))
        )

    def _document(self, text: str) -> Any:
        """Returns what a file of YAML or JSON says; JSON is read by its own reader, which is faster."""
        if text.lstrip().startswith("{"):
            try:
                return json.loads(text)
            except (json.JSONDecodeError, RecursionError):
                pass  # it may be YAML in braces
        try:
            return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 0
            self.fail(line, f"is neither YAML nor JSON: {error.problem}")
        except (yaml.YAMLError, ValueError, RecursionError):
            self.fail(0, "is neither YAML nor JSON")

    def _time(self, point: dict[str, Any], number: int) -> float:
        stamp = point.get("time_from_start")
        parts = stamp if isinstance(stamp, dict) else {}
        seconds, nanoseconds = parts.get("sec"), parts.get("nanosec")
        if type(seconds) is not int or type(nanoseconds) is not int or abs(seconds) > 2**31:
            where = f"points[{number}].time_from_start"
            self.fail(0, f"{where}: must be {{sec: …, nanosec: …}}, not {quote(stamp)}")
        return seconds + nanoseconds * 1e-9

    def _rows(self, points: Sequence[dict[str, Any]], key: str, count: int) -> FloatArray | None:
        """Returns one kind of values of all points, None where none has any."""
        rows = [point.get(key) or [] for point in points]
        if not any(rows):
            return None
        for k, row in enumerate(rows):
            good = isinstance(row, list) and all(type(value) in (int, float) for value in row)
            if not good or len(row) != count:
                self.fail(0, f"points[{k}].{key}: must be {count} numbers")
        found = np.array(rows, dtype=np.float64)
        if not np.isfinite(found).all():
            k = int(np.argmin(np.isfinite(found).all(axis=1)))
            self.fail(0, f"points[{k}].{key}: has a number that is not finite")
        return found

    def _check_time(self, time: FloatArray, where: Any) -> None:
        """Fails where there are fewer than two instants, or one is not after the one before."""
        if len(time) < 2:
            self.fail(0, f"has {len(time)} samples; at least two are needed")
        back = np.flatnonzero(np.diff(time) <= 0.0)
        if len(back):
            line, prefix = where(int(back[0]) + 1)
            k = int(back[0])
            self.fail(line, f"{prefix}time {time[k + 1]:g} s is not after {time[k]:g} s")


def _of(found: dict[str, list[int | None]]) -> list[int]:
    """Returns all columns of joints."""
    return [column for columns in found.values() for column in columns if column is not None]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
