"""Reader of study files."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.robots import find_robot
from dualarm_cli.files.source.amounts import in_unit, one_unit, read_amount, scaled, shifted
from dualarm_cli.files.source.bundled import STUDY_FILE, bundled_tasks, task_file
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import read_document, validate
from dualarm_cli.files.source.projects import (
    BadReferenceError,
    Project,
    display_name,
    noted,
)
from dualarm_cli.files.source.quantities import QuantityError
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.value_paths import PathError, find_value, to_pointer, value_at
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.studies.schema_study import (
    MOST_LEVELS,
    ParameterSection,
    RangeSection,
    StudyFile,
    StudyTargetSection,
)
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.place import Place
from dualarm_cli.model.studies.study import (
    OBJECTIVES,
    Amount,
    Apply,
    Level,
    Parameter,
    Sampling,
    Span,
    Study,
    StudyTasks,
    Target,
    tidy,
)

_MUST_BE_THERE = "; a varied value must be in the file, even at its default"
_OF_THE_URDF = (".velocity", ".position", ".lower", ".upper")
_PAIR = ("robot.left", "robot.right")


class StudyTargetReader:
    """Search for the values of target paths in the files of all jobs; collects every error."""

    def __init__(
        self, document: Document, jobs: list[dict[str, Document]], findings: Findings
    ) -> None:
        """Store the study file, the documents of its jobs, and the list of errors."""
        self._document, self._jobs, self._findings = document, jobs, findings
        self._taken: dict[tuple[int, str], tuple[str, int]] = {}

    def read(
        self,
        section: ParameterSection,
        loc: Loc,
        name: str,
        values: tuple[tuple[Level, ...], Span | None],
    ) -> tuple[Target, ...]:
        """Read a parameter's targets, without the faulty ones.

        Args:
            section: the parameter.
            loc: its place.
            name: its name.
            values: its values, or its span.
        """
        entries: list[tuple[StudyTargetSection, Loc]]
        if section.targets is None:
            entries = [(section, loc)]
        else:
            entries = [(entry, (*loc, "targets", k)) for k, entry in enumerate(section.targets)]
        targets = []
        for entry, place in entries:
            role, path = entry.given()[0]
            apply: Apply = entry.apply or section.apply or "set"
            targets += self._target(role, path, apply, (*place, role), name, values)
        return tuple(targets)

    def _target(
        self,
        role: str,
        path: str,
        apply: Apply,
        loc: Loc,
        name: str,
        values: tuple[tuple[Level, ...], Span | None],
    ) -> list[Target]:
        """Read a target; for a pair of robots one target each."""
        roles = [role]
        if role == "robot" and any(pair in job for job in self._jobs for pair in _PAIR):
            roles = list(_PAIR)
        targets = []
        for file_role in roles:
            keys, amounts = [], []
            for k, job in enumerate(self._jobs):
                place = self._place(job, file_role, path, loc)
                if place is None:
                    continue
                document = job[file_role]
                key = f"{file_role}:{to_pointer(place)}"
                self._claim(k, key, name, loc)
                value = value_at(document.data, place)
                keys.append(key)
                amounts.append(self._amount(value, apply, document, place, loc))
            if len(keys) == len(self._jobs) and self._fits(apply, amounts, values, loc):
                targets.append(Target(file_role, path, apply, tuple(keys), tuple(amounts)))
        return targets

    def _place(self, job: dict[str, Document], role: str, path: str, loc: Loc) -> Loc | None:
        """Find a path in a job's file, or None after noting an error."""
        document = job.get(role)
        if document is None:
            files = ", ".join(job)
            message = (
                f"{job['tasks'].source.name} has no file {quote(role)}; its files are: {files}"
            )
            self._findings.add(self._document, loc, message, key=True)
            return None
        try:
            return find_value(document.data, path, document.source.name)
        except PathError as error:
            # A missing key has a default, which the file shall show if a study varies it.
            hint = "" if error.guessed else _MUST_BE_THERE
            if role.startswith("robot") and path.endswith(_OF_THE_URDF):
                hint = "; position and velocity limits are the URDF's, and cannot be varied"
            self._findings.add(self._document, loc, f"{error}{hint * error.lacks}")
            return None

    def _claim(self, job: int, key: str, name: str, loc: Loc) -> None:
        """Note a value that two parameters change."""
        line = self._document.place(loc)[0]
        first = self._taken.setdefault((job, key), (name, line))
        if first != (name, line):
            message = f"parameter {quote(first[0])} changes the same value, at line {first[1]}"
            self._findings.add(self._document, loc, message)

    def _amount(
        self, value: object, apply: Apply, document: Document, place: Loc, loc: Loc
    ) -> Level | None:
        """Read a file's value, as a number if it is one.

        None after noting that a number is required.
        """
        try:
            return read_amount(value)
        except QuantityError:
            if apply == "set":
                return value if isinstance(value, str | bool) else None
        line, column = document.place(place)
        where = f"{document.source.name}:{line}:{column}"
        done = {"shift": "moved", "scale": "scaled"}[apply]
        message = f"only a number can be {done}, not {quote(value)} ({where}); write `apply: set`"
        self._findings.add(self._document, loc, message)
        return None

    def _fits(
        self,
        apply: Apply,
        amounts: list[Level | None],
        values: tuple[tuple[Level, ...], Span | None],
        loc: Loc,
    ) -> bool:
        """Check that the parameter's values can be applied to the values of the files."""
        levels, span = values
        examples = [span.low] if span is not None else list(levels[:1])
        if not examples:
            return False  # the values are wrong, which has been noted
        level = examples[0]
        for amount in amounts:
            try:
                if not isinstance(level, Amount):
                    if apply != "set":
                        raise QuantityError(f"{quote(level)} cannot {apply} a number")
                elif isinstance(amount, Amount) and apply == "set":
                    in_unit(level, amount)
                elif isinstance(amount, Amount):
                    shifted(amount, level) if apply == "shift" else scaled(amount, level)
                elif apply != "set":
                    return False
            except QuantityError as error:
                self._findings.add(self._document, loc, str(error))
                return False
        return True


