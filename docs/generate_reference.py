"""Writes `docs/reference` from the code: file formats, results, commands, methods and error codes.

    PYTHONPATH=. python docs/generate_reference.py

The pages are committed, so that they can be read without building anything; a test fails where they are not what the
code says.
"""

from __future__ import annotations

import ast
import inspect
import math
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

import dualarm_cli
from dualarm_cli.cli.parts.completion import families
from dualarm_cli.cli.parts.help import EXAMPLES
from dualarm_cli.cli.run import command_line
from dualarm_cli.explanations import explanations
from dualarm_cli.files.cells.schema_cell import PairSection
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import Pose, Quantity
from dualarm_cli.files.source.quantities import Dimension
from dualarm_cli.files.source.short_forms import OneOrMore, ShortForm
from dualarm_cli.files.tasks.schema_tasks import EachSection, VariedTime
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.dwell import TimeRange
from dualarm_cli.schemas.kinds_of_files import INPUT_FILES
from dualarm_cli.schemas.result_fields import REPORT, RESULTS, SCHEDULE, member_rows
from dualarm_cli.verification.measuring.criteria import CRITERIA, Criterion

FOLDER = Path(__file__).parent / "reference"
ALSO = {"robot": PairSection, "base": Pose, "each": EachSection}
"""Mappings that a key takes besides text, where its type tells neither."""
METHODS = ("--platform", "--redundancy", "--timing", "--method")
"""Options that take the name of a method."""
CHECKS_OF = {
    "Files and budget": "`dualarm verify` has these rows of a file, and of a task file with a budget.",
    "Recorded motion": "`dualarm verify LOG --plan PLAN` has these rows, and `position`, `velocity`, `acceleration` "
    "and `collisions` of the recorded motion.",
}
"""Sentences under headings of checks."""
PAGES = (
    *("tasks", "cell", "robot", "study", "points", "base", "schedule", "report", "documents"),
    *("commands", "solvers", "checks", "errors", "python"),
)
"""Pages of the reference in the order of the menu."""
NOTE = "<!-- Written by docs/generate_reference.py: change the code, not this page. -->\n"


def pages() -> dict[str, str]:
    """Returns the text of every page of the reference by its file name."""
    files = {
        "tasks": ("Task file", "What the arms do: tasks, their order and their mode."),
        "cell": ("Cell file", "What is in the cell: robot, tools, frames, parts, obstacles."),
        "robot": ("Robot file", "What the URDF does not say of a robot."),
        "study": ("Study file", "What a layout study changes, and what it compares."),
        "points": ("Points file", "Points that both robots have touched."),
        "base": ("Base file", "Pose of a robot's base: `dualarm calibrate` writes it."),
    }
    return {
        "index.md": _index(),
        **{f"{name}.md": _file_page(INPUT_FILES[name](), *page) for name, page in files.items()},
        "schedule.md": _schedule_page(),
        "report.md": _report_page(),
        "documents.md": _documents_page(),
        "commands.md": _commands_page(),
        "solvers.md": _solvers_page(),
        "checks.md": _checks_page(),
        "errors.md": _errors_page(),
        "python.md": _python_page(),
    }


def _index() -> str:
    return _joined(
        "# Reference",
        "Every key, member, option, method and error code. The pages are written from the code.",
        "\n".join(
            [
                "| page | what is in it |",
                "| --- | --- |",
                "| [tasks](tasks.md), [cell](cell.md), [robot](robot.md) | the files that describe a job |",
                "| [study](study.md), [points](points.md), [base](base.md) | files of layout studies and calibration |",
                "| [schedule](schedule.md), [report](report.md) | the files that a plan writes |",
                "| [documents](documents.md) | what `compare`, `robot reach`, `sweep` and `why` print with `--json` |",
                "| [commands](commands.md) | commands, options, exit codes |",
                "| [solvers](solvers.md) | the methods by family |",
                "| [checks](checks.md) | what `dualarm verify` measures |",
                "| [errors](errors.md) | error codes: causes and remedies |",
                "| [python](python.md) | what can be called from Python |",
            ]
        ),
        "## Quantities",
        "A plain number is in the first unit of its quantity; text names its unit: `80 mm`, `30 deg`, `80%`. "
        "A plain number beyond the last column is refused, as its writer meant another unit: `150` for a length is "
        "150 m. Some keys have a lower limit, which their page names; with its unit any size is read.",
        "\n".join(
            ["| quantity | units | plain number |", "| --- | --- | --- |"]
            + [
                f"| {dimension.name} | {', '.join(f'`{unit}`' for unit in dimension.units if unit)} "
                f"| {_plain(dimension.plain)} |"
                for dimension in vars(quantities).values()
                if isinstance(dimension, Dimension)
            ]
        ),
        "\n".join(["```{toctree}", ":hidden:", "", *PAGES, "```"]),
    )


