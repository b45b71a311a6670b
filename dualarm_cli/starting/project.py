"""Files of a first project, and the folder they are written to."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from dualarm_cli.errors import InfeasibleError, OutputError
from dualarm_cli.exporting.whole_files import write_file
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.studies.studies import load_study
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.notes import Note
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.robot_import.proposed_tool import ProposedTool
from dualarm_cli.schemas import editor_line, schema_text
from dualarm_cli.starting.layout import LAYOUT, Layout, Row, find_layout
from dualarm_cli.starting.robot_source import RobotSource

LAST = "tasks.yaml"
"""File moved into place last, which marks a complete project."""
WORKFLOW = """\
# Cycle times that must not get worse. Before the first run, complete requirements.txt, write scores.json and commit it:
#   dualarm score tasks.yaml --baseline scores.json --update-baseline
name: score
on:
  pull_request:
  push:
    branches: [main]
permissions:
  contents: read
concurrency:
  group: score-${{ github.ref }}
  cancel-in-progress: true
jobs:
  score:
    runs-on: ubuntu-latest
    timeout-minutes: 60
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "3.12"
          cache: pip
      - run: python -m pip install -r requirements.txt
      - uses: actions/cache/restore@v4
        with:
          path: ~/.cache/dualarm
          key: dualarm-${{ github.run_id }}
          restore-keys: dualarm-
      - run: >-
          dualarm score tasks.yaml --baseline scores.json --max-regression 2%
          --timeout '10 min' --cache ~/.cache/dualarm --junit score.xml --github
      - uses: actions/cache/save@v4
        if: always()  # keeps the plans for the next run, also if the gate fails
        with:
          path: ~/.cache/dualarm
          key: dualarm-${{ github.run_id }}
      - uses: actions/upload-artifact@v4
        if: always()
        with:
          name: score
          path: score.xml
          if-no-files-found: ignore
"""
"""CI workflow of a project: `docs/score-workflow.yaml` with its own task files."""
REQUIREMENTS = """\
# Installs dualarm in CI, in the version that scores.json was made with. No package index has it: name its repository.
# dualarm @ git+https://<address of the repository>@<a tag>
"""
"""Text of the file that the workflow installs from."""


def refuse_used_folder(folder: Path) -> None:
    """Raise OutputError unless a folder is new or empty and can be created."""
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if os.path.lexists(folder):
        what = "is not empty" if folder.is_dir() else "is a file"
        raise OutputError(f"{folder}: {what}; name a new folder")


def start_project(folder: Path, source: RobotSource) -> tuple[list[str], list[Note]]:
    """Write a project for a robot atomically, and return its file paths and notes on tools.

    Args:
        folder: new or empty.
        source: the robot.

    Raises:
        OutputError: the folder is used, or cannot be written.
        InfeasibleError: no table and targets were found for the robot.
    """
    refuse_used_folder(folder)
    parent = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.is_dir())
    try:
        with tempfile.TemporaryDirectory(prefix=".dualarm-init-", dir=parent) as hidden:
            # File references in the robot's folder may lead up to the project folder.
            project = Path(hidden) / "project"
            _write(project, {**source.files, "cell.yaml": _bare_cell(source).encode()})

            def is_planned(layout: Layout) -> bool:
                """Write the files of a layout, and plan its job."""
                _write(project, _files(source, layout))
                return _has_plan(load_job(project / LAST))

            layout = find_layout(load_cell(project / "cell.yaml").cell, source.name, is_planned)
            files = {**source.files, **_files(source, layout)}
            load_study(project / "study.yaml")
            if folder.is_dir():
                names = sorted(
                    (path.name for path in project.iterdir()), key=lambda name: name == LAST
                )
                for name in names:
                    (project / name).rename(folder / name)
            else:
                folder.parent.mkdir(parents=True, exist_ok=True)
                project.rename(folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    return list(files), [tool.note for tool in layout.tools.values()]


def _has_plan(job: Job) -> bool:
    """Check that a job has a plan of the lowest effort.

    The other efforts fall back to it.
    """
    try:
        plan_without_bound(job, PlanSettings(effort="quick"))
    except InfeasibleError:
        return False
    return True


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_file(folder / name, content, force=True)


def _files(source: RobotSource, layout: Layout) -> dict[str, bytes]:
    """Build the project's files that do not belong to the robot."""
    texts = {
        "cell.yaml": _editor_line("cell") + cell_text(source, layout),
        "tasks.yaml": _editor_line("tasks") + tasks_text(layout),
        "study.yaml": _editor_line("study") + study_text(layout),
        **{_schema_file(kind): schema_text(kind) for kind in ("cell", "tasks", "study")},
        ".github/workflows/score.yaml": WORKFLOW,
        "requirements.txt": REQUIREMENTS,
    }
    return {name: text.encode() for name, text in texts.items()}


def _schema_file(kind: str) -> str:
    """Return the path at which editors find the schema of a file type."""
    return f".dualarm/{kind}.schema.json"


def _editor_line(kind: str) -> str:
    return editor_line(_schema_file(kind))


def _bare_cell(source: RobotSource) -> str:
    return f"dualarm: cell/1\n{source.entry}\n"