class LevelReader:
    """Reader of the values of parameters; collects every error."""

    def __init__(self, document: Document, findings: Findings) -> None:
        """Store the study file and the list of errors."""
        self._document, self._findings = document, findings

    def read(self, section: ParameterSection, loc: Loc) -> tuple[tuple[Level, ...], Span | None]:
        """Read a parameter's values, or its span if it has no steps; neither after an error.

        Args:
            section: the parameter.
            loc: its place.
        """
        if section.range is not None:
            return self._range(section.range, (*loc, "range"))
        return self._values(section.values or [], (*loc, "values")), None

    def _values(self, values: list[Any], loc: Loc) -> tuple[Level, ...]:
        """Read listed values: numbers of one unit, words, or booleans."""
        amounts: list[Amount] = []
        problems: list[tuple[int, str]] = []
        for k, value in enumerate(values):
            if isinstance(value, dict | list) or value is None:
                message = f"must be a number, text, true or false, not {quote(value)}"
                self._findings.add(self._document, (*loc, k), message, "E200")
                return ()
            try:
                amounts.append(read_amount(value))
            except QuantityError as error:
                problems.append((k, str(error)))
        levels: list[Level]
        if not problems:
            levels = list(self._same_unit(amounts, [(*loc, k) for k in range(len(values))]))
        elif amounts:
            k, message = problems[0]
            self._findings.add(
                self._document, (*loc, k), f"{message}; the others are numbers", "E200"
            )
            return ()
        else:
            levels = list(values)
        for k, level in enumerate(levels):
            # True differs from 1: a boolean is not an Amount.
            if level in levels[:k]:
                self._findings.add(
                    self._document, (*loc, k), f"{quote(values[k])} is listed twice", "E102"
                )
        return tuple(levels)

    def _range(self, section: RangeSection, loc: Loc) -> tuple[tuple[Level, ...], Span | None]:
        given = {"from": section.from_, "to": section.to}
        if section.step is not None:
            given["step"] = section.step
        amounts = []
        for key, value in given.items():
            try:
                amounts.append(read_amount(value))
            except QuantityError as error:
                self._findings.add(self._document, (*loc, key), str(error), "E200")
        if len(amounts) < len(given):
            return (), None
        amounts = self._same_unit(amounts, [(*loc, key) for key in given])
        if not amounts:
            return (), None
        low, high = amounts[:2]
        if not low.number < high.number:
            message = f"must be above 'from' ({quote(section.from_)}), not {quote(section.to)}"
            self._findings.add(self._document, (*loc, "to"), message, "E200")
            return (), None
        if section.step is not None:
            return self._steps(low, high, amounts[2], (*loc, "step")), None
        if section.count is not None:
            return _evenly(low, high, section.count), None
        return (), Span(low, high)

    def _steps(self, low: Amount, high: Amount, step: Amount, loc: Loc) -> tuple[Level, ...]:
        """Expand a range by its step, in decimal arithmetic."""
        if step.number <= 0.0:
            self._findings.add(self._document, loc, "a step must be above 0", "E200")
            return ()
        first, by, last = (Decimal(repr(a.number)) for a in (low, step, high))
        count = int((last - first) / by) + 1
        if count > MOST_LEVELS:
            message = f"makes {count} values; at most {MOST_LEVELS}: write a longer step"
            self._findings.add(self._document, loc, message, "E200")
            return ()
        end = first + (count - 1) * by
        if end != last:
            ends = Amount(float(end), low.unit).shown
            message = f"steps of {step.shown} from {low.shown} end at {ends}, not at {high.shown}; change step or to"
            self._findings.add(self._document, loc, message, "E200")
            return ()
        whole = all(isinstance(a.number, int) for a in (low, step))
        numbers = [first + k * by for k in range(count)]
        return tuple(_like(low, int(n) if whole else tidy(float(n))) for n in numbers)

    def _same_unit(self, amounts: list[Amount], locs: list[Loc]) -> list[Amount]:
        """Convert amounts to one unit, or return none after noting different dimensions."""
        try:
            return one_unit(amounts)
        except QuantityError as error:
            self._findings.add(self._document, locs[-1], f"dimensions differ: {error}", "E200")
            return []