def _joined(*parts: str) -> str:
    return NOTE + "\n" + "\n\n".join(part.strip("\n") for part in parts if part) + "\n"


def _cell(text: str) -> str:
    """Returns text for a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


# Input files


def _file_page(root: type[BaseModel], title: str, what: str) -> str:
    """Returns the page of one file format: a table of keys for the file and for each mapping in it."""
    sections = _sections(root)
    parts = [f"# {title}", what]
    parts.append("`dualarm check FILE` reports everything wrong with a file at once.")
    for section, path in sections.items():
        parts.append(f"## {_heading(section, path)}")
        parts.append(" ".join((section.__doc__ or "").split()))
        parts.append(_table(section, sections))
    return _joined(*parts)


def _heading(section: type[BaseModel], path: str) -> str:
    return f"`{path}`" if path else "The file"


def _sections(root: type[BaseModel]) -> dict[type[BaseModel], str]:
    """Returns the mappings of a file with the path of keys at which each is met first, the file itself first."""
    found: dict[type[BaseModel], str] = {root: ""}
    todo = [root]
    while todo:
        section = todo.pop(0)
        for name, field in section.model_fields.items():
            key = field.alias or name
            also = ALSO.get(key) if field.annotation is Any else None
            for inner, ending in _models(also or field.annotation):
                if inner not in found:
                    path = f"{found[section]}.{key}" if found[section] else key
                    found[inner] = path + ending
                    todo.append(inner)
    return found


def _models(annotation: Any, ending: str = "") -> Iterator[tuple[type[BaseModel], str]]:
    """Iterates over the mappings that a type names, each with what its path gets: `[]` in lists, `.<name>` by name."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, ending
        return
    origin = get_origin(annotation)
    inner = get_args(annotation)
    if origin is Annotated:
        inner = inner[:1]
    if origin is list:
        ending += "[]"
    if origin is dict:
        ending, inner = f"{ending}.<name>", inner[1:]
    for argument in inner:
        yield from _models(argument, ending)


def _table(section: type[BaseModel], sections: dict[type[BaseModel], str]) -> str:
    rows = ["| key | takes | default | meaning |", "| --- | --- | --- | --- |"]
    for name, field in section.model_fields.items():
        key = field.alias or name
        takes = _takes(_whole(field), sections)
        if field.annotation is Any and key in ALSO:
            takes = f"text or {_takes(ALSO[key], sections)}"
        rows.append(
            f"| `{key}` | {_cell(takes)} | {_default(field)} | {_cell(field.description or '')} |"
        )
    return "\n".join(rows)


def _whole(field: FieldInfo) -> Any:
    """Returns a field's type with its metadata."""
    found: Any = field.annotation
    for metadata in field.metadata:
        found = Annotated[found, metadata]
    return found


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value is PydanticUndefined:
        return ""
    if isinstance(value, BaseModel):
        given = value.model_dump(exclude_unset=True)
        short = [note.key for note in field.metadata if isinstance(note, ShortForm)]
        if not given or short != list(given):
            return f"`{given}`" if given else ""
        [value] = given.values()
    if isinstance(value, TimeRange):
        value = value.nominal
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, float):
        return f"`{_number(value)}`"
    return f"`{value}`" if value not in ([], {}, "") else ""


