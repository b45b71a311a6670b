"""schedule.json: lossless, the same bytes every time, never a NaN."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.exporting import schedule_json
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.exporting.schedule_reader import read_schedule
from dualarm_cli.model.motion.joint_motion import JointMotion


def written(schedule, files=None):
    """Returns the whole document."""
    return b"".join(to_json(schedule, "robot.urdf", files or {}))


def test_what_is_read_is_what_was_written_bit_for_bit(schedule, folder):
    """Every field; -0.0, the smallest and the largest double among the positions."""
    read = read_schedule(folder)
    for name in ("time", "position", "velocity", "acceleration"):
        one, two = (getattr(s.trajectory, name) for s in (schedule, read))
        assert one.tobytes() == two.tobytes(), name
    for name in ("lower", "upper", "velocity", "acceleration", "jerk"):
        one, two = (getattr(s.robot.limits, name) for s in (schedule, read))
        assert one.tobytes() == two.tobytes(), name
    assert read.robot.limits.joints == schedule.robot.limits.joints
    assert read.robot.limits.source == schedule.robot.limits.source
    for name in ("name", "urdf", "platform", "tool_speed"):
        assert getattr(read.robot, name) == getattr(schedule.robot, name)
    for name in ("stages", "segments", "provenance", "lower_bound", "notes"):
        assert getattr(read, name) == getattr(schedule, name)
    assert read.trajectory.joints == schedule.trajectory.joints
    for one, two in zip(schedule.events, read.events, strict=True):
        assert dataclasses.replace(two, pose=one.pose) == one
    left, again = schedule.robot.arms["left"], read.robot.arms["left"]
    assert (left.flange, left.joints) == (again.flange, again.joints)


def test_poses_survive_as_quaternions_to_the_last_digits(schedule, folder):
    """Translations bit for bit, rotations within rounding of a quaternion's square."""
    read = read_schedule(folder)
    pairs = [
        (schedule.robot.base, read.robot.base),
        (schedule.robot.arms["left"].tcp, read.robot.arms["left"].tcp),
        *((one.pose, two.pose) for one, two in zip(schedule.events, read.events, strict=True)),
    ]
    for one, two in pairs:
        assert one.translation.tobytes() == two.translation.tobytes()
        assert np.abs(one.rotation - two.rotation).max() < 2e-15


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("angle", [0.1, np.pi - 0.1, np.pi, np.pi + 0.1, 6.0])
def test_every_rotation_is_written_with_w_not_negative(schedule, axis, angle):
    """One of two quaternions: cos(angle / 2) is negative beyond half a turn."""
    R = pin.utils.rotate(axis, angle)
    base = pin.SE3(R, np.zeros(3))
    robot = dataclasses.replace(schedule.robot, base=base)
    document = json.loads(written(dataclasses.replace(schedule, robot=robot)))
    x, y, z, w = document["robot"]["base"]["quat_xyzw"]
    assert w >= 0
    assert w == pytest.approx(abs(np.cos(angle / 2)), abs=1e-15)
    assert np.allclose(pin.Quaternion(w, x, y, z).toRotationMatrix(), R, rtol=0, atol=1e-14)


def test_the_same_schedule_gives_the_same_bytes(schedule):
    """Twice."""
    files = {"schedule.csv": "00"}
    assert written(schedule, files) == written(schedule, files)


def test_members_stand_in_the_order_in_which_a_person_reads_them(schedule):
    """Format first, motion late, judgement last; one event, stage and segment per line."""
    text = written(schedule).decode()
    assert list(json.loads(text)) == [
        "format",
        "robot",
        "duration",
        "lower_bound",
        "grid_gap",
        "order_grid_gap",
        "clearance_cost",
        "blend_gain",
        "stages",
        "segments",
        "events",
        "motion",
        "provenance",
        "notes",
        "files",
        "verification",
    ]
    assert sum('"action":' in line for line in text.splitlines()) == 6
    assert json.loads(text)["verification"]["passed"] is True
    assert json.loads(text)["robot"]["limits"]["turn"]["jerk"] is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_no_nan_is_ever_written(schedule, value):
    """A plan with a NaN is a bug: the writer refuses it."""
    position = np.array(schedule.trajectory.position)
    position[3, 1] = value
    trajectory = dataclasses.replace(schedule.trajectory, position=position)
    with pytest.raises(ValueError, match="not JSON compliant"):
        written(dataclasses.replace(schedule, motion=JointMotion.of(trajectory)))


def test_a_file_name_that_is_no_utf8_is_written_and_read(schedule, tmp_path):
    """The byte E9 arrives from the file system as a lone surrogate; the document stays UTF-8."""
    name = b"caf\xe9.yaml".decode("utf-8", "surrogateescape")
    provenance = dataclasses.replace(schedule.provenance, inputs={name: "ab"})
    content = written(dataclasses.replace(schedule, provenance=provenance))
    content.decode("utf-8")
    (tmp_path / "schedule.json").write_bytes(content)
    (tmp_path / "robot.urdf").write_text(schedule.robot.urdf)
    assert read_schedule(tmp_path).provenance.inputs == {name: "ab"}


def test_a_reason_is_written_where_there_is_one(schedule):
    """Of four segments one waits for a reason; the others say nothing, as before there were reasons."""
    rows = json.loads(written(schedule))["segments"]
    assert [row.get("reason") for row in rows] == [None, None, "shared_zone", None]


def test_the_document_is_the_one_that_json_would_write(schedule, monkeypatch):
    """Blocks of one to eight knots of seven: each member as Python's own writer has it, rows on lines of their own."""
    whole = written(schedule)
    for knots in range(1, 9):
        monkeypatch.setattr(schedule_json, "BLOCK", knots)
        assert written(schedule) == whole
    document = json.loads(whole)
    lines = []
    for key, value in document.items():
        text = json.dumps(value, ensure_ascii=False)
        if key in ("stages", "segments", "events"):
            rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in value)
            text = f"[\n  {rows}\n ]"
        if key == "motion":
            text = f'{{\n  "all": {json.dumps(value["all"])}\n }}'
        lines.append(f' "{key}": {text}')
    assert whole.decode() == "{\n" + ",\n".join(lines) + "\n}\n"


def test_lists_without_entries_are_empty(schedule):
    """No line of their own."""
    empty = dataclasses.replace(schedule, stages=(), segments=(), events=())
    assert written(empty).count(b": [],\n") >= 3
    assert json.loads(written(empty))["events"] == []


def test_a_reader_that_follows_the_reference_has_the_same_doubles(
    plain_motion, tmp_path, tasks_folder
):
    """A plan of two arms and a platform; sums of Python's own, knot by knot."""
    command = ["plan", str(tasks_folder / "01_first_pick" / "tasks.yaml"), "--out", str(tmp_path)]
    assert run([*command, "--effort", "quick", "--no-page"]) == 0
    document = json.loads((tmp_path / "schedule.json").read_bytes())
    motion = read_schedule(tmp_path).motion
    assert list(motion.groups) == list(document["robot"]["groups"]) == ["platform", "left", "right"]
    for name, group in motion.groups.items():
        rows = plain_motion.knots(document, name)
        assert len(document["motion"][name]["anchor"]) < len(rows) / 5 or len(rows) < 20
        for k, values in enumerate(
            (group.time, group.position, group.velocity, group.acceleration)
        ):
            assert np.array([row[k] for row in rows]).tobytes() == values.tobytes()