def cell_text(source: RobotSource, layout: Layout) -> str:
    """Write the text of the cell file.

    Args:
        source: the robot.
        layout: of the cell.
    """
    lines = [
        "# The cell: a robot, its tools, and what stands around it. Written by `dualarm init`: replace it by yours.",
        "dualarm: cell/1",
        source.entry,
        "tools:                 # the tool centre point (tcp) of each has z along the tool",
    ]
    for arm, tool in layout.tools.items():
        lines += [f"  # {tool.note}", f"  {arm}: {_tool(tool)}"]
    lines += [
        "frames:                # targets are in these; x, y and z are in m from the robot's root, z is up;",
        "                       # `grid: {count: [3, 4], pitch: [60 mm, 60 mm]}` makes one a tray for `each`",
    ]
    for arm, (tray, box) in zip(layout.trays, _pairs(layout), strict=True):
        for kind, row in (("tray", tray), ("box", box)):
            lines.append(f"  {kind}_{arm}: {_frame(row, layout.height)}")
    x, y, z = layout.table.middle
    size = ", ".join(f"{_number(side)}" for side in layout.table.size)
    lines += [
        "obstacles:             # what nothing may touch; a box is given by its sides and its centre",
        f"  table: {{box: [{size}], xyz: [{_number(x)}, {_number(y)}, {_number(z)}]}}",
        f"clearance: {_mm(layout.clearance)}        # the distance that all bodies keep",
        "# parts:               # what tasks carry (`part: cup`), where shape, weight, care or grip matter",
        "#   cup:               # `width`: of the jaws on it; `opening: [0, 60 mm]` of a tool: what its jaws can do",
        "#     {shapes: [{cylinder: {radius: 20 mm, length: 40 mm}}], mass: 200 g, width: 40 mm,",
        "#      grasps: {top: {xyz: [0, 0, 20 mm], rpy: [180 deg, 0, 0]}}, while_holding: {tilt: 15 deg}}",
    ]
    return "\n".join(lines) + "\n"


def tasks_text(layout: Layout) -> str:
    """Write the text of the task file.

    Args:
        layout: of the cell.
    """
    line = _mm(0.5 * layout.step)
    lines = [
        "# The job: six picks. `dualarm plan` finds a schedule for it, `dualarm check` only reads it.",
        "dualarm: tasks/1",
        "cell: cell.yaml",
        "order: given           # as written; `optimise` lets the planner choose, and `arm: any` the arm, too",
    ]
    if layout.home_fault:
        lines.append(f"start: free            # {layout.home_fault}")
    lines += [
        "return: true           # end where the cycle began",
        f"defaults: {{approach: {line}, retract: {line}, straight: {line}, dwell: 0.15 s, blend: 10 mm}}",
        "                       # lines to and from each target, along z of the tool or {distance, direction, in};",
        "                       # `dwell`: of the gripper; [80 ms, 120 ms, 200 ms] is the least, nominal and greatest;",
        "                       # `straight`: how much of them must be straight;",
        "                       # `blend`: how far tools may leave targets of moves and corners, so as not to stop",
        "tasks:                 # rpy: [180 deg, 0, 0] points the tool down; free: yaw lets it turn about its own axis",
    ]
    arms = list(layout.trays)
    count = LAYOUT.picks // len(arms)
    for k in range(count):
        y = _mm((k - 0.5 * (count - 1)) * layout.step)
        for arm in arms:
            targets = [
                f"{{at: {frame}_{arm}, xyz: [0, {y}, 0], rpy: [180 deg, 0, 0], free: yaw}}"
                for frame in ("tray", "box")
            ]
            lines.append(f"  - id: {arm}-{k + 1}")
            lines.append(f"    arm: {arm}")
            lines.append(f"    pick:  {targets[0]}")
            lines.append(f"    place: {targets[1]}")
    return "\n".join(lines) + "\n"


def study_text(layout: Layout) -> str:
    """Write the text of the study file.

    Args:
        layout: of the cell.
    """
    shift = 0.5 * layout.step
    frames = [f"{kind}_{arm}" for arm in layout.trays for kind in ("tray", "box")]
    return "\n".join(
        [
            "# A layout study: how high should the table stand? `dualarm sweep study.yaml` plans each height.",
            "dualarm: study/1",
            "tasks: tasks.yaml",
            "objectives: [cycle_time, clearance]",
            "settings: {effort: quick}",
            "parameters:",
            "  table height:        # all that stands on the table moves with it",
            "    targets:",
            "      - cell: obstacles.table.xyz[2]",
            *(f"      - cell: frames.{frame}.xyz[2]" for frame in frames),
            "    apply: shift",
            f"    values: [{_mm(-shift)}, 0, {_mm(shift)}]",
            "",
        ]
    )


def _pairs(layout: Layout) -> list[tuple[Row, Row]]:
    return [(layout.trays[arm], layout.boxes[arm]) for arm in layout.trays]


def _tool(tool: ProposedTool) -> str:
    """Format a tool for the cell file."""
    turned = f", rpy: [{', '.join(_degrees(angle) for angle in tool.rpy)}]" if any(tool.rpy) else ""
    tcp, middle = (
        f"xyz: [{', '.join(_mm(value) for value in pose.translation)}]{turned}"
        for pose in (tool.tcp, tool.middle)
    )
    if not tool.length:
        return f"{{tcp: {{{tcp}}}}}"
    form = f"radius: {_mm(tool.radius)}, length: {_mm(tool.length - 2.0 * tool.radius)}"
    return f"{{tcp: {{{tcp}}}, shapes: [{{capsule: {{{form}}}, {middle}}}]}}"


def _frame(row: Row, height: float) -> str:
    """Format a frame whose y axis runs along a row of targets."""
    turned = ", rpy: [0, 0, -90 deg]" if row.along == "x" else ""
    x, y = row.centre
    return f"{{xyz: [{_number(x)}, {_number(y)}, {_number(height)}]{turned}}}"


def _number(value: float) -> str:
    return f"{round(value, 4) + 0.0:g}"


def _degrees(angle: float) -> str:
    return f"{angle:g} deg" if angle else "0"


def _mm(length: float) -> str:
    value = round(length * 1000.0, 2) + 0.0
    return f"{value:g} mm" if value else "0"
