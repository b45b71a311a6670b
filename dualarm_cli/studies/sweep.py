"""Study from file to document: points planned, ranked and explained.

`dualarm sweep` calls the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from os import PathLike
from pathlib import Path
from typing import Any

from dualarm_cli.background import usable_cores
from dualarm_cli.errors import check_type
from dualarm_cli.evaluation import crew
from dualarm_cli.evaluation.store import Store
from dualarm_cli.files.studies.studies import load_study
from dualarm_cli.model.settings import check_count, check_seed
from dualarm_cli.model.studies.study import Point, Study
from dualarm_cli.report.comparisons import StudyReport
from dualarm_cli.studies import search
from dualarm_cli.studies.document import study_document
from dualarm_cli.studies.requests import check_settings
from dualarm_cli.studies.rows import StudyRow


def sweep(
    study: str | Path | Mapping[str, Any],
    *,
    budget: int | None = None,
    seed: int = 0,
    processes: int | None = None,
    cache: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> StudyReport:
    """Plan a cell's tasks over ranges of its parameters, as `dualarm sweep --json`.

    Args:
        study: the study file, the name of a bundled job with a study such as `04_packing`, or the content of a study
            file as a mapping, with paths relative to the working directory. Its `tasks` may be names of bundled jobs.
        budget: maximum number of points of a search for good ones; None for all points of the study.
        seed: seed of the search.
        processes: maximum number of processes; None for one per core.
        cache: folder of finished plans, which are not planned again; None for none.
        progress: callback, called with a text after each point.

    Raises:
        InputError: all faults of the files.
        MissingDependencyError: a search without optuna (extra `optimise`).
        UsageError: a number that is not allowed.
    """
    check_type("study", study, str, PathLike, Mapping)
    check_seed(seed)
    check_count("budget", budget)
    check_count("processes", processes)
    loaded = load_study(study)
    check_settings(loaded)
    points, method = points_of(loaded, budget, seed)
    tell = progress or (lambda _: None)
    with closing(crew.Crew(processes or usable_cores())) as workers:
        desk = search.Desk(workers.run, None if cache is None else Store(Path(cache)))
        desk.tell = lambda state: tell(_progress_text(state))
        rows, reference = evaluated_points(loaded, points, method, desk)
    return study_document(loaded, rows, reference, method)


def _progress_text(state: search.Progress) -> str:
    time = None if state.best is None else state.best.figures["cycle_time"]
    best = "" if time is None else f", best cycle time {time:.3f} s"
    return f"{state.done} of {state.of} points{best}"


def points_of(
    study: Study, budget: int | None, seed: int
) -> tuple[list[Point] | None, dict[str, Any]]:
    """Select the points to plan, None for a search, with the document's method section.

    Args:
        study: the study.
        budget: maximum number of points of a search; None for all points.
        seed: seed of the search.

    Raises:
        MissingDependencyError: a search without optuna.
    """
    if budget is None:
        points, sampling = search.study_points(study), study.sampling
        if sampling is None:
            return points, {"name": "grid"}
        return points, {"name": sampling.method, "count": sampling.count, "seed": sampling.seed}
    search.require_optuna()
    method = {"name": "optimise", "budget": budget, "seed": seed, "batch": search.SEARCH.batch}
    size = search.whole_grid(study)
    if size is not None and size <= budget:
        return search.study_points(study), method | {"whole_grid": True}
    return None, method


def evaluated_points(
    study: Study, points: list[Point] | None, method: dict[str, Any], desk: search.Desk
) -> tuple[list[StudyRow], StudyRow]:
    """Plan all points and the unchanged files; return their rows.

    Args:
        study: the study.
        points: points to plan; None for a search.
        method: the document's method section.
        desk: evaluator.
    """
    reference = desk.reference(study)
    if points is not None:
        return desk.rows(study, points), reference
    total, seed = method["budget"], method["seed"]
    return search.search(study, total, seed, lambda p, r: desk.rows(study, p, r)), reference