def _takes(annotation: Any, sections: dict[type[BaseModel], str]) -> str:
    """Returns in words what a type accepts."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        anchor = _anchor(_heading(annotation, sections[annotation]))
        return f"[mapping](#{anchor})"
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _annotated(inner[0], inner[1:], sections)
    if origin is Literal:
        return ", ".join(f"`{str(v).lower() if v is True else v}`" for v in inner)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_takes(part, sections) for part in inner if part is not type(None))
    if origin is list:
        return f"list of {_takes(inner[0], sections)}"
    if origin is dict:
        return f"by name: {_takes(inner[1], sections)}"
    names = {str: "text", bool: "true or false", int: "whole number", float: "number"}
    return names.get(annotation, "[quantity](index.md#quantities)")


def _annotated(annotation: Any, notes: Iterable[Any], sections: dict[type[BaseModel], str]) -> str:
    """Returns in words what a type with notes accepts: a quantity, a short form, a range, or entries of a list."""
    flat = [part for note in notes for part in getattr(note, "metadata", [note])]
    for note in flat:
        if isinstance(note, Quantity):
            plain = f"; {_plain(note.plain)} without a unit" if math.isfinite(note.plain) else ""
            return _quantity(note.dimension) + _range(note.low, note.high) + plain
        if isinstance(note, VariedTime):
            return f"{_quantity(quantities.TIME)}, at least 0, or list of 3"
    takes = _takes(annotation, sections)
    for note in flat:
        if isinstance(note, ShortForm):
            short = _takes(_whole(annotation.model_fields[note.key]), sections)
            return f"{short}{',' * (', ' in short)} or {takes}"
        if isinstance(note, OneOrMore):
            return f"text or {takes}"
    bounds = {
        name: getattr(note, name)
        for note in flat
        for name in ("ge", "le", "min_length", "max_length")
        if hasattr(note, name)
    }
    if annotation is int:
        return takes + _range(bounds.get("ge", -math.inf), bounds.get("le", math.inf))
    least, most = bounds.get("min_length"), bounds.get("max_length")
    if get_origin(annotation) is list and least == most and least is not None:
        return takes.replace("list of ", f"list of {least} × ", 1)
    return takes


def _quantity(dimension: Dimension) -> str:
    return f"[{dimension.name}](index.md#quantities)" if any(dimension.units) else dimension.name


def _range(low: float, high: float) -> str:
    """Returns the values that are allowed, empty where all are; tiny bounds mean above 0."""
    bounds = []
    if low > -math.inf:
        bounds.append("above 0" if 0.0 < low < 1e-3 else f"at least {_number(low)}")
    if high < math.inf:
        bounds.append(f"at most {_number(high)}")
    return "".join(f", {bound}" for bound in bounds)


def _plain(limit: float) -> str:
    """Returns how far a plain number may be from zero; empty where it may be anything."""
    return f"at most {_number(limit)}" if math.isfinite(limit) else ""


def _number(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else f"{value:g}"


def _anchor(heading: str) -> str:
    """Returns the anchor of a heading, as code hosts and MyST make it."""
    kept = "".join(c for c in heading.lower() if c.isalnum() or c in " -_")
    return kept.replace(" ", "-")


# Results


def _members(fields: dict[str, tuple[str, str]]) -> str:
    rows = ["| member | unit | meaning |", "| --- | --- | --- |"]
    rows += [f"| `{name}` | {unit} | {_cell(text)} |" for name, (unit, text) in fields.items()]
    return "\n".join(rows)


def _schedule_page() -> str:
    return _joined(
        "# Schedule",
        "`schedule.json` is the plan without loss; `schedule.csv`, `events.csv` and `targets.csv` are tables of it; "
        "`robot.urdf` is the cell with the robot that it moves. "
        "`<name>` stands for a name, `[]` for each entry of a list.",
        "## `schedule.json`",
        "Joints that are timed together are a group with knots of its own. Between two knots the jerk of every joint "
        "is constant. From a knot at time `t0` to the next one at `t1`, with `h = t1 - t0`, acceleration goes linearly "
        "from `a0` to `a1`; velocity and position follow:",
        "```\nv1 = v0 + h * ((a0 + a1) / 2)\nq1 = q0 + (h * v0 + h**2 * ((a0 + a0 + a1) / 6))\n```",
        "They are stated at the anchors, of which the first knot is one, and followed from each anchor to the knot "
        "before the next. In double precision, in this order, this gives the planner's own numbers to the last bit. "
        "Two knots at one time are a jump of acceleration. A group stands after its last knot.",
        _members(SCHEDULE),
        "## `schedule.csv`",
        "A row for each sample at `--rate`, all steps alike; the last row is the first one that is not before the end. "
        "The first column is `time` [s]; then each joint has `<joint>_position`, `<joint>_velocity` and "
        "`<joint>_acceleration` [rad, rad/s, rad/s²; m for joints that slide], or what `--columns` names. Numbers have "
        "9, 7 and 5 digits after the point.",
        "## `events.csv`",
        "A row for each event: `time` and `dwell` [s], `arm`, `task`, `action`, `stage` (from 1, empty where the event "
        "is in none), `signal`, `frame`, and the pose of this frame in the world: `x`, `y`, `z` [m] and the quaternion "
        "`qx`, `qy`, `qz`, `qw`; then `grasp` and `width` [m], empty where none is known.",
        "## `targets.csv`",
        "For robot programs: up to three rows for each event, whose `point` is `approach` (where the line to it "
        "begins), `target`, or `retract` (where the line from it ends). Each has `stage`, `time`, `arm`, `task`, "
        "`action`, the tool's pose as in `events.csv`, the platform's joints by their names, and the arm's joints as "
        "`j1`, `j2`, … [rad; m].",
        "## `robot.urdf`",
        "Exactly the joints of the schedule move. Tools, `left_tcp` and `right_tcp`, and obstacles are links "
        "fixed to flanges and to the root link. A mesh is its convex hull, in `mesh_*.stl` beside the file. "
        "A half-space is a plate of 6 m. Changed tools and carried parts are left out.",
    )


def _report_page() -> str:
    return _joined(
        "# Report",
        "## The numbers to read first",
        "- `cycle_time` is the length of the motion in s; if `closes` is true, the motion repeats with this period.\n"
        "- `lower_bound` is a time in s that no plan of these stages beats; `gap` is the rest as a share of the cycle. "
        "A gap is no promise that a faster plan exists.\n"
        "- `smallest_clearance` is the proven distance of the bodies that are nearest to their required clearance. "
        "Near links of one arm count only if they lack clearance; `near_links` has theirs.\n"
        "- `skew` says how late either arm may start before clearance is lost.\n"
        "- `arms.<arm>.utilisation` is the busy share of an arm; `waits[]` has each wait with its reason.\n"
        "- `stages[].bottleneck` is the joint that decides how long it takes; `sensitivity[]` is the cycle time "
        "with an assumed limit 10 % lower or higher.\n"
        "- `verification.passed` is the verdict; read `verification.caveats` and `assumed` with it.",
        "## All members",
        "`report.json` holds what the terminal shows, and more. `<name>` stands for a name, `[]` for each entry of a "
        "list.",
        _members(REPORT),
    )


def _documents_page() -> str:
    """Returns the page of documents that commands print and functions return."""
    parts = [
        "# Documents of comparisons, reach and studies",
        "Commands print them with `--json`; functions of the [Python interface](python.md) return them, with types. "
        "SI units, except for parameters with units of their own. `<name>` stands for a name, `[]` for each entry of "
        "a list.",
    ]
    for kind, (description, members) in RESULTS.items():
        if kind not in ("schedule", "report"):
            parts += [f"## `{kind}`", description, _members(dict(member_rows(members, "")))]
    return _joined(*parts)


# Commands


def _commands_page() -> str:
    parts = [
        "# Commands",
        "Results go to standard output, messages and progress to standard error. `--json` prints one document.",
        "## Exit codes",
        "\n".join(
            [
                "| code | meaning |",
                "| --- | --- |",
                "| 0 | good |",
                "| 1 | it ran and found a violation, a regression or a missed budget |",
                "| 2 | wrong input or usage |",
                "| 3 | no feasible plan |",
                "| 4 | internal error |",
                "| 130, 143 | ended by Ctrl-C or by SIGTERM |",
            ]
        ),
    ]
    for path, command in _commands(typer.main.get_command(command_line()), "dualarm"):
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
        usage = " ".join([path, *map(_argument, arguments)])
        parts += [
            f"## `{path}`",
            f"`{usage} [OPTIONS]`",
            " ".join((command.help or "").split()),
        ]
        rows = [
            f"| `{p.name.upper()}` | | | {_cell(getattr(p, 'help', '') or '')} |" for p in arguments
        ]
        for option in options:
            names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
            cells = (names, _option_takes(option), _option_default(option), option.help or "")
            rows.append(f"| {' | '.join(map(_cell, cells))} |")
        if rows:
            head = [
                "| argument or option | takes | default | meaning |",
                "| --- | --- | --- | --- |",
            ]
            parts.append("\n".join([*head, *rows]))
        name = path.removeprefix("dualarm ")
        lines = [f"{path} {words}".rstrip() for words in EXAMPLES[name].split("; ")]
        parts.append("\n".join(["```", *lines, "```"]))
    return _joined(*parts)


def _argument(argument: Any) -> str:
    name = f"{argument.name.upper()}{'…' if argument.nargs != 1 else ''}"
    return name if argument.required else f"[{name}]"


def _commands(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Iterates over the commands, those of groups with the group's name."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield path, command
        return
    for name, one in inner.items():
        yield from _commands(one, f"{path} {name}")


def _option_takes(option: Any) -> str:
    """Returns in words what an option takes; nothing for a flag."""
    if option.is_flag or option.count:
        return ""
    if set(option.opts) & set(METHODS):
        takes = "[method](solvers.md)"
    elif option.metavar:
        takes = f"`{option.metavar}`"
    else:
        kinds = [_kind(one) for one in _parts(option.type_descriptor.annotation)]
        takes = kinds[0] + _range(
            -math.inf if option.min is None else option.min,
            math.inf if option.max is None else option.max,
        )
    return takes


def _parts(annotation: Any) -> list[Any]:
    """Returns the types that an option's annotation names, none for none."""
    inner = [part for part in get_args(annotation) if part is not type(None)]
    return [found for part in inner for found in _parts(part)] or [annotation]


