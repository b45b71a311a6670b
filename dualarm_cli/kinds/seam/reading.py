"""Coordinate tasks of task files: curves on parts, tools, and part poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dualarm_cli.files.source.fields import to_se3
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Loc
from dualarm_cli.files.tasks.schema_tasks import TaskSection
from dualarm_cli.files.tasks.task_reader import KindReading, TaskReader
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, sin
from dualarm_cli.kinds.seam.schema import CoordinateSection, FeatureSection, HoldSection, SeamTask
from dualarm_cli.model.curves.contours import Contour, Ellipse, LineContour, Saddle, SphereArc
from dualarm_cli.model.curves.feature_curve import (
    FeatureCurve,
    MeasuredCurve,
    PoseCurve,
    least_lean,
    sharpest_bend,
    sharpest_roll,
)
from dualarm_cli.model.curves.point_spline import PointSpline
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import SeamTarget, Stop, Task
from dualarm_cli.model.process_work import Hold, SeamTool, SeamWork
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class SeamReading:
    """Smallest features of a seam that can be read."""

    least_lean: float = math.radians(1.0)
    """Least angle between a curve and its surface's normal [rad]."""
    sharpest: float = math.radians(30.0)
    """Largest turn of a curve between measured nodes; more is a corner [rad]."""
    shortest: float = 1e-5
    """Least length of curves, spline intervals, and gaps between pipe sides [m].

    A gap is that between the sides of two pipes.
    """
    same_point: float = 1e-6
    """Distance below which neighbouring poses of a file coincide [m]."""
    smallest_normal: float = 1e-9
    """Least length of a normal."""


READ = SeamReading()


SEAM_KEYS = {
    "arm": "it names master and slave itself",
    "approach": "write it into its entry",
    "retract": "write it into its exit",
    "dwell": "write it into its entry and exit",
    "part": "its own part says where the part is held",
}
"""Remedies for keys that belong elsewhere in a coordinate task."""