def _evenly(low: Amount, high: Amount, count: int) -> tuple[Level, ...]:
    """Expand a range to evenly spaced numbers, including both ends.

    The numbers are whole if all inputs allow it.
    """
    span = high.number - low.number
    numbers = [tidy(low.number + span * k / (count - 1)) for k in range(count)]
    whole = isinstance(low.number, int) and all(number.is_integer() for number in numbers)
    return tuple(_like(low, int(n) if whole else n) for n in numbers)


def _like(amount: Amount, number: float) -> Amount:
    return Amount(number, amount.unit, amount.factor, amount.base)


def job_documents(project: Project, path: Path, name: str) -> dict[str, Document]:
    """Read the documents of a job by their roles, without unreadable ones.

    Args:
        project: where the reading is recorded.
        path: the task file.
        name: what the user calls it.

    Raises:
        InputError: the task file cannot be read.
    """
    tasks = read_document(project, path, name, "tasks/1")
    documents = {"tasks": tasks}
    try:
        reference = _text(tasks.data.get("cell"))
        cell_path = project.follow(reference, path)
        cell_name = display_name(reference, name)
        documents["cell"] = cell = read_document(project, cell_path, cell_name, "cell/1")
    except (BadReferenceError, InputError):
        return documents
    robot = cell.data.get("robot")
    if not isinstance(robot, dict):
        _add_robot(documents, "robot", robot, project, cell_path, cell_name)
        return documents
    for side in ("left", "right"):
        member = robot.get(side)
        if not isinstance(member, dict):
            continue
        _add_robot(documents, f"robot.{side}", member.get("robot"), project, cell_path, cell_name)
        if isinstance(member.get("base"), str):
            _add_base(documents, f"base.{side}", member["base"], project, cell_path, cell_name)
    return documents


def _add_robot(
    documents: dict[str, Document], role: str, value: Any, project: Project, cell: Path, name: str
) -> None:
    try:
        place = find_robot(project, _text(value), cell, name)
        documents[role] = read_document(place.project, place.path, place.name, "robot/1", role)
    except (BadReferenceError, InputError):
        return