def _kind(kind: type) -> str:
    if issubclass(kind, Enum):
        return ", ".join(f"`{one.value}`" for one in kind)
    return {int: "whole number", float: "number", Path: "path"}.get(kind, "text")


def _option_default(option: Any) -> str:
    if option.count:
        return ""
    value = option.show_default if isinstance(option.show_default, str) else option.default
    if value is None or isinstance(value, bool) or callable(value) or value in ((), [], ""):
        return ""
    value = getattr(value, "value", value)
    return value if " " in str(value) and value is option.show_default else f"`{value}`"


# Methods, codes, Python


def _solvers_page() -> str:
    parts = [
        "# Solvers",
        "The methods by family; the first of each family is the default. `dualarm compare solvers TASKS.yaml` tells "
        "which wins on a cell.",
    ]
    for family in families():
        dashes = "" if family.option.endswith(":") else "--"
        parts.append(f"## {family.family.capitalize()} (`{dashes}{family.option}`)")
        rows = ["| name | what it does | reference |", "| --- | --- | --- |"]
        rows += [f"| `{s.name}` | {_cell(s.summary)} | {_cell(s.reference)} |" for s in family]
        parts.append("\n".join(rows))
    return _joined(*parts)


def _checks_page() -> str:
    parts = [
        "# Checks",
        "`dualarm verify` prints a row for each check; `schedule.json` and `report.json` have them too. "
        "A check passes if its measure is at most the allowed value. Joints that slide have m in place "
        "of rad. Most tolerances are those of rounding; `dualarm_cli/verification/measuring/tolerances.py` lists "
        "all of them.",
        "A check that is not made has the verdict `not checked`, and its row says why; the table has the usual reason. "
        "Checks that compare with tasks, and all of kinds of work, need the task file (`--tasks`).",
    ]
    for heading, table in CRITERIA.items():
        parts += [f"## {heading}", CHECKS_OF.get(heading, ""), _criteria(table)]
    kinds = {name: row for kind in of_kinds("checks") for name, row in kind.criteria.items()}
    parts += [
        "## Kinds of work",
        "Rows of conveyors are listed where targets move.",
        _criteria(kinds),
    ]
    return _joined(*parts)


