"""Expansion of tasks with `each`, to places of grids and rows of CSV files.

Patterns of tasks exist in this module alone: it repeats the data of the document before they are validated, so that
readers, rules and planner see single tasks. The repeated data keep the lines of the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import pinocchio as pin

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import validate
from dualarm_cli.files.source.projects import Project, display_name, noted
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.places import ListedPlace, read_places
from dualarm_cli.files.tasks.schema_tasks import EachSection
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.part_flow import Pattern, PlaceIndex, kind_of_part
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass

_TARGETS = ("pick", "place", "move")
"""Keys of the targets that may be repeated."""
_RANGES = ("x", "y", "layer")
"""Keys of the ranges of places."""
_note = NoteTable(
    "pattern",
    expanded="{id} is {count:1 task|# tasks}, {names:* to }: {work:*, }",
)


@dataclass(frozen=True)
class Spot:
    """A place that a repeated target takes."""

    label: str
    """Its numbers or id in the names of tasks."""
    pose: pin.SE3
    """Pose in the frame of the target."""
    frame: str = ""
    """Frame of its grid; empty for a row of a CSV file."""
    index: PlaceIndex | None = None
    """Numbers in the grid."""
    part: str = ""
    """Kind of part there; empty if nothing says."""


@dataclass(frozen=True)
class TaskExpansion:
    """Poses and notes of expanded tasks."""

    poses: Mapping[Loc, pin.SE3] = field(default_factory=dict)
    """Pose of the place of a target in its frame, by place in the document."""
    notes: tuple[Note, ...] = ()
    """A note for each expanded task of the file."""


@dataclass(frozen=True)
class _Copy:
    """A task for one place of each repeated target."""

    entry: Any
    """Its data, a mapping in valid files."""
    source: int
    """Index of the task that it repeats."""
    spots: Mapping[str, Spot] = field(default_factory=dict)
    """Its places, by target."""

    @property
    def id(self) -> str:
        """Unique name; empty where the file has none."""
        return str(self.entry.get("id", "")) if isinstance(self.entry, dict) else ""


def expand_tasks(
    document: Document,
    cell: Cell | None,
    project: Project,
    path: Path,
    findings: Findings,
) -> TaskExpansion:
    """Repeat tasks for each place that they name with `each`; note errors.

    Args:
        document: the task file; its tasks, and what names them, change.
        cell: with patterns and parts; None if it could not be read: nothing is repeated.
        project: what CSV files must stay in.
        path: the task file.
        findings: where errors are noted.
    """
    entries = document.listed("tasks")
    if cell is None:
        return TaskExpansion()
    expander = _Expander(document, cell, project, path, findings)
    repeated = [k for k, entry in enumerate(entries) if any(expander.targets(entry))]
    if not repeated:
        return TaskExpansion()
    copies = [copy for k, entry in enumerate(entries) for copy in expander.copies(k, entry)]
    _check_filled_once(document, copies, findings)
    names: dict[str, list[str]] = {}
    for copy in copies:
        if copy.spots:
            names.setdefault(str(entries[copy.source]["id"]), []).append(copy.id)
    for copy in copies:
        _name_all(copy, names)
    _order_layers(copies, cell.patterns, document)
    _store(document, copies)
    for row in document.listed("sequences"):
        if isinstance(row, list):
            row[:] = [each for name in row for each in names.get(str(name), [name])]
    poses: dict[Loc, pin.SE3] = {
        ("tasks", k, key): spot.pose
        for k, copy in enumerate(copies)
        for key, spot in copy.spots.items()
    }
    return TaskExpansion(poses, tuple(_notes(copies, entries, repeated)))


class _Expander:
    """Reader of `each`, which notes errors."""

    def __init__(
        self,
        document: Document,
        cell: Cell,
        project: Project,
        path: Path,
        findings: Findings,
    ) -> None:
        self._document, self._patterns, self._findings = document, cell.patterns, findings
        self._parts = [name for name in cell.parts if name == kind_of_part(name)]
        self._project, self._path = project, path

    def targets(self, entry: Any) -> Iterator[str]:
        """Yield the keys of an entry's targets that have `each`."""
        for key in _TARGETS if isinstance(entry, dict) else ():
            if isinstance(entry.get(key), dict) and "each" in entry[key]:
                yield key

    def copies(self, index: int, entry: Any) -> list[_Copy]:
        """Repeat a task; without `each`, or after an error, it is the only copy."""
        keys, loc = list(self.targets(entry)), ("tasks", index)
        rows = {key: self._spots(entry, (*loc, key)) for key in keys}
        spots = {key: row for key, row in rows.items() if row is not None}
        if not spots or len(spots) < len(rows) or not isinstance(entry.get("id"), str):
            return [_Copy(_without_each(entry, keys), index)]
        counts = {key: len(row) for key, row in spots.items()}
        if len(set(counts.values())) > 1:
            sizes = " and ".join(f"{key} has {count} places" for key, count in counts.items())
            least = min(counts.values())
            message = f"{sizes}; select as many of each, such as each: {{first: {least}}}"
            largest = max(counts, key=lambda key: counts[key])
            self._findings.add(self._document, (*loc, largest, "each"), message)
            return [_Copy(_without_each(entry, keys), index)]
        whole = _without_each(entry, keys)
        copies = []
        for taken in zip(*spots.values(), strict=True):
            copy = {**whole, "id": f"{entry['id']}[{taken[0].label}]"}
            part = next((spot.part for spot in taken if spot.part), "")
            if part and "part" not in copy:
                copy["part"] = part
            copies.append(_Copy(copy, index, dict(zip(spots, taken, strict=True))))
        return copies

    def _spots(self, entry: dict[str, Any], loc: Loc) -> list[Spot] | None:
        """Read the places that a target is repeated for, or None after noting errors."""
        target = entry[str(loc[-1])]
        each, place = target["each"], (*loc, "each")
        if isinstance(each, str) and each.endswith(".csv"):
            # A part of the task counts before those of the list.
            parts = None if "part" in entry else (str(entry.get("id", "")), self._parts)
            rows = self._listed(each, place, parts)
            return None if rows is None else [Spot(r.label, r.pose, part=r.part) for r in rows]
        section = EachSection()
        if isinstance(each, dict):
            read = validate(self._document, EachSection, self._findings, each, place)
            if read is None:
                return None
            section = read
        elif each != "place":
            message = (
                f"each: {quote(each)} is not allowed; write place, the path of a CSV file, or a selection "
                "such as {x: [1, 2]}"
            )
            self._findings.add(self._document, place, message, "E200")
            return None
        frame = target.get("at", target.get("in"))
        pattern = self._patterns.get(frame) if isinstance(frame, str) else None
        if pattern is None:
            what = (
                "the target names no frame"
                if frame is None
                else f"frame {quote(frame)} has no grid"
            )
            grids = suggest(str(frame or ""), list(self._patterns), "frames with a grid")
            self._findings.add(self._document, place, f"{what}{grids}")
            return None
        down = loc[-1] == "pick"
        chosen = _selected(pattern, section, down)
        if not chosen or (section.first or 0) > len(chosen):
            message = f"selects {len(chosen)} of the {len(pattern.places)} places of {quote(frame)}"
            advice = f"; first: at most {len(chosen)}" if chosen else "; widen the ranges"
            # The ranges select nothing from this one on; after all of them it is `first`.
            steps = [section.model_copy(update=dict.fromkeys(_RANGES[k:])) for k in range(1, 4)]
            key = next(
                (r for r, s in zip(_RANGES, steps, strict=True) if not _selected(pattern, s, down)),
                "first",
            )
            self._findings.add(self._document, (*place, key), message + advice)
            return None
        used = chosen[: section.first]
        return [Spot(_label(pattern, i), pattern.places[i], str(frame), i) for i in used]

    def _listed(
        self, reference: str, loc: Loc, parts: tuple[str, list[str]] | None
    ) -> list[ListedPlace] | None:
        with noted(self._findings, self._document, loc):
            path = self._project.follow(reference, self._path)
            name = display_name(reference, self._document.source.name)
            return read_places(self._project.read(path, name), self._findings, parts)
        return None


