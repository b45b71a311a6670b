"""Study files to studies."""

from __future__ import annotations

from pathlib import Path

from dualarm_cli.errors import InputError
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.documents import read_document, validate
from dualarm_cli.loading.job_documents import job_documents
from dualarm_cli.loading.projects import BadReferenceError, Project, display_name
from dualarm_cli.loading.schema_study import StudyFile
from dualarm_cli.loading.study_levels import LevelReader
from dualarm_cli.loading.study_targets import TargetReader
from dualarm_cli.loading.tasks import load_job
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.yaml_source import Document, Loc
from dualarm_cli.model.place import Place
from dualarm_cli.model.study import OBJECTIVES, Parameter, Sampling, Study, StudyTasks


def load_study(path: str | Path) -> Study:
    """Returns the study that a study file describes; its jobs are read too, as they are.

    Args:
        path: the study file.

    Raises:
        InputError: everything wrong with it and the files of its jobs.
    """
    project = Project.of(Path(path))
    document = read_document(project, Path(path), str(path), "study/1")
    findings = Findings()
    findings.extend(document.diagnostics)
    model = validate(document, StudyFile, findings)
    if model is None:
        findings.raise_if_any()
        raise InputError(findings.diagnostics)
    tasks = _tasks(project, Path(path), document, model, findings)
    documents = [job_documents(project, job.path, job.name) for job in tasks]
    readable = not findings.diagnostics
    targets, levels = TargetReader(document, documents, findings), LevelReader(document, findings)
    parameters = []
    for name, section in model.parameters.items():
        loc: Loc = ("parameters", name)
        values, span = levels.read(section, loc)
        # Where a job cannot be read its paths cannot be blamed.
        found = targets.read(section, loc, name, (values, span)) if readable else ()
        place = Place(document.source.name, *document.place(loc, key=True))
        parameters.append(Parameter(name, found, values, span, place))
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
        str(path),
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
    """Returns the task files that can be found, after noting what is wrong with any of them."""
    found: dict[Path, StudyTasks] = {}
    listed = isinstance(document.data["tasks"], list)
    for k, reference in enumerate(model.tasks):
        loc: Loc = ("tasks", k) if listed else ("tasks",)
        try:
            tasks = project.follow(reference, path)
            name = display_name(reference, document.source.name)
            if tasks.resolve() in found:
                findings.add(document, loc, f"{quote(reference)} is named twice", "E102")
                continue
            job = load_job(tasks, name)
            project.inputs.update(job.inputs)
            found[tasks.resolve()] = StudyTasks(Path(name), name)
        except BadReferenceError as error:
            findings.add(document, loc, str(error), "E500")
        except InputError as error:
            findings.extend(error.diagnostics)
    return list(found.values())


def _check_sampling(
    document: Document, model: StudyFile, parameters: list[Parameter], findings: Findings
) -> None:
    if model.sample is not None and not any(p.span is not None for p in parameters):
        message = "nothing is sampled: every parameter has values or steps; remove 'sample', or a step or count"
        findings.add(document, ("sample",), message, key=True)


def _check_objectives(document: Document, model: StudyFile, findings: Findings) -> None:
    for k, name in enumerate(model.objectives):
        if name in model.objectives[:k]:
            findings.add(document, ("objectives", k), f"{quote(name)} is named twice", "E102")