def _criteria(table: Mapping[str, Criterion]) -> str:
    rows = ["| check | measure | unit | not checked when |", "| --- | --- | --- | --- |"]
    for name, one in table.items():
        rows.append(
            f"| `{name}` | {_cell(one.measure)} | {one.unit or 'count'} | {_cell(one.unchecked)} |"
        )
    return "\n".join(rows)


def _errors_page() -> str:
    parts = [
        "# Error codes",
        "A message names its code; `dualarm explain CODE` prints what is here.",
        "\n".join(
            _bullets(
                f"[{code}](#{code.lower()}): {one.title}" for code, one in explanations().items()
            )
        ),
    ]
    for code, one in explanations().items():
        parts += [f"## {code}", f"{one.title}.", "Why:", "\n".join(_bullets(one.causes))]
        parts += ["What to do:", "\n".join(_bullets(one.remedies))]
        if one.example:
            parts.append(f"Example: `` {one.example} ``")
        if one.page:
            target = (
                one.page.removeprefix("reference/")
                if one.page.startswith("reference/")
                else f"../{one.page}"
            )
            parts.append(f"More: [{one.page.removesuffix('.md')}]({target}).")
    return _joined(*parts)


def _bullets(sentences: Iterable[str]) -> list[str]:
    return [f"- {sentence}" for sentence in sentences]


