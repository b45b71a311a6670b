"""Evaluation requests of a study's points: files with replaced values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dualarm_cli.errors import Diagnostic, InputError, UnknownSolverError
from dualarm_cli.evaluation.request import Request
from dualarm_cli.files.source.amounts import read_amount, scaled, shifted
from dualarm_cli.files.source.overrides import Override
from dualarm_cli.files.source.quantities import QuantityError
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.studies.study import Amount, Level, Parameter, Point, Study, Target


def check_settings(study: Study) -> None:
    """Check that every method named in the study's settings exists.

    Raises:
        InputError: an unknown name, at its place in the study file.
    """
    named = [key for key in ("platform", "timing", "redundancy") if key in study.settings]
    if not named:
        return
    # Loading all methods takes a second, which a study of stored plans does not need.
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.planning.redundancy_choice import with_redundancy
    from dualarm_cli.stages.methods import METHODS
    from dualarm_cli.timing import TIMING_SOLVERS

    checks: dict[str, Callable[[str], object]] = {
        "platform": lambda name: METHODS[name],
        "timing": lambda name: TIMING_SOLVERS[name],
        "redundancy": lambda name: with_redundancy(PlanSettings(), name),
    }
    wrong = []
    for key in named:
        try:
            checks[key](str(study.settings[key]))
        except UnknownSolverError as error:
            place = study.setting_places[key]
            wrong.append(Diagnostic(place.file, place.line, place.column, "E200", error.reason))
    if wrong:
        raise InputError(wrong)


def reference_requests(study: Study) -> list[Request]:
    """Build the requests of the unchanged files, one per task file."""
    return [_request(study, k, {}) for k in range(len(study.tasks))]


def point_requests(study: Study, point: Point) -> list[Request]:
    """Build the requests of a point, one per task file.

    A value equal to the file's is not replaced, so that the unchanged files are planned once.
    """
    requests = []
    for k in range(len(study.tasks)):
        overrides: dict[str, Any] = {}
        for parameter, level in zip(study.parameters, point, strict=True):
            for target in parameter.targets:
                value = new_value(target, k, level)
                if not _same(target.present[k], value):
                    overrides[target.keys[k]] = value
        requests.append(_request(study, k, overrides))
    return requests


def _request(study: Study, k: int, overrides: dict[str, Any]) -> Request:
    settings: dict[str, Any] = dict(study.settings)
    tasks = study.tasks[k]
    return Request.of(tasks.path, tasks.name, overrides=overrides, **settings)


def new_value(target: Target, job: int, level: Level) -> float | str | bool:
    """Compute the value that replaces a file's.

    Args:
        target: place of the value.
        job: number of the task file.
        level: value of the parameter.
    """
    present = target.present[job]
    if not isinstance(level, Amount):
        return level
    if target.apply == "set" or not isinstance(present, Amount):
        return level.written
    return (shifted if target.apply == "shift" else scaled)(present, level).written


def _same(present: Level | None, value: float | str | bool) -> bool:
    """Test whether a value equals the file's, in any unit."""
    if not isinstance(present, Amount):
        return type(present) is type(value) and present == value
    if isinstance(value, bool):
        return False
    try:
        return read_amount(value).si == present.si
    except QuantityError:
        return False


def input_problems(study: Study, point: Point) -> list[Diagnostic]:
    """List a point's input errors, those of parameter values in the study file.

    Args:
        study: the study.
        point: one with the status `bad_input`.
    """
    problems: list[Diagnostic] = []
    for k, request in enumerate(point_requests(study, point)):
        causes = {
            target.keys[k]: parameter
            for parameter in study.parameters
            for target in parameter.targets
        }
        overrides = {
            key: Override(value, f"parameter {quote(causes[key].name)}", _at(causes[key]))
            for key, value in request.overrides.items()
        }
        try:
            load_job(request.path, request.case, overrides)
        except InputError as error:
            problems += [d for d in error.diagnostics if d not in problems]
    return problems


def _at(parameter: Parameter) -> Diagnostic:
    place = parameter.place
    return Diagnostic(place.file, place.line, place.column, "E300", "")