def _selected(pattern: Pattern, section: EachSection, down: bool) -> list[PlaceIndex]:
    """Select places in order; `down` begins with the highest layer."""
    spans = [getattr(section, key) for key in _RANGES]
    chosen = [
        index
        for index in pattern.ordered(section.order)
        if all(s is None or s[0] <= n <= s[1] for n, s in zip(index, spans, strict=True))
    ]
    return sorted(chosen, key=lambda index: -index[2]) if down else chosen


def _label(pattern: Pattern, index: PlaceIndex) -> str:
    """Format the numbers of a place; the layer only where there are several."""
    return ",".join(map(str, index if pattern.in_layers else index[:2]))


def _without_each(entry: Any, keys: Sequence[str]) -> Any:
    """Copy a task without its `each`."""
    if not keys:
        return entry
    bare = {key: {k: v for k, v in entry[key].items() if k != "each"} for key in keys}
    return {**entry, **bare}


def _name_all(copy: _Copy, names: Mapping[str, list[str]]) -> None:
    """Replace names of repeated tasks by those of all their copies, but the task itself."""
    for key in ("after", "touches"):
        given = copy.entry.get(key) if isinstance(copy.entry, dict) else None
        if isinstance(given, list) and any(str(name) in names for name in given):
            full = [each for name in given for each in names.get(str(name), [name])]
            copy.entry[key] = [name for name in full if name != copy.id]


