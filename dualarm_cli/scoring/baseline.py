"""Baseline of a score: accepted results of the cases (`dualarm.scores/1`).

It also finds the task files to score: names, patterns and folders.
"""

from __future__ import annotations

import glob
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, fields
from pathlib import Path
from typing import Any, NoReturn

from dualarm_cli.errors import Diagnostic, InputError, UsageError
from dualarm_cli.evaluation.request import case_name
from dualarm_cli.files.source.text_source import MAX_FILE_BYTES, quote, read_bytes
from dualarm_cli.model.studies.evaluation import Evaluation, is_number
from dualarm_cli.records import dataclass

FORMAT = "dualarm.scores/1"
LARGEST_FILE = 100_000_000
"""Maximum size of a baseline [B]."""


@dataclass(frozen=True)
class Recorded:
    """Recorded result of one case."""

    cycle_time: float
    """Cycle time [s]."""
    clearance: float | None = None
    """Least clearance proven [m]."""
    gap: float | None = None
    """Relative gap of the plan above its lower bound."""
    limiting: Mapping[str, float] = field(default_factory=dict)
    """Composition of the time, see `Evaluation` [s]."""
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Joint limits by joint, see `Evaluation`."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file read, by its name relative to the task file's folder."""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """Values of task and cell file that levers change, by role and JSON pointer."""

    @classmethod
    def of(cls, evaluation: Evaluation, numbers: Mapping[str, Any] | None = None) -> Recorded:
        """Record the result of a planned case."""
        names = [entry.name for entry in fields(cls) if entry.name != "numbers"]
        return cls(**{name: getattr(evaluation, name) for name in names}, numbers=numbers or {})


@dataclass(frozen=True)
class Baseline:
    """Recorded results of all cases, with their settings."""

    settings: Mapping[str, Any]
    """Settings of the request (`Request.settings`)."""
    cases: Mapping[str, Recorded]
    """Recorded results by case."""
    made_on: str = ""
    """Machine of the recording (`evaluation.machine`); empty if unknown."""


def read_baseline(path: Path) -> Baseline:
    """Read a baseline from a file.

    Args:
        path: as given on the command line.

    Raises:
        InputError: it is missing, damaged, of another format, or without cases, or holds NaN or infinity.
    """
    name = str(path)
    data = read_bytes(path, name, LARGEST_FILE)
    try:
        document = json.loads(data, object_pairs_hook=_members, parse_constant=_no_number)
    except json.JSONDecodeError as error:
        _refuse(name, f"is not JSON: {error.msg}", error.lineno, error.colno)
    except UnicodeDecodeError as error:
        _refuse(name, f"is not a baseline: byte 0x{data[error.start]:02x} is not UTF-8")
    except RecursionError:
        _refuse(name, "is not a baseline: nested too deeply")
    except ValueError as error:
        why = str(error).partition(" for integer")[0]
        _refuse(name, f"is not a baseline: {why}")
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        format_name = document.get("format") if isinstance(document, dict) else document
        _refuse(
            name,
            f"cannot be read by this version: its format is {quote(format_name)}, not '{FORMAT}'",
        )
    cases, settings = document.get("cases"), document.get("settings")
    if not isinstance(cases, dict) or not isinstance(settings, dict):
        _refuse(name, "is damaged: 'cases' and 'settings' must be there")
    if not cases:
        _refuse(name, "has no cases to compare with")
    made_on = document.get("made_on", "")
    if not isinstance(made_on, str):
        _refuse(name, f"is damaged: made_on is {quote(made_on)}, not a text")
    recorded = {case: _recorded(name, case, entry) for case, entry in cases.items()}
    return Baseline(settings, recorded, made_on)


def _recorded(file: str, case: str, entry: Any) -> Recorded:
    """Read the record of one case; a damaged one raises InputError."""
    names = {entry_field.name for entry_field in fields(Recorded)}
    # Baselines of earlier versions have no numbers.
    if not isinstance(entry, dict) or {*entry, "numbers"} != names:
        _refuse(file, f"is damaged: case {quote(case)} must have {', '.join(sorted(names))}")
    for name in ("cycle_time", "clearance", "gap"):
        optional = name != "cycle_time" and entry[name] is None
        if not optional and not is_number(entry[name]):
            _refuse(file, f"is damaged: case {quote(case)}: {name} is {quote(entry[name])}")
    if entry["cycle_time"] < 0.0:
        _refuse(file, f"is damaged: case {quote(case)}: cycle_time is negative")
    groups = [entry["limiting"], entry["limits"], entry["inputs"], entry.get("numbers", {})]
    if not all(isinstance(group, dict) for group in groups):
        objects = "limiting, limits, inputs, numbers"
        _refuse(file, f"is damaged: case {quote(case)}: {objects} must be objects")
    tables = [entry["limiting"], *entry["limits"].values()]
    whole = all(isinstance(t, dict) and all(map(is_number, t.values())) for t in tables)
    if not whole or not all(isinstance(text, str) for text in entry["inputs"].values()):
        _refuse(file, f"is damaged: case {quote(case)}: limiting, limits or inputs")
    return Recorded(**entry)


