# ruff: noqa: E501 (tables of exact messages, one a line)
"""Coordinate tasks in task files: what they become, and every mistake at its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.curves.contours import Ellipse, LineContour, Saddle, SphereArc
from dualarm_cli.model.curves.feature_curve import FeatureCurve, PoseCurve
from dualarm_cli.model.curves.point_spline import PointSpline
from dualarm_cli.model.job import SeamTarget
from dualarm_cli.model.process_work import SeamWork

Change = Callable[..., None]
Messages = Callable[..., list[str]]
TURN = 2.0 * np.pi

SEAM = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
tasks:
  - id: seam
    coordinate:
      master: left
      slave: right
      curve: {kind: saddle, main_radius: 50 mm, branch_radius: 45 mm}
      part: {xyz: [0, 0, 200 mm]}
      speed: 50 mm/s
"""
CURVE = "{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm}"
COLUMNS = "x,y,z,qx,qy,qz,qw\n"
CSV = COLUMNS + "0,0,0,0,0,0,1\n0.1,0,0,0,0,0,1\n0.2,0.1,0,0,0,0,1\n"


@pytest.fixture
def seam(project: Path) -> Path:
    """The tiny project with a saddle that the right arm works on a part in the left one."""
    (project / "tasks.yaml").write_text(SEAM)
    return project


def loaded() -> SeamWork:
    """The first task's seam."""
    work = load_job("tasks.yaml").tasks[0].seam
    assert work is not None
    return work


def contour() -> object:
    """The first task's contour."""
    curve = loaded().curve
    assert isinstance(curve, FeatureCurve)
    return curve.contour


def test_both_arms_have_their_share_of_one_seam(seam: Path) -> None:
    """The slave first; two stops each at the same work; the place is the coordinate key's value."""
    slave, master = load_job("tasks.yaml").tasks
    assert (slave.id, slave.arm, master.id, master.arm) == ("seam", "right", "seam", "left")
    assert slave.seam is master.seam
    for task in (slave, master):
        assert [stop.action for stop in task.stops] == ["seam_start", "seam_end"]
        for stop in task.stops:
            assert isinstance(stop.target, SeamTarget)
            assert str(stop.place) == "tasks.yaml:7:7"
    job = load_job("tasks.yaml")
    assert (job.has_seams, job.has_paths, job.in_sections) == (True, False, True)
    assert [len(section) for section in job.sections()] == [2]


def test_what_the_file_leaves_out_has_its_default(seam: Path) -> None:
    """The planner moves the part; the tool stands upright on the curve; slower is forbidden; the tool may touch the part."""
    work = loaded()
    assert (work.master, work.slave, work.speed, work.duration) == ("left", "right", 0.05, None)
    assert (work.tool.standoff, work.tool.work_angle, work.tool.travel_angle) == (0.0, 0.0, 0.0)
    assert (work.tool.free_spin, work.tool.tilt) == (False, 0.0)
    assert (work.hold.given, work.hold.stands) == (False, False)
    assert (work.acceleration, work.slower, work.downhand) == (None, False, None)
    assert (work.approach, work.retract, work.dwell_start, work.dwell_end) == (0.0,) * 4
    assert (work.not_before, work.touches) == (0.0, ("left_tool",))
    assert (work.posture, work.method) == (None, None)
    assert work.part.translation.tolist() == [0.0, 0.0, 0.2]
    assert work.part.rotation.tolist() == np.eye(3).tolist()
    shape = contour()
    assert shape == Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, TURN)
    # 0.30874 m, Table 2 of [Qin2024].
    assert round(work.length, 5) == 0.30874