def _check_filled_once(document: Document, copies: Sequence[_Copy], findings: Findings) -> None:
    """Note places of grids from which, or into which, two tasks carry a part."""
    first: dict[tuple[str, str, PlaceIndex | None], str] = {}
    for copy in copies:
        for key, spot in copy.spots.items():
            if not spot.frame or key == "move":
                continue
            name = first.setdefault((key, spot.frame, spot.index), copy.id)
            if name != copy.id:
                message = (
                    f"place [{spot.label}] of {quote(spot.frame)} is used by {quote(name)} and {quote(copy.id)}; "
                    "select places with a mapping, such as each: {y: [1, 2]}"
                )
                findings.add(document, ("tasks", copy.source, key, "each"), message)
                return


def _order_layers(
    copies: Sequence[_Copy], patterns: Mapping[str, Pattern], document: Document
) -> None:
    """Let parts wait for those that carry them, or lie on them, and touch them.

    What the order of one arm in the file implies anyway is not stated.
    """
    given = document.data.get("order", "given") == "given"
    defaults = document.data.get("defaults")
    of_all = defaults.get("part") if isinstance(defaults, dict) else None
    number = {copy.id: k for k, copy in enumerate(copies)}
    for key in ("pick", "place"):
        at = {
            (copy.spots[key].frame, copy.spots[key].index): copy
            for copy in copies
            if key in copy.spots and copy.spots[key].frame
        }
        for (frame, index), copy in at.items():
            assert index is not None  # places of grids have numbers
            lower = [at.get((frame, below)) for below in patterns[frame].below(index)]
            for carrier in [c for c in lower if c is not None]:
                first, then = (carrier, copy) if key == "place" else (copy, carrier)
                arms = {first.entry.get("arm"), then.entry.get("arm")}
                implied = given and len(arms) == 1 and "any" not in arms
                if not (implied and number[first.id] < number[then.id]):
                    then.entry["after"] = [*then.entry.get("after", ()), first.id]
                if copy.entry.get("part", of_all):
                    copy.entry["touches"] = [*copy.entry.get("touches", ()), carrier.id]


def _store(document: Document, copies: Sequence[_Copy]) -> None:
    """Replace the tasks of a document by their copies, with the places of their sources."""
    node = document.root.children["tasks"]
    node.children = {k: node.children[copy.source] for k, copy in enumerate(copies)}
    document.data["tasks"] = [copy.entry for copy in copies]
    replaced = {loc: value for loc, value in document.replaced.items() if loc[0] == "tasks"}
    for loc in replaced:
        if len(loc) > 1:
            del document.replaced[loc]
    for k, copy in enumerate(copies):
        for loc, value in replaced.items():
            if loc[1:2] == (copy.source,):
                document.replaced[("tasks", k, *loc[2:])] = value


def _notes(
    copies: Sequence[_Copy], entries: Sequence[Any], repeated: Sequence[int]
) -> Iterator[Note]:
    """Describe what each repeated task is expanded to."""
    for k in repeated:
        mine = [copy for copy in copies if copy.source == k and copy.spots]
        if mine:
            ends = mine if len(mine) == 1 else (mine[0], mine[-1])
            work = [
                f"{key} {entries[k][key].get('at', entries[k][key].get('in', 'world'))}"
                + " … ".join(f"[{copy.spots[key].label}]" for copy in ends)
                for key in mine[0].spots
            ]
            names = [copy.id for copy in ends]
            yield _note("expanded", id=entries[k]["id"], count=len(mine), names=names, work=work)