def _members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{quote(next(k for k in keys if keys.count(k) > 1))} is used twice")
    return members


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def _refuse(file: str, message: str, line: int = 0, column: int = 0) -> NoReturn:
    advice = "; --update-baseline with --force writes a new one"
    raise InputError([Diagnostic(file, line, column, "E110", message + advice)])


def baseline_bytes(
    settings: Mapping[str, Any], cases: Mapping[str, Recorded], made_on: str = ""
) -> bytes:
    """Encode a baseline; equal content gives equal bytes.

    Each small table has its own line.
    """
    document = {
        "format": FORMAT,
        "settings": dict(settings),
        **({"made_on": made_on} if made_on else {}),
        "cases": {
            case: {entry.name: getattr(recorded, entry.name) for entry in fields(Recorded)}
            for case, recorded in cases.items()
        },
    }
    text = "".join(_lines(document, 0)) + "\n"
    # Lone surrogates, from file names that are not UTF-8, become JSON escapes.
    return text.encode("utf-8", "backslashreplace")


def _lines(value: Any, depth: int) -> Iterable[str]:
    """Yield a value as JSON.

    Mappings of plain values below the cases are on one line.
    """
    nested = isinstance(value, Mapping) and any(isinstance(v, Mapping) for v in value.values())
    if not isinstance(value, Mapping) or not value or (depth > 2 and not nested):
        yield json.dumps(value, sort_keys=True, allow_nan=False, ensure_ascii=False)
        return
    yield "{"
    indent = "  " * (depth + 1)
    for number, key in enumerate(value if depth == 0 else sorted(value)):
        yield f"{',' if number else ''}\n{indent}{json.dumps(key, ensure_ascii=False)}: "
        yield from _lines(value[key], depth + 1)
    yield f"\n{'  ' * depth}}}"


_TASKS = re.compile(
    rb"""^(?:\xef\xbb\xbf)?[\s{]*(['"]?)dualarm\1\s*:\s*['"]?tasks/""", re.MULTILINE
)
"""Key that identifies a task file.

With quotes and braces it is the same YAML.
"""


def find_cases(patterns: Sequence[str]) -> list[str]:
    """Find the task files that match patterns, each once, sorted.

    The name of a file selects it, whatever its content; the name of a folder selects all task files in and below it.
    Anything else is a pattern, in which `**` matches any folders; if it matches folders and no file, it selects these.
    Hidden files and folders are selected only by name.

    Args:
        patterns: as given on the command line; the shell may not have expanded them.

    Raises:
        UsageError: a name or pattern matches nothing: a missing case must not pass.
    """
    cases: dict[str, None] = {}
    for pattern in patterns:
        names = _matches(pattern)
        if not names:
            folder = bool(pattern) and Path(pattern).is_dir()
            what = "has no task files (tasks/1)" if folder else "does not exist and matches no file"
            raise UsageError(f"{quote(pattern)} {what}: there is nothing to score")
        cases |= dict.fromkeys(case_name(name) for name in names)
    return sorted(cases)


def _matches(pattern: str) -> list[str]:
    if not pattern or "\0" in pattern:
        return []
    path = Path(pattern)
    if path.is_dir():
        return _tasks_in(pattern)
    # An existing name takes precedence: it may contain brackets.
    if os.path.lexists(path) or not glob.has_magic(pattern):
        return [pattern]
    names = glob.glob(pattern, recursive=True)  # noqa: PTH207
    files = [name for name in names if not Path(name).is_dir()]
    return files or [task for folder in names for task in _tasks_in(folder)]


def _tasks_in(folder: str) -> list[str]:
    """Find the task files in and below a folder by their `dualarm` key.

    Raises:
        UsageError: the folder or one in it cannot be read.
    """

    def unread(error: OSError) -> NoReturn:
        raise UsageError(
            f"{quote(error.filename)} cannot be searched for task files: {error.strerror}"
        )

    paths = []
    for place, folders, files in os.walk(folder, onerror=unread):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in files:
            path = Path(place) / name
            if not name.startswith(".") and path.suffix in (".yaml", ".yml") and _is_tasks(path):
                paths.append(str(path))
    return paths


def _is_tasks(path: Path) -> bool:
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return _TASKS.search(file.read(MAX_FILE_BYTES)) is not None
    except OSError:
        return True  # report unreadable files instead of skipping them
