"""Objects of the Python interface in notebooks: figures in a table, and a picture."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Iterable
from html import escape
from typing import Any

from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import exceptions
from dualarm_cli.report.report import plan_title, throughput

MOST_TASKS = 30
"""Maximum number of listed tasks."""


def html_of(shown: Any) -> str:
    """Write a job's tasks, or a plan's or schedule's figures, as HTML with a picture.

    Args:
        shown: a job has its cell, a plan throughput and Gantt chart, a schedule curves of the joints' velocities.
    """
    if isinstance(shown, Job):
        return _job_html(shown)
    if isinstance(shown, Schedule):
        return _schedule_html(shown, None)
    return _schedule_html(shown.schedule, shown.job)


def _schedule_html(schedule: Schedule, job: Job | None) -> str:
    judged, bound = schedule.verification, schedule.lower_bound
    rows = {
        "cycle time" if job is None or job.returns else "duration": f"{schedule.duration:.3f} s"
    }
    if job is not None and (rate := throughput(schedule, job)) is not None:
        rows["parts per hour"] = f"{rate:.0f}"
    if bound is not None:
        rows["proven"] = f"no plan of these stages is faster than {bound:.3f} s"
    rows["stages"] = str(len(schedule.stages))
    rows["verification"] = "none" if judged is None else judged.verdict + exceptions(judged.caveats)
    picture = _picture(lambda: _curves(schedule) if job is None else _gantt(schedule, job))
    return f"<b>{escape(plan_title(schedule))}</b>{_table(rows.items())}{picture}"


def _job_html(job: Job) -> str:
    tasks: dict[str, list[str]] = {}
    for task in job.tasks:
        actions = " and ".join(stop.action for stop in task.stops) or "work"
        tasks.setdefault(task.id, []).append(f"{task.arm}: {actions}")
    rows = [(name, "; ".join(work)) for name, work in tasks.items()]
    more = [("…", f"{len(rows) - MOST_TASKS} more")] if len(rows) > MOST_TASKS else []
    from dualarm_cli.report.figures.cell_figure import draw_cell

    picture = _picture(lambda: draw_cell(job, "svg"))
    return f"{escape(repr(job))}{_table([*rows[:MOST_TASKS], *more])}{picture}"


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table>{''.join(cells)}</table>"


def _gantt(schedule: Schedule, job: Job) -> bytes:
    from dualarm_cli.report.figures.gantt_figure import draw_gantt

    return draw_gantt(schedule, job, "svg")


def _curves(schedule: Schedule) -> bytes:
    figure = new_figure(10.0, 4.0)
    schedule.plot(axes=figure.subplots())
    return rendered(figure, "svg")


def _picture(draw: Callable[[], bytes]) -> str:
    """Draw a picture as an HTML image, or nothing without matplotlib."""
    try:
        import matplotlib as mpl
    except ImportError:
        return ""
    # Settings of the notebook's own figures stay as they are.
    with mpl.rc_context():
        data = b64encode(draw()).decode()
    return f'<img style="max-width:100%" src="data:image/svg+xml;base64,{data}">'