def test_what_the_file_gives_counts_with_its_units(seam: Path, change: Change) -> None:
    """Every key of a coordinate task."""
    change(
        "tasks.yaml",
        "part: {xyz: [0, 0, 200 mm]}\n      speed: 50 mm/s\n",
        "part: {xyz: [0, 0, 200 mm], rpy: [0, 0, 90 deg]}\n"
        "      tool: {standoff: 2 mm, work_angle: 45 deg, travel_angle: -10 deg, free: spin, tilt: 6 deg}\n"
        "      hold: still\n"
        "      duration: 4000 ms\n"
        "      acceleration: 300 mm/s²\n"
        "      slower: allowed\n"
        "      downhand: 15 deg\n"
        "      entry: {approach: 40 mm, dwell: 300 ms}\n"
        "      exit: {retract: 6 cm, dwell: 0.2}\n"
        "      not_before: 5 s\n"
        "      touches: [left_tool, table]\n"
        "      posture: bent\n"
        "      method: any name\n",
    )
    work = loaded()
    tool = work.tool
    assert (tool.standoff, tool.free_spin) == (0.002, True)
    angles = [tool.work_angle, tool.travel_angle, tool.tilt]
    assert angles == pytest.approx(np.radians([45.0, -10.0, 6.0]))
    assert (work.hold.stands, work.hold.given) == (True, False)
    assert (work.speed, work.duration, work.acceleration) == (None, 4.0, 0.3)
    assert (work.slower, work.downhand) == (True, pytest.approx(np.radians(15.0)))
    assert (work.approach, work.dwell_start, work.retract, work.dwell_end) == (0.04, 0.3, 0.06, 0.2)
    assert (work.not_before, work.touches) == (5.0, ("left_tool", "table"))
    assert (work.posture, work.method) == ("bent", "any name")
    assert work.part.rotation == pytest.approx(pin.utils.rotate("z", np.pi / 2))
    # Only the slave comes, dwells and leaves.
    slave, master = load_job("tasks.yaml").tasks
    assert [(s.approach, s.retract, s.dwell.total) for s in slave.stops] == [
        (0.04, 0.0, 0.3),
        (0.0, 0.06, 0.2),
    ]
    assert [(s.approach, s.retract, s.dwell.total) for s in master.stops] == [(0.0, 0.0, 0.0)] * 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "{kind: saddle, main_radius: 60 mm, branch_radius: 1 cm, angle: 60 deg, eccentricity: -5 mm, begin: 90 deg, finish: 0}",
            Saddle(0.06, 0.01, np.pi / 3, -0.005, np.pi / 2, 0.0),
        ),
        (
            "{kind: arc, main_radius: 50 mm, radius: 20 mm, angle: 30 deg, eccentricity: 3 mm, begin: 1}",
            SphereArc(0.05, 0.02, np.pi / 6, 0.003, 1.0, 1.0 + TURN),
        ),
        ("{kind: arc, radius: 20 mm}", Ellipse((0.02, 0.02), 0.0, TURN)),
        (
            "{kind: arc, radius: 20 mm, side: outside, finish: -1}",
            Ellipse((0.02, 0.02), 0.0, -1.0, True),
        ),
        (
            "{kind: ellipse, semi_axes: [40 mm, 0.02], begin: 0.5, finish: 1.5, side: above}",
            Ellipse((0.04, 0.02), 0.5, 1.5),
        ),
    ],
)
def test_curves_with_angles_are_what_they_say(
    text: str, expected: object, seam: Path, change: Change
) -> None:
    """By hand, in SI."""
    change("tasks.yaml", CURVE, text)
    found = contour()
    assert type(found) is type(expected)
    for key, value in vars(expected).items():
        assert getattr(found, key) == pytest.approx(value), key


def test_lines_and_splines_are_what_they_say(seam: Path, change: Change) -> None:
    """Points in metres, z is out of the surface where nothing else is said; the curve's pose places it."""
    one = "{kind: line, start: [0, 0, 0], end: [0.3, 0.4, 0], xyz: [1, 0, 0], rpy: [0, 90 deg, 0]}"
    change("tasks.yaml", CURVE, one)
    work = loaded()
    line = contour()
    assert isinstance(line, LineContour)
    assert line.up.tolist() == [0.0, 0.0, 1.0]
    assert work.length == pytest.approx(0.5)
    # Turned by 90 deg about y, x goes to -z and z to x: the end is at (1, 0.4, -0.3), z out along +x.
    R, p = work.curve.at(np.array([0.5]))
    assert p[0] == pytest.approx([1.0, 0.4, -0.3])
    assert R[0, :, 2] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    two = "{kind: line, start: [0, 0, 0], end: [1, 0, 0], normal: [0, -2, 0]}"
    change("tasks.yaml", one, two)
    line = contour()
    assert isinstance(line, LineContour)
    assert line.up.tolist() == [0.0, -2.0, 0.0]
    corners = "[[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0, 0]]"
    three = f"{{kind: spline, points: {corners}, closed: true, normal: [0, 0, 1]}}"
    change("tasks.yaml", two, three)
    spline = contour()
    assert isinstance(spline, PointSpline)
    assert (spline.closed, spline.up.tolist()) == (True, [0.0, 0.0, 1.0])
    assert spline.points[2].tolist() == [0.1, 0.1, 0.0]
    four = f"{{kind: spline, points: {corners}, normals: [[0, 0, 1], [0, 0, 1], [1, 0, 3], [0, 0, 1]]}}"
    change("tasks.yaml", three, four)
    spline = contour()
    assert isinstance(spline, PointSpline)
    assert (spline.closed, spline.up[2].tolist()) == (False, [1.0, 0.0, 3.0])