def _add_base(
    documents: dict[str, Document], role: str, value: str, project: Project, cell: Path, name: str
) -> None:
    try:
        path = project.follow(value, cell)
        documents[role] = read_document(project, path, display_name(value, name), "base/1", role)
    except (BadReferenceError, InputError):
        return


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise BadReferenceError("not the name of a file")
    return value


def load_study(source: str | Path | Mapping[str, Any]) -> Study:
    """Read the study in a study file; its jobs are read too, unchanged.

    Args:
        source: the study file, the name of a bundled job with a study, or the content of a study file.

    Raises:
        InputError: everything wrong with it and the files of its jobs.
    """
    if isinstance(source, Mapping):
        project, path = Project.in_memory(source, "study")
        name = path.name
    else:
        path, name = task_file(source, STUDY_FILE)
        project = Project.of(path)
    document = read_document(project, path, name, "study/1")
    findings = Findings(document.diagnostics)
    model = validate(document, StudyFile, findings)
    if model is None:
        findings.fail()
    tasks = _tasks(project, path, document, model, findings)
    documents = [job_documents(Project.of(job.path), job.path, job.name) for job in tasks]
    readable = not findings.diagnostics
    targets, levels = (
        StudyTargetReader(document, documents, findings),
        LevelReader(document, findings),
    )
    parameters = []
    for parameter, section in model.parameters.items():
        loc: Loc = ("parameters", parameter)
        values, span = levels.read(section, loc)
        # Paths into a job that cannot be read are not reported.
        varied = targets.read(section, loc, parameter, (values, span)) if readable else ()
        place = Place(document.source.name, *document.place(loc, key=True))
        parameters.append(Parameter(parameter, varied, values, span, place))
    _check_sampling(document, model, parameters, findings)
    _check_objectives(document, model, findings)
    findings.raise_if_any()
    settings = {
        key: value for key, value in model.settings.model_dump().items() if value is not None
    }
    places = {
        key: Place(document.source.name, *document.place(("settings", key))) for key in settings
    }
    sample = model.sample
    return Study(
        name,
        tuple(tasks),
        tuple(parameters),
        tuple(OBJECTIVES[name] for name in model.objectives),
        Sampling(sample.method, sample.count, sample.seed) if sample is not None else None,
        settings,
        places,
        dict(sorted(project.inputs.items())),
    )


def _tasks(
    project: Project, path: Path, document: Document, model: StudyFile, findings: Findings
) -> list[StudyTasks]:
    """Read the usable task files, after noting errors of the others."""
    jobs: dict[Path, StudyTasks] = {}
    jobs_by_name = bundled_tasks()
    listed = isinstance(document.data["tasks"], list)
    for k, reference in enumerate(model.tasks):
        loc: Loc = ("tasks", k) if listed else ("tasks",)
        with noted(findings, document, loc):
            if reference in jobs_by_name and not (path.parent / reference).is_file():
                tasks, name = jobs_by_name[reference], reference
            else:
                tasks = project.follow(reference, path)
                name = display_name(reference, document.source.name)
            if tasks.resolve() in jobs:
                findings.add(document, loc, f"{quote(reference)} is named twice", "E102")
                continue
            job = load_job(tasks, name)
            project.inputs.update(job.inputs)
            jobs[tasks.resolve()] = StudyTasks(tasks, name)
    return list(jobs.values())


def _check_sampling(
    document: Document, model: StudyFile, parameters: list[Parameter], findings: Findings
) -> None:
    if model.sample is not None and not any(p.span is not None for p in parameters):
        message = "no range is sampled: every parameter has values, step or count; remove 'sample', or a step or count"
        findings.add(document, ("sample",), message, key=True)


def _check_objectives(document: Document, model: StudyFile, findings: Findings) -> None:
    for k, name in enumerate(model.objectives):
        if name in model.objectives[:k]:
            findings.add(document, ("objectives", k), f"{quote(name)} is named twice", "E102")