class SeamReader:
    """Reader of the coordinate tasks of one task file."""

    def __init__(self, reader: TaskReader) -> None:
        """Store the reader of the file's tasks.

        Args:
            reader: of its tasks.
        """
        self._reader, self._curves = reader, reader.curves

    def work(self, section: CoordinateSection, loc: Loc) -> SeamWork | None:
        """Create a seam, or report what is wrong and return None.

        Args:
            section: the task as the file has it.
            loc: its location in the file.
        """
        is_valid = self._check_names(section, loc)
        curve = self._curve(section.curve, (*loc, "curve"))
        part = self._curves.world_pose(section.part, (*loc, "part"))
        hold = self._hold(section.hold, (*loc, "hold"))
        if curve is None or part is None or hold is None or not is_valid:
            return None
        tool = section.tool
        return SeamWork(
            master=section.master,
            slave=section.slave,
            part=part,
            curve=curve,
            tool=SeamTool(
                standoff=tool.standoff,
                work_angle=tool.work_angle,
                travel_angle=tool.travel_angle,
                spin=tool.spin or 0.0,
                free_spin=tool.free == "spin",
                tilt=tool.tilt,
            ),
            hold=hold,
            speed=section.speed,
            duration=section.duration,
            acceleration=section.acceleration,
            slower=section.slower == "allowed",
            downhand=section.downhand,
            entry_duration=section.entry.duration,
            approach=section.entry.approach,
            retract=section.exit.retract,
            dwell_start=section.entry.dwell,
            dwell_end=section.exit.dwell,
            not_before=section.not_before,
            touches=self._touches(section),
            posture=section.posture,
            method=section.method,
            place=self._reader.place(loc),
        )

    def _check_names(self, section: CoordinateSection, loc: Loc) -> bool:
        """Check that the robot has the named arms, bodies and postures."""
        cell, arms, is_valid = self._reader.cell, self._reader.arms, True
        for key in ("master", "slave"):
            name = getattr(section, key)
            if name is not None and name not in arms:
                message = f"{cell.robot.name} has no {name} arm; it has {', '.join(arms)}"
                self._reader.note((*loc, key), message)
                is_valid = False
        bodies = [f"{arm}_tool" for arm in arms] + [obstacle.name for obstacle in cell.obstacles]
        for k, name in enumerate(section.touches or ()):
            if name not in bodies:
                message = (
                    f"there is no body {quote(name)}{suggest(name, bodies, 'tools and obstacles')}"
                )
                self._reader.note((*loc, "touches", k), message)
                is_valid = False
        if not self._reader.check_posture(section.posture, (*loc, "posture")):
            is_valid = False
        return is_valid

    def _touches(self, section: CoordinateSection) -> tuple[str, ...]:
        if section.touches is not None:
            return tuple(section.touches)
        return () if section.master is None else (f"{section.master}_tool",)

    def _hold(self, section: HoldSection, loc: Loc) -> Hold | None:
        if section.mode is not None:
            return Hold(still=section.mode == "still")
        if section.way is not None:
            part_path = self._curves.read(section.way, (*loc, "way"))
            if part_path is not None and part_path.corners:
                self._reader.note((*loc, "way"), CORNERS)
                return None
            return None if part_path is None else Hold(part_path=part_path)
        pose = self._curves.world_pose(section, loc)
        return None if pose is None else Hold(pose=pose)

    def _curve(self, section: FeatureSection, loc: Loc) -> MeasuredCurve | None:
        if section.kind == "poses":
            return self._through(section, (*loc, "file"))
        wrong = _curve_fault(section)
        if wrong:
            place, message = wrong
            self._reader.note((*loc, *place), message)
            return None
        contour = _contour(section)
        curve = FeatureCurve(contour, to_se3(section))
        if not self._smooth(curve, loc):
            return None
        key = "normals" if section.normals else "normal"
        place = (*loc, key) if getattr(section, key) else loc
        if least_lean(contour) < READ.least_lean:
            message = (
                "the normal is tangent to the curve somewhere; it must point out of the surface"
            )
            self._reader.note(place, message)
            return None
        roll, at = sharpest_roll(contour)
        if roll > READ.sharpest:
            message = f"the normal turns over at once near {_shown(at)}; give normals of one side"
            self._reader.note(place, message)
            return None
        return curve

    def _through(self, section: FeatureSection, loc: Loc) -> MeasuredCurve | None:
        """Create the curve through the poses of a file.

        Returns None after reporting errors.
        """
        poses = self._curves.poses(str(section.file), loc)
        if poses is None:
            return None
        for k, (first, second) in enumerate(pairwise(poses), 1):
            if math.dist(first.translation, second.translation) < READ.same_point:
                message = f"its poses {k} and {k + 1} are at one place; a curve turns only while it advances"
                self._reader.note(loc, message)
                return None
        curve = PoseCurve.through(poses, to_se3(section))
        return curve if self._smooth(curve, loc) else None

    def _smooth(self, curve: MeasuredCurve, loc: Loc) -> bool:
        """Report a curve without length, or with a corner.

        The tool would have to stop at a corner.
        """
        bend, at = sharpest_bend(curve.contour)
        if bend > READ.sharpest:
            self._reader.note(
                loc,
                f"the curve turns by {math.degrees(bend):.0f} deg at once near {_shown(at)}, where the tool would have "
                "to stop; round it, or end the curve there and begin another task",
            )
            return False
        # After the bends: a curve that stands still has no length.
        if curve.length < READ.shortest:
            self._reader.note(loc, f"the curve is {curve.length * 1e3:.3g} mm long; make it longer")
            return False
        return True


CORNERS = "a part cannot follow a curve with corners, where it would have to stop; join its pieces smoothly"


def _shown(point: FloatArray) -> str:
    """Format a point of a curve for messages."""
    # Less than a nanometre counts as 0.
    return f"({', '.join(f'{round(v, 9) + 0.0:.6g}' for v in point.tolist())})"


def _contour(section: FeatureSection) -> Contour:
    begin = section.begin or 0.0
    end = section.finish if section.finish is not None else begin + TURN
    shift = section.eccentricity or 0.0
    if section.kind == "saddle":
        angle = section.angle if section.angle is not None else math.pi / 2.0
        R, r = section.main_radius or 0.0, section.branch_radius or 0.0
        return Saddle(R, r, angle, shift, begin, end)
    if section.kind == "arc" and section.main_radius is not None:
        r = section.radius or 0.0
        return SphereArc(section.main_radius, r, section.angle or 0.0, shift, begin, end)
    if section.kind in ("arc", "ellipse"):
        a, b = section.semi_axes or [section.radius or 0.0] * 2
        return Ellipse((a, b), begin, end, section.side == "outside")
    up = np.array(section.normal or [0.0, 0.0, 1.0], dtype=np.float64)
    if section.kind == "line":
        return LineContour(np.array(section.start), np.array(section.end), up)
    normals = up if section.normals is None else np.array(section.normals, dtype=np.float64)
    return PointSpline.through(np.array(section.points), normals, closed=bool(section.closed))