def test_poses_come_from_a_file_and_q_is_minus_q(seam: Path, change: Change) -> None:
    """Quaternions of alternating sign are the same curve; the way alone is its length; its own pose places it."""
    change(
        "tasks.yaml", CURVE, "{kind: poses, file: seam.csv, xyz: [0, 0, 1], rpy: [90 deg, 0, 0]}"
    )
    half = 0.5 * np.linspace(0.0, 0.5 * np.pi, 11)
    rows = [
        f"{0.01 * k:.2f},0,0,0,0,{np.sin(half[k]):.15f},{np.cos(half[k]):.15f}" for k in range(11)
    ]
    flipped = [
        ",".join([*row.split(",")[:3], *(str(-float(q)) for q in row.split(",")[3:])])
        if k % 2
        else row
        for k, row in enumerate(rows)
    ]
    found = []
    for lines in (rows, flipped):
        (seam / "seam.csv").write_text(COLUMNS + "\n".join(lines) + "\n")
        curve = loaded().curve
        assert isinstance(curve, PoseCurve)
        # 0.1 m, though it turns by 90 deg, which counts as 0.157 m in paths.
        assert curve.length == pytest.approx(0.1)
        found.append(curve.at(np.linspace(0.0, 0.1, 33)))
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-12
    assert np.abs(found[0][1] - found[1][1]).max() < 1e-12
    R, p = found[0]
    assert p[-1] == pytest.approx([0.1, 0.0, 1.0])
    # The last frame is turned by 90 deg about its own z, then with the curve about x: x goes to y, then to z.
    assert R[-1, :, 0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


@pytest.mark.parametrize("text", ["free", "{mode: free}", "still", "{mode: still}"])
def test_the_part_is_held_as_the_planner_likes(text: str, seam: Path, change: Change) -> None:
    """A word, or a key."""
    change("tasks.yaml", "      speed", f"      hold: {text}\n      speed")
    hold = loaded().hold
    assert (hold.stands, hold.given) == ("still" in text, False)


def test_the_part_is_held_at_a_pose_or_follows_a_way(seam: Path, change: Change) -> None:
    """In the frame bin, at (0.4, 0.1, 0.7) turned by 90 deg about z: x of it is y of the world."""
    one = "hold: {in: bin, xyz: [100 mm, 0, 0]}"
    change("tasks.yaml", "speed", one + "\n      speed")
    hold = loaded().hold
    assert hold.pose is not None
    assert hold.pose.translation == pytest.approx([0.4, 0.2, 0.7])
    change(
        "tasks.yaml",
        one,
        "hold: {way: {through: [{xyz: [0.5, 0, 1], rpy: [0, 0, 0]}, {xyz: [0.5, 0.4, 1]}]}}",
    )
    hold = loaded().hold
    assert hold.part_path is not None
    assert hold.at(np.array([0.5]))[1][0] == pytest.approx([0.5, 0.2, 1.0])
    assert not hold.stands


def test_without_a_master_the_part_stands_in_the_cell(seam: Path, change: Change) -> None:
    """In a named frame, and nothing but what is named may be touched."""
    change("tasks.yaml", "      master: left\n", "", "part: {xyz", "part: {in: bin, xyz")
    work = loaded()
    assert (work.master, work.arms, work.touches) == (None, ("right",), ())
    assert work.part.translation == pytest.approx([0.4, 0.1, 0.9])
    (task,) = load_job("tasks.yaml").tasks
    assert task.arm == "right"


# Line 9 is the curve, which begins in column 14. What does not go together points at the key, what is wrong in itself at
# the value. An ellipse's nodes are 1/2048 of a turn apart: 0.1 m cos(2 pi / 2048) is 0.0999995 m.
@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        ("{kind: sadle}", "9:21: E200 'sadle' is not allowed, did you mean 'saddle'? Allowed: saddle, arc, ellipse, line, spline, poses"),
        ("{}", "9:14: E202 'kind' is missing"),
        ("{kind: saddle, main_radius: 1}", "9:14: E202 kind: saddle needs 'branch_radius'"),
        ("{kind: arc}", "9:14: E202 kind: arc needs 'radius'"),
        ("{kind: ellipse}", "9:14: E202 kind: ellipse needs 'semi_axes'"),
        ("{kind: line, start: [0, 0, 0]}", "9:14: E202 kind: line needs 'end'"),
        ("{kind: spline}", "9:14: E202 kind: spline needs 'points'"),
        ("{kind: poses}", "9:14: E202 kind: poses needs 'file'"),
        ("{kind: arc, radius: 1, branch_radius: 1}", "9:37: E200 'branch_radius' does not go with kind: arc; it has angle, begin, eccentricity, finish, main_radius, radius, side"),
        ("{kind: poses, file: a.csv, closed: true}", "9:41: E200 'closed' does not go with kind: poses; it has file"),
        ("{kind: saddle, main_radius: .nan, branch_radius: 1}", "9:42: E104 non-finite number '.nan' is not allowed"),
        ("{kind: saddle, main_radius: 1e300, branch_radius: 1}", "9:42: E200 1e+300 is outside the range of length: -1000 to 1000 m"),
        ("{kind: saddle, main_radius: 0, branch_radius: 1}", "9:42: E200 0: length must be positive"),
        ("{kind: saddle, main_radius: 5 deg, branch_radius: 1}", "9:42: E200 unit 'deg' in '5 deg' is not one of length; allowed: m, mm, cm, um, in"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 50 mm}", "9:64: E300 0.05 m and the eccentricity must stay 0.01 mm inside the main pipe of 0.05 m, so that the branch pipe meets it all round"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm, eccentricity: -5 mm}", "9:64: E300 0.045 m and the eccentricity must stay 0.01 mm inside the main pipe of 0.05 m, so that the branch pipe meets it all round"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm, angle: 2 deg}", "9:78: E300 the pipes are (nearly) parallel and do not meet in a closed curve"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm, angle: 180 deg}", "9:78: E300 the pipes are (nearly) parallel and do not meet in a closed curve"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm, begin: 1, finish: 1}", "9:89: E300 the curve ends where it begins; leave 'finish' out for a full turn"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm, finish: 361 deg}", "9:79: E300 the curve is longer than a full turn; end it after one turn"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 1e-8}", "9:14: E300 the curve is 6.28e-05 mm long; make it longer"),
        ("{kind: saddle, main_radius: 50 mm, branch_radius: 45 mm, finish: 1e-50}", "9:14: E300 the curve is 4.5e-49 mm long; make it longer"),
        ("{kind: arc, main_radius: 50 mm, radius: 40 mm, eccentricity: 10 mm}", "9:54: E300 0.04 m and the eccentricity must stay 0.01 mm inside the sphere of 0.05 m"),
        ("{kind: arc, radius: 40 mm, angle: 10 deg}", "9:48: E300 'angle' needs main_radius, the sphere that the arc lies on"),
        ("{kind: arc, radius: 40 mm, eccentricity: 0}", "9:55: E300 'eccentricity' needs main_radius, the sphere that the arc lies on"),
        ("{kind: arc, radius: 40 mm, main_radius: 1, side: above}", "9:63: E300 on a sphere the tool comes from outside it; leave 'side' out"),
        ("{kind: arc, radius: 40 mm, side: below}", "9:47: E200 'below' is not allowed; allowed: above, outside"),
        ("{kind: ellipse, semi_axes: [1]}", "9:41: E200 a list of 1 is too short; at least 2 are needed"),
        ("{kind: ellipse, semi_axes: [1, 0]}", "9:45: E200 0: length must be positive"),
        ("{kind: ellipse, semi_axes: [0.1, 1e-9]}", "9:14: E300 the curve turns by 90 deg at once near (-0.0999995, 0, 0), where the tool would have to stop; round it, or end the curve there and begin another task"),
        ("{kind: line, start: [0, 0, 0], end: [0, 0, 0]}", "9:50: E300 the line ends where it begins"),
        ("{kind: line, start: [0, 0, 0], end: [0, 0, 1]}", "9:14: E300 the normal is tangent to the curve somewhere; it must point out of the surface"),
        ("{kind: line, start: [0, 0, 0], end: [0, 1, 0], normal: [0, 1, 0.01]}", "9:69: E300 the normal is tangent to the curve somewhere; it must point out of the surface"),
        ("{kind: line, start: [0, 0, 0], end: [0, 1, 0], normal: [0, 0, 0]}", "9:69: E300 a normal of no length points nowhere; give a direction such as [0, 0, 1]"),
        ("{kind: line, start: [0, 0], end: [0, 1, 0]}", "9:34: E200 a list of 2 is too short; at least 3 are needed"),
        ("{kind: spline, points: []}", "9:37: E200 a list of 0 is too short; at least 2 are needed"),
        ("{kind: spline, points: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]}", "9:49: E300 the same point as the one before; remove it"),
        ("{kind: spline, points: [[0, 0, 0], [0, 0, 1]]}", "9:14: E300 the normal is tangent to the curve somewhere; it must point out of the surface"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0], [0, 0, 0]]}", "9:14: E300 the curve turns by 180 deg at once near (1, 0, 0), where the tool would have to stop; round it, or end the curve there and begin another task"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0], [1, 1, 0]], closed: true}", "9:37: E300 a closed spline ends with the point it begins with"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0], [0, 0, 0]], closed: true}", "9:37: E300 a closed spline needs three different points or more"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0]], normals: [[0, 0, 1]]}", "9:70: E200 a list of 1 is too short; at least 2 are needed"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0], [2, 0, 0]], normals: [[0, 0, 1], [0, 0, 1]]}", "9:72: E200 'normals' needs one entry for each of 'points'"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0]], normals: [[0, 0, 1], [0, 0, 0]]}", "9:82: E300 a normal of no length points nowhere; give a direction such as [0, 0, 1]"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0]], normals: [[0, 0, 1], [1, 0, 0]]}", "9:70: E300 the normal is tangent to the curve somewhere; it must point out of the surface"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0]], normals: [[0, 0, 1], [0, 0.002, -1]]}", "9:70: E300 the normal turns over at once near (0.5, 0, 0); give normals of one side"),
        ("{kind: spline, points: [[0, 0, 0], [1, 0, 0]], normals: [[0, 0, 1], [0, 0, 1]], normal: [0, 0, 1]}", "9:94: E200 'normal' does not go with 'normals'; keep one"),
        ("{kind: poses, file: none.csv}", "9:34: E500 there is no file 'none.csv' here"),
        ("{kind: poses, file: /etc/passwd}", "9:34: E500 '/etc/passwd' must be a relative path with forward slashes"),
        ("{kind: poses, file: 3}", "9:34: E200 must be text (in quotes, if it looks like a number), not 3"),
    ],
)  # fmt: skip
def test_curves_that_are_none(
    curve: str, expected: str, seam: Path, change: Change, messages: Messages
) -> None:
    """Place and words, one message each."""
    change("tasks.yaml", CURVE, curve)
    assert messages(lambda: load_job("tasks.yaml")) == [f"tasks.yaml:{expected}"]


