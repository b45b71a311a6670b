"""Paths and coordinate tasks: each arm's share of them."""

from __future__ import annotations

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.paths import PathReader, check_arms
from dualarm_cli.files.tasks.schema_paths import PathSection
from dualarm_cli.files.tasks.schema_seams import CoordinateSection
from dualarm_cli.files.tasks.schema_tasks import TaskSection
from dualarm_cli.files.tasks.seams import SeamReader
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Dwell, PoseTarget, SeamTarget, Stop, Task

SEAM_KEYS = {
    "arm": "it names master and slave itself",
    "approach": "write it into its entry",
    "retract": "write it into its exit",
    "dwell": "write it into its entry and exit",
    "part": "its own part says where the part is held",
}
"""What is said of keys that a coordinate task has elsewhere."""


class WorkReader:
    """Turns paths and coordinate tasks of one file into nouns."""

    def __init__(
        self, document: Document, cell: Cell, findings: Findings, paths: PathReader
    ) -> None:
        """Prepares for a file and its cell.

        Args:
            document: the task file.
            cell: where arms and frames come from.
            findings: where errors are noted.
            paths: reads paths.
        """
        self._document, self._findings, self._paths = document, findings, paths
        self._arms = [arm.name for arm in cell.robot.arms]
        self._seams = SeamReader(document, cell, paths)

    def followers(self, section: TaskSection, path: PathSection, loc: Loc) -> list[Task]:
        """Returns each arm's share of a path task: where its tool ends is its one stop.

        Args:
            section: the task as the file has it.
            path: its path.
            loc: where the task stands.
        """
        place: Loc = (*loc, "path")
        wrong = check_arms(dict.fromkeys(self._arms), path, section.arm)
        if section.arm == "any":
            return []
        if wrong:
            self._findings.add(self._document, place, wrong)
            return []
        for key in ("approach", "retract", "dwell", "part"):
            if getattr(section, key) is not None:
                message = f"'{key}' does not go with a path; remove it"
                self._findings.add(self._document, (*loc, key), message)
        work = self._paths.work(path, place, section.arm or path.arm)
        if work is None:
            return []
        found = []
        for arm, way in work.paths.items():
            end = PoseTarget(way.pose(way.length))
            stop = Stop("path", end, 0.0, 0.0, Dwell(), work.place)
            found.append(Task(section.id, arm, (stop,), tuple(section.after), path=work))
        return found

    def partners(self, section: TaskSection, coordinate: CoordinateSection, loc: Loc) -> list[Task]:
        """Returns each arm's share of a coordinate task.

        Args:
            section: the task as the file has it.
            coordinate: what both arms do.
            loc: where the task stands.
        """
        for key in ("arm", "approach", "retract", "dwell", "part"):
            if getattr(section, key) is not None:
                instead = SEAM_KEYS.get(key, "remove it")
                message = f"'{key}' does not go with a coordinate task; {instead}"
                self._findings.add(self._document, (*loc, key), message)
        work = self._seams.work(coordinate, (*loc, "coordinate"))
        if work is None:
            return []
        found = []
        for arm in work.arms:
            # The master only holds still while the slave comes, dwells and leaves.
            works = arm == work.slave
            first = Stop(
                "seam_start",
                SeamTarget(work),
                work.approach if works else 0.0,
                0.0,
                Dwell(gripper=work.dwell_start if works else 0.0),
                work.place,
            )
            last = Stop(
                "seam_end",
                SeamTarget(work),
                0.0,
                work.retract if works else 0.0,
                Dwell(gripper=work.dwell_end if works else 0.0),
                work.place,
            )
            found.append(Task(section.id, arm, (first, last), tuple(section.after), seam=work))
        return found