def _curve_fault(section: FeatureSection) -> tuple[Loc, str] | None:
    """Find the first error of a curve as place and message, or None."""
    begin = section.begin or 0.0
    if section.finish is not None and section.finish == begin:
        return ("finish",), "the curve ends where it begins; leave 'finish' out for a full turn"
    if section.finish is not None and abs(section.finish - begin) > TURN + 1e-9:
        return ("finish",), "the curve is longer than a full turn; end it after one turn"
    shift = abs(section.eccentricity or 0.0)
    if section.kind == "saddle":
        R, r = section.main_radius or 0.0, section.branch_radius or 0.0
        if r + shift > R - READ.shortest:
            return ("branch_radius",), (
                f"{r:g} m and the eccentricity must stay 0.01 mm inside the main pipe of {R:g} m, "
                "so that the branch pipe meets it all round"
            )
        if section.angle is not None and abs(sin(section.angle)) < 0.05:
            return ("angle",), "the pipes are (nearly) parallel and do not meet in a closed curve"
    if section.kind == "arc":
        r = section.radius or 0.0
        if section.main_radius is not None and r + shift > section.main_radius - READ.shortest:
            return ("radius",), (
                f"{r:g} m and the eccentricity must stay 0.01 mm inside the sphere of {section.main_radius:g} m"
            )
        if section.main_radius is None:
            for key in ("angle", "eccentricity"):
                if getattr(section, key) is not None:
                    return (key,), f"'{key}' needs main_radius, the sphere that the arc lies on"
        elif section.side is not None:
            return ("side",), "on a sphere the tool comes from outside it; leave 'side' out"
    return _point_fault(section)


def _point_fault(section: FeatureSection) -> tuple[Loc, str] | None:
    """Find the first error of points and normals as place and message, or None."""
    for place, direction in _directions(section):
        if math.hypot(*direction) < READ.smallest_normal:
            return place, "a normal of no length points nowhere; give a direction such as [0, 0, 1]"
    if section.kind == "line" and _near(section.start, section.end):
        return ("end",), "the line ends where it begins"
    if section.points is not None:
        for k, (first, second) in enumerate(zip(section.points, section.points[1:], strict=False)):
            if _near(first, second):
                return ("points", k + 1), "the same point as the one before; remove it"
        if section.closed and not _near(section.points[0], section.points[-1]):
            return ("points",), "a closed spline ends with the point it begins with"
        if section.closed and len(section.points) < 4:
            return ("points",), "a closed spline needs three different points or more"
    return None


def _directions(section: FeatureSection) -> list[tuple[Loc, list[float]]]:
    """List all normals with their places."""
    normals: list[tuple[Loc, list[float]]] = []
    if section.normal is not None:
        normals.append((("normal",), section.normal))
    for k, direction in enumerate(section.normals or ()):
        normals.append((("normals", k), direction))
    return normals


def _near(first: Sequence[float] | None, second: Sequence[float] | None) -> bool:
    return math.dist(first or (), second or ()) < READ.shortest


def partners(reader: TaskReader, section: TaskSection, loc: Loc) -> list[Task]:
    """Create each arm's task of a coordinate task.

    Args:
        reader: of the file.
        section: the task as the file has it.
        loc: its location in the file.
    """
    assert isinstance(section, SeamTask) and section.coordinate is not None  # selected by its key
    for key in ("arm", "approach", "retract", "dwell", "part"):
        if getattr(section, key) is not None:
            instead = SEAM_KEYS.get(key, "remove it")
            message = f"'{key}' does not go with a coordinate task; {instead}"
            reader.note((*loc, key), message)
    work = SeamReader(reader).work(section.coordinate, (*loc, "coordinate"))
    if work is None:
        return []
    tasks = []
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
        tasks.append(Task(section.id, arm, (first, last), tuple(section.after), seam=work))
    return tasks


READING = KindReading(
    key="coordinate", plural="coordinate tasks", task_keys=SeamTask, shares=partners
)