@pytest.mark.parametrize(
    ("csv", "expected"),
    [
        ("", ["seam.csv:1:1: E300 the first line must name the columns x, y, z, qx, qy, qz, qw, with commas between them; missing: x, y, z, qx, qy, qz, qw"]),
        (COLUMNS, ["seam.csv: E300 a path needs two poses or more"]),
        (COLUMNS + "0,0,0,0,0,0,1\n" * 3, ["seam.csv:3:1: E300 the same pose as the one before; remove it", "seam.csv:4:1: E300 the same pose as the one before; remove it"]),
        (COLUMNS + "nan,0,0,0,0,0,1\n0,1e300,0,0,0,0,1\n0,0,0,0,0,0,0\n", ["seam.csv:2:1: E300 x: 'nan' is outside the range of -1000 to 1000", "seam.csv:3:1: E300 y: '1e300' is outside the range of -1000 to 1000", "seam.csv:4:1: E300 a quaternion must have length 1, not 0; divide by its length"]),
        (COLUMNS + "0,0,0,0,0,0,1\n0.1,0,0,0,0,0,1\n0.1,0,0,0,0,1,0\n", ["tasks.yaml:9:34: E300 its poses 2 and 3 are at one place; a curve turns only while it advances"]),
        (COLUMNS + "0,0,0,0,0,0,1\n0.1,0,0,0,0,0,1\n0,0,0,0,0,0,1\n", ["tasks.yaml:9:34: E300 the curve turns by 180 deg at once near (0.1, 0, 0), where the tool would have to stop; round it, or end the curve there and begin another task"]),
        (COLUMNS + "0,0,0,0,0,0,1\n2e-6,0,0,0,0,0,1\n", ["tasks.yaml:9:34: E300 the curve is 0.002 mm long; make it longer"]),
    ],
)  # fmt: skip
def test_files_of_poses_that_are_no_curve(
    csv: str, expected: list[str], seam: Path, change: Change, messages: Messages
) -> None:
    """Lines of the file, or the key that names it."""
    change("tasks.yaml", CURVE, "{kind: poses, file: seam.csv}")
    (seam / "seam.csv").write_text(csv)
    assert messages(lambda: load_job("tasks.yaml")) == expected


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("slave: right", "slave: left", "8:7: E200 master and slave are the same arm; without a master leave the key out"),
        ("slave: right", "slave: middle", "8:14: E200 'middle' is not allowed; allowed: left, right"),
        ("      slave: right\n", "", "7:7: E202 'slave' is missing"),
        ("slave: right", "slave: right\n      slowr: allowed", "9:7: E201 unknown key 'slowr', did you mean 'slower'?"),
        ("      part: {xyz: [0, 0, 200 mm]}\n", "", "7:7: E202 'part' is missing"),
        ("part: {xyz", "part: {in: bin, xyz", "10:7: E200 'in' does not go with a master: the part is in its flange"),
        ("      speed: 50 mm/s\n", "", "7:7: E200 give 'speed' or 'duration', one of them"),
        ("speed: 50 mm/s", "speed: 50 mm/s\n      duration: 4 s", "12:7: E200 give 'speed' or 'duration', one of them"),
        ("speed: 50 mm/s", "speed: 0", "11:14: E200 0: speed must be positive"),
        ("speed: 50 mm/s", "speed: 50 mm", "11:14: E200 unit 'mm' in '50 mm' is not one of speed; allowed: m/s, mm/s"),
        ("speed: 50 mm/s", "duration: 0 s", "11:17: E200 '0 s': time must be at least 0.001 s"),
        ("speed: 50 mm/s", "duration: .inf", "11:17: E104 non-finite number '.inf' is not allowed"),
        ("speed: 50 mm/s", "speed: 1\n      acceleration: 0", "12:21: E200 0: acceleration must be positive"),
        ("speed: 50 mm/s", "speed: 1\n      slower: yes", "12:15: E200 'yes' is not allowed; allowed: allowed, forbidden"),
        ("speed: 50 mm/s", "speed: 1\n      not_before: -1 s", "12:19: E200 '-1 s': time must be at least 0"),
        ("speed: 50 mm/s", "speed: 1\n      downhand: 4", "12:17: E200 4: angle must be at most 3.1 rad"),
        ("speed: 50 mm/s", "speed: 1\n      tool: {tilt: -1 deg}", "12:20: E200 '-1 deg': angle must be at least 0"),
        ("speed: 50 mm/s", "speed: 1\n      tool: {tilt: 90 deg}", "12:20: E200 '90 deg': angle must be at most 57.2958 deg"),
        ("speed: 50 mm/s", "speed: 1\n      tool: {standoff: -1 mm}", "12:24: E200 '-1 mm': length must be at least 0"),
        ("speed: 50 mm/s", "speed: 1\n      tool: {free: spinn}", "12:20: E200 'spinn' is not allowed, did you mean 'spin'? Allowed: spin, none"),
        ("speed: 50 mm/s", "speed: 1\n      entry: {retract: 1 mm}", "12:15: E201 unknown key 'retract'; allowed: approach, dwell, duration"),
        ("speed: 50 mm/s", "speed: 1\n      exit: {dwell: -1}", "12:21: E200 -1: time must be at least 0"),
        ("speed: 50 mm/s", "speed: 1\n      touches: [tabel]", "12:17: E300 there is no body 'tabel', did you mean 'table'?"),
        ("speed: 50 mm/s", "speed: 1\n      posture: bend", "12:16: E300 Tiny has no posture 'bend', did you mean 'bent'?"),
        ("speed: 50 mm/s", "speed: 1\n      hold: stil", "12:13: E200 'stil' is not allowed, did you mean 'still'? Allowed: free, still"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {}", "12:13: E200 give free, still, a pose (xyz, rpy) or a curve (way)"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {way: {}}", "12:14: E200 no curve; give through or poses"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {mode: free, xyz: [0, 0, 0]}", "12:26: E200 'xyz' does not go with 'mode'; keep one"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {mode: still, in: bin}", "12:27: E200 'in' goes with a pose; the poses of a curve have their own"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {mode: still, rpy: [0, 0, 0]}", "12:27: E200 a pose needs xyz"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {xyz: [0, 0, 0], in: bun}", "12:34: E300 the cell has no frame 'bun', did you mean 'bin'?"),
        ("speed: 50 mm/s", "speed: 1\n      hold: {way: {through: [{xyz: [0, 0, 1], rpy: [0, 0, 0]}, {xyz: [1, 0, 1]}, {xyz: [1, 1, 1]}]}}", "12:19: E300 a part cannot follow a curve with corners, where it would have to stop; join its pieces smoothly"),
        ("master: left\n      slave: right", "slave: right\n      hold: still", "8:7: E200 'hold' needs a master; without one 'part' says where the part is"),
        ("      master: left\n", "      downhand: 10 deg\n", "7:7: E200 'downhand' needs a master that can turn the part"),
        ("    coordinate", "    arm: left\n    coordinate", "6:10: E300 'arm' does not go with a coordinate task; it names master and slave itself"),
        ("    coordinate", "    approach: 1 mm\n    coordinate", "6:15: E300 'approach' does not go with a coordinate task; write it into its entry"),
        ("    coordinate", "    not_before: 1 s\n    coordinate", "6:17: E300 'not_before' goes with picks, places and moves only; remove it"),
        ("    coordinate", "    retract: 1 mm\n    coordinate", "6:14: E300 'retract' does not go with a coordinate task; write it into its exit"),
        ("    coordinate", "    dwell: {gripper: 1}\n    coordinate", "6:12: E300 'dwell' does not go with a coordinate task; write it into its entry and exit"),
    ],
)  # fmt: skip
def test_tasks_that_are_none(
    old: str, new: str, expected: str, seam: Path, change: Change, messages: Messages
) -> None:
    """Place and words, one message each."""
    change("tasks.yaml", old, new)
    (message,) = messages(lambda: load_job("tasks.yaml"))
    assert message.startswith(f"tasks.yaml:{expected}")


