"""`dualarm report`: the page of an existing plan."""

from __future__ import annotations

import hashlib
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.parts.options import PlanTasksOption
from dualarm_cli.cli.parts.output import QuietOption, print_message
from dualarm_cli.errors import InputError, UsageError

if TYPE_CHECKING:
    from dualarm_cli.model.schedule import Schedule

PAGE = "report.html"
"""Name of the page next to a schedule."""
OpenOption = Annotated[bool, typer.Option("--open", help="Show report.html in the browser.")]


def show_page(page: Path) -> None:
    """Open a page in the browser."""
    import webbrowser

    webbrowser.open(page.absolute().as_uri())


def report_command(
    plan: Annotated[Path, typer.Argument(help="Folder of a plan, or a schedule file.")],
    tasks: PlanTasksOption = None,
    video: Annotated[
        Path | None,
        typer.Option(
            "--video",
            metavar="FILE",
            help="Write the motion in real time as well: .mp4 or .gif. Needs Chromium and ffmpeg.",
        ),
    ] = None,
    open_page: OpenOption = False,
    quiet: QuietOption = False,
) -> None:
    """Verify a plan again, and write its page report.html with the moving cell."""
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.interface import Plan, load
    from dualarm_cli.model.schedule import ScheduleRobot
    from dualarm_cli.verification.robot_checks import USABLE, check_robot, unusable

    if video is not None:
        from dualarm_cli.page.video import refuse_video

        refuse_video(video)
    schedule = read_schedule(plan)
    folder = plan if plan.is_dir() else plan.parent
    file = tasks if tasks is not None else tasks_of(schedule, plan)
    job = load(file)
    if (robot := check_robot(schedule, job)).verdict == "failed":
        raise UsageError(f"{plan}: is of another robot than {file}: {robot.detail}")
    # Data that the file omits comes from the job.
    judged = Plan.judged(job, replace(schedule, robot=ScheduleRobot.of_job(job)))
    assert judged.schedule.verification is not None
    failures = judged.schedule.verification.failures
    if wrong := unusable(judged.schedule, job, failures, (*USABLE, "arms", "segments")):
        raise UsageError(f"{plan}: cannot be shown: {wrong.name}: {wrong.detail}")
    page = judged.write_page(folder)
    if not quiet:
        print_message(f"written: {page}")
    if video is not None:
        _write_video(page, video, quiet)
    if open_page:
        show_page(page)
    if not judged.verified:
        failed = ", ".join(check.name for check in failures)
        print_message(f"verification: FAILED: {failed}; `dualarm verify` has details")
        raise typer.Exit(1)


def _write_video(page: Path, video: Path, quiet: bool) -> None:
    """Write the video of a page, with a counter of its frames."""
    from dualarm_cli.cli.parts.output import stderr_console
    from dualarm_cli.page.video import write_video

    with stderr_console().status("starting Chromium") if not quiet else nullcontext() as status:

        def progress(done: int, count: int) -> None:
            if status is not None:
                status.update(f"drawing frame {done} of {count}")

        write_video(page, video, progress)
    if not quiet:
        print_message(f"written: {video}")


def tasks_of(schedule: Schedule, plan: Path) -> Path:
    """Find the original task file of a schedule.

    It is searched by its name within the project, here, above and around the plan, and among the bundled jobs.

    Args:
        schedule: the plan.
        plan: its folder or file.

    Raises:
        UsageError: it is not there, or has been changed since.
    """
    from dualarm_cli.files.source.bundled import bundled_tasks
    from dualarm_cli.files.source.text_source import read_bytes

    name, digest = next(iter(schedule.provenance.inputs.items()), ("", ""))
    if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name:
        raise UsageError(
            "the task file of the plan is not found: its name leads elsewhere; name it with --tasks"
        )
    current, plan = Path.cwd(), plan.absolute()
    places = (current, *current.parents, plan, *plan.parents)
    files = [place / name for place in places if name and (place / name).is_file()]
    for file in (*files, *bundled_tasks().values()):
        with suppress(InputError):
            if hashlib.sha256(read_bytes(file, name)).hexdigest() == digest:
                return file
    if files:
        raise UsageError(
            f"{files[0]} has changed since the plan: plan it again, or name the file as it was with --tasks"
        )
    raise UsageError(
        f"the task file of the plan is not found: there is no {name or 'task file'} here; name it with --tasks"
    )