def _python_page() -> str:
    public = [(name, getattr(dualarm_cli, name)) for name in dualarm_cli.__all__]
    functions = [(name, value) for name, value in public if inspect.isfunction(value)]
    classes = [(name, value) for name, value in public if inspect.isclass(value)]
    errors = [(name, value) for name, value in classes if issubclass(value, Exception)]
    data = [(name, value) for name, value in classes if not issubclass(value, Exception)]
    parts = [
        "# Python",
        "These names of `dualarm_cli` are public: a version that changes them says so in the changelog. All numbers "
        "are in SI units and radians. Everything else may change with any version. [From Python](../how-to/python.md) "
        "shows how they are used.",
        "## Functions",
    ]
    for name, value in functions:
        parts += [f"### `{name}`", f"```\n{name}{_signature(value)}\n```", _docstring(value)]
    parts.append("## Data")
    for name, value in data:
        parts += [f"### `{name}`", _docstring(value)]
        rows = [
            f"| `{_cell(text)}` | {_cell(meaning)} |" for text, meaning in _python_members(value)
        ]
        if rows:
            parts.append("\n".join(["| member | meaning |", "| --- | --- |", *rows]))
    parts.append("## Errors")
    rows = [f"| `{name}` | {_summary(value)} |" for name, value in errors]
    parts.append("\n".join(["| error | meaning |", "| --- | --- |", *rows]))
    return _joined(*parts)


def _signature(function: Callable[..., Any]) -> str:
    """Returns a function's parameters, one a line."""
    found = inspect.signature(function, eval_str=False)
    rows = [f"    {parameter}," for parameter in map(str, found.parameters.values())]
    star = next(
        (k for k, one in enumerate(found.parameters.values()) if one.kind is one.KEYWORD_ONLY), None
    )
    if star is not None:
        rows.insert(star, "    *,")
    return "\n".join(["(", *rows, f") -> {found.return_annotation}"]).replace("'", "")


def _docstring(value: object) -> str:
    """Returns a docstring whose sections are lists."""
    lines: list[str] = []
    for line in (inspect.getdoc(value) or "").splitlines():
        if line in ("Args:", "Raises:"):
            lines += ["", f"*{line[:-1]}*", ""]
        elif line.startswith("    ") and not line.startswith("        "):
            name, _, meaning = line.strip().partition(": ")
            lines.append(f"- `{name}`: {meaning}")
        else:
            lines.append(f"  {line.strip()}" if line.startswith("        ") else line)
    return "\n".join(lines).replace("\n\n\n", "\n\n").strip()


def _summary(value: object) -> str:
    """Returns the first sentence or line of a docstring."""
    return " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())


def _python_members(owner: type) -> Iterator[tuple[str, str]]:
    """Yield each public field, property and method with its types, and its meaning."""
    tree = ast.parse(inspect.getsource(owner)).body[0]
    assert isinstance(tree, ast.ClassDef)
    for node, following in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            told = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            meaning = str(following.value.value) if told else ""
            if not node.target.id.startswith("_") and not typing.is_typeddict(owner):
                name = f"{node.target.id}: {ast.unparse(node.annotation)}"
                yield name, inspect.cleandoc(meaning).split("\n\n")[0]
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            member = inspect.getattr_static(owner, node.name)
            returned = ast.unparse(node.returns) if node.returns else "None"
            if isinstance(member, property | cached_property):
                yield f"{node.name}: {returned}", _summary(member)
            else:
                node.args.args = node.args.args[1:]
                taken = ast.unparse(node.args).replace("=", " = ")
                yield f"{node.name}({taken}) -> {returned}", _summary(member)


def write(folder: Path) -> None:
    """Writes all pages.

    Args:
        folder: where.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(FOLDER)