def test_all_errors_come_at_once(seam: Path, change: Change, messages: Messages) -> None:
    """Of the curve, the touches, the hold and a task of its own beside."""
    change(
        "tasks.yaml",
        CURVE,
        "{kind: poses, file: none.csv}",
        "      speed: 50 mm/s\n",
        "      speed: 50 mm/s\n      touches: [nobody]\n      hold: {in: nowhere, xyz: [0, 0, 0]}\n"
        "  - id: other\n    arm: left\n    move: {joints: [0]}\n",
    )
    found = [text.split(": ")[0] for text in messages(lambda: load_job("tasks.yaml"))]
    assert found == ["tasks.yaml:9:34", "tasks.yaml:12:17", "tasks.yaml:13:18", "tasks.yaml:16:20"]


def test_an_arm_that_the_robot_does_not_have(
    seam: Path, change: Change, messages: Messages
) -> None:
    """A robot with a left arm only."""
    change(
        "robot.yaml",
        "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n",
        "",
        "  r1: {acceleration: 10, jerk: none, source: datasheet}\n  r2: {acceleration: 10, jerk: none, source: datasheet}\n",
        "",
        "postures: {bent: {l1: 90 deg, r1: -1.5}}",
        "postures: {bent: {l1: 90 deg}}",
    )
    found = messages(lambda: load_job("tasks.yaml"))
    assert any("Tiny has no right arm; it has left" in text for text in found), found


def test_the_shipped_curves_are_table_2_s(tasks_folder: Path) -> None:
    """[Qin2024] Table 2: saddle of 50 and 45 mm at 90 deg; ball of 50 mm and tube of 20 mm at 0; no eccentricity."""
    job = load_job(tasks_folder / "papers" / "qin_curves" / "tasks.yaml")
    seams = {task.id: task.seam for task in job.tasks}
    assert list(seams) == ["saddle", "arc"]
    found = {name: work.curve for name, work in seams.items() if work is not None}
    expected = {
        "saddle": Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, TURN),
        "arc": SphereArc(0.05, 0.02, 0.0, 0.0, 0.0, TURN),
    }
    assert {name: curve.contour for name, curve in found.items()} == expected
    assert round(found["saddle"].length, 5) == 0.30874
    assert found["arc"].length == pytest.approx(0.04 * np.pi)
