"""The reader: every defect of the structure is bad input with its path, every defect of the motion a finding."""

from __future__ import annotations

import gc
import json
import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.exporting import json_reader
from dualarm_cli.exporting.schedule_reader import read_schedule, torn_files
from dualarm_cli.verification import verify

MISSING = object()


def edit(folder, path, value):
    """Sets or removes a member of schedule.json; a path is a list of keys and indices."""
    file = folder / "schedule.json"
    document = json.loads(file.read_bytes())
    *parents, last = path
    part = document
    for step in parents:
        part = part[step]
    if value is MISSING:
        del part[last]
    else:
        part[last] = value
    file.write_text(json.dumps(document))


def message(folder):
    """Returns what the reader says of a folder that it refuses."""
    with pytest.raises(InputError) as caught:
        read_schedule(folder)
    (diagnostic,) = caught.value.diagnostics
    assert diagnostic.file == str(folder / "schedule.json")
    assert len(diagnostic.message) < 200
    return diagnostic.message


ROW = [0.0, 0.0]
HUGE = 10**400
DEFECTS = [
    (["format"], MISSING, "format: "),
    (
        ["format"],
        "dualarm.schedule/1",
        "format: is 'dualarm.schedule/1', not 'dualarm.schedule/2'; plan again with this version",
    ),
    (["format"], 1, "format: "),
    (["robot"], MISSING, "robot: is missing"),
    (["robot"], [], "robot: must be an object"),
    (["robot", "name"], 3, "robot.name: must be text"),
    (["robot", "joints"], MISSING, "robot.joints: is missing"),
    (["robot", "joints"], "turn", "robot.joints: must be a list of names"),
    (["robot", "joints"], ["turn", 1], "robot.joints: must be a list of names"),
    (["robot", "joints"], [], "robot.joints: must name every joint once"),
    (["robot", "joints"], ["turn", "turn"], "robot.joints: must name every joint once"),
    (["robot", "joints"], ["turn"], "robot.groups: must name every joint of robot.joints in one"),
    (["robot", "urdf"], MISSING, "robot.urdf: "),
    (["robot", "urdf"], "", "robot.urdf: "),
    (["robot", "urdf"], 7, "robot.urdf: must be text"),
    (["robot", "urdf"], "../robot.urdf", "robot.urdf: '../robot.urdf' must lie in"),
    (["robot", "urdf"], "/etc/passwd", "robot.urdf: '/etc/passwd' must lie in"),
    (["robot", "urdf"], "other.urdf", "robot.urdf: 'other.urdf' in the schedule's folder: cannot be read"),
    (["robot", "urdf"], ".", "robot.urdf: '.' in the schedule's folder: is "),
    (["robot", "urdf"], "a\0b", "robot.urdf: "),
    (["robot", "urdf"], "\ud800", "robot.urdf: "),
    (["robot", "base"], MISSING, "robot.base: must have xyz and quat_xyzw"),
    (["robot", "base", "xyz"], MISSING, "robot.base.xyz: is missing"),
    (["robot", "base", "xyz"], [0, 0], "robot.base.xyz: must have shape (3,), not (2,)"),
    (["robot", "base", "xyz"], ["1", "2", "3"], "robot.base.xyz: must be numbers"),
    (["robot", "base", "xyz"], [None, 0, 0], "robot.base.xyz: must be numbers"),
    (["robot", "base", "xyz"], [0, 0, float("nan")], "robot.base: must be finite"),
    (["robot", "base", "quat_xyzw"], [0, 0, 0, 0], "robot.base.quat_xyzw: must be of unit length"),
    (["robot", "base", "quat_xyzw"], [0, 0, 0, 1e308], "robot.base.quat_xyzw: must be of unit"),
    (["robot", "base", "quat_xyzw"], [0, 0, 0, 1.00001], "robot.base.quat_xyzw: must be of unit"),
    (["robot", "base", "quat_xyzw"], [0, 0, 0, HUGE], "robot.base.quat_xyzw: must be numbers"),
    (["robot", "platform"], ["waist"], "robot.platform: must name joints of robot.joints"),
    (["robot", "platform"], [["turn"]], "robot.platform: must be a list of names"),
    (["robot", "platform"], "turn", "robot.platform: must be a list of names"),
    (["robot", "arms"], MISSING, "robot.arms: is missing"),
    (["robot", "arms", "../up"], {}, "robot.arms: must be left, right or both"),
    (["robot", "arms", "left"], 1, "robot.arms.left: must be an object"),
    (["robot", "arms", "left", "flange"], None, "robot.arms.left.flange: must be text"),
    (["robot", "arms", "left", "tcp"], MISSING, "robot.arms.left.tcp: must have xyz"),
    (["robot", "arms", "left", "joints"], [{}], "robot.arms.left.joints: must be a list of names"),
    (["robot", "arms", "left", "joints"], ["x"], "robot.arms.left.joints: must name joints of"),
    (["robot", "limits"], [1], "robot.limits: must be an object"),
    (["robot", "limits", "turn"], 5, "robot.limits.turn: must be an object"),
    (["robot", "limits", "turn", "jerk"], "9", "robot.limits.turn.jerk: must be a finite number"),
    (["robot", "limits", "turn", "jerk"], HUGE, "robot.limits.turn.jerk: must be a finite number"),
    (["robot", "limits", "turn", "jerk"], True, "robot.limits.turn.jerk: must be a finite number"),
    (["robot", "limits", "turn", "velocity"], 0.0, "robot.limits: velocity limits must be positive"),
    (["robot", "limits", "lift", "upper"], -5.0, "robot.limits: a lower position limit is above"),
    (["robot", "tool_speed"], "fast", "robot.tool_speed: must be a finite number"),
    (["duration"], float("nan"), "duration: must be a finite number"),
    (["duration"], "long", "duration: must be a finite number"),
    (["lower_bound"], [1], "lower_bound: must be a finite number"),
    (["motion"], MISSING, "motion: is missing"),
    (["motion", "all"], MISSING, "motion.all: is missing"),
    (["motion", "all"], [0.0], "motion.all: must be an object"),
    (["motion", "all", "time"], MISSING, "motion.all.time: is missing"),
    (["motion", "all", "time"], [], "motion.all.time: is empty"),
    (["motion", "all", "time"], [[0.0]] * 7, "motion.all.time: must have shape (7,), not (7, 1)"),
    (["motion", "all", "time", 3], "0.3", "motion.all.time: must be numbers"),
    (["motion", "all", "time", 3], None, "motion.all.time: must be numbers"),
    (["motion", "all", "position"], MISSING, "motion.all.position: is missing"),
    (["motion", "all", "position"], [ROW] * 6, "motion.all.position: must have shape (7, 2)"),
    (["motion", "all", "velocity", 2], [0.0], "motion.all.velocity: must be numbers, in rows of"),
    (["motion", "all", "velocity", 2], {}, "motion.all.velocity: must be numbers"),
    (["motion", "all", "acceleration", 2, 1], "1", "motion.all.acceleration: must be numbers"),
    (["motion", "all", "acceleration"], [ROW] * 8, "motion.all.acceleration: must have shape (7,"),
    (["motion", "all", "anchor"], MISSING, "motion.all.anchor: is missing"),
    (["motion", "all", "anchor"], [], "motion.all.anchor: is empty"),
    (["motion", "all", "anchor", 0], 1, "motion.all.anchor: must be knots that rise from 0 to 6"),
    (["motion", "all", "anchor", 6], 7, "motion.all.anchor: must be knots that rise from 0 to 6"),
    (["motion", "all", "anchor", 6], HUGE, "motion.all.anchor: must be numbers"),
    (["motion", "all", "anchor", 2], 1, "motion.all.anchor: must be knots that rise from 0 to 6"),
    (["motion", "all", "anchor", 2], 1.5, "motion.all.anchor: must be knots that rise from 0 to"),
    (["motion", "all", "anchor", 2], float("nan"), "motion.all.anchor: must be knots that rise"),
    (["robot", "groups"], MISSING, "robot.groups: is missing"),
    (["robot", "groups"], {}, "robot.groups: must name every joint of robot.joints in one group"),
    (["robot", "groups", "all"], ["turn"], "robot.groups: must name every joint of robot.joints"),
    (["robot", "groups", "two"], ["lift"], "robot.groups: must name every joint of robot.joints"),
    (["robot", "groups", "all"], "turn", "robot.groups.all: must be a list of names"),
    (["events", 0, "velocity"], [0.1, 0], "events[0].velocity: must have shape (3,), not (2,)"),
    (["events", 0, "velocity"], "fast", "events[0].velocity: must be numbers"),
    (["events", 0, "velocity"], [0, 0, float("inf")], "events[0].velocity: must be finite"),
    (["stages"], {}, "stages: must be a list"),
    (["stages", 1], 0, "stages[1]: must be an object"),
    (["stages", 1, "start"], MISSING, "stages[1].start: is missing"),
    (["stages", 1, "end"], None, "stages[1].end: is missing"),
    (["stages", 0, "tasks"], "a", "stages[0].tasks: must be a list of names"),
    (["stages", 0, "arm_times"], [1], "stages[0].arm_times: must be an object"),
    (["stages", 0, "arm_times", "left"], "x", "stages[0].arm_times.left: must be a finite number"),
    (["stages", 0, "bottleneck"], 4, "stages[0].bottleneck: must be text"),
    (["stages", 2, "arm"], ["left"], "stages[2].arm: must be text"),
    (["stages", 2, "arm"], "right", "stages[2].arm: 'right' is not one of left"),
    (["segments", 0, "kind"], "fly", "segments[0].kind: 'fly' is not one of transfer, approach"),
    (["segments", 1, "dwell", "settle"], "x", "segments[1].dwell.settle: must be a finite number"),
    (["segments", 1, "start"], float("inf"), "segments[1].start: must be a finite number"),
    (["segments", 2, "reason"], "tea", "segments[2].reason: 'tea' is not one of platform, partner, "),
    (["segments", 2, "reason"], 1, "segments[2].reason: must be text"),
    (["events"], 3, "events: must be a list"),
    (["events", 1, "time"], float("nan"), "events[1].time: must be a finite number"),
    (["events", 1, "time"], HUGE, "events[1].time: must be a finite number"),
    (["events", 1, "arm"], ["left"], "events[1].arm: must be text"),
    (["events", 1, "xyz"], "here", "events[1].xyz: must be numbers"),
    (["events", 1, "quat_xyzw"], [1, 0, 0], "events[1].quat_xyzw: must have shape (4,)"),
    (["events", 0, "dwell"], "1", "events[0].dwell: must be a finite number"),
    (["notes"], 5, "notes: must be a list of names"),
    (["files"], [], "files: must be an object"),
    (["files", "report.json"], 1, "files.report.json: must be text"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    DEFECTS,
    ids=[f"{'.'.join(map(str, path))}-{k}" for k, (path, _, _) in enumerate(DEFECTS)],
)
def test_a_defect_of_the_structure_is_bad_input_with_its_path(folder, path, value, expected):
    """Missing, of the wrong type, of the wrong shape, or impossible."""
    edit(folder, path, value)
    assert message(folder).startswith(expected)


@pytest.mark.parametrize(
    "path",
    [
        ["lower_bound"],
        ["duration"],
        ["stages"],
        ["segments"],
        ["events"],
        ["notes"],
        ["files"],
        ["provenance"],
        ["verification"],
        ["robot", "limits"],
        ["robot", "platform"],
        ["robot", "tool_speed"],
        ["robot", "name"],
        ["robot", "limits", "turn"],
        ["robot", "arms", "left", "joints"],
        ["stages", 2, "arm"],
        ["segments", 1, "dwell"],
        ["segments", 2, "reason"],
        ["events", 0, "dwell"],
    ],
)
def test_what_other_programs_may_leave_out_may_be_missing(folder, path):
    """A schedule made elsewhere states motion, robot and arms; the rest is optional."""
    edit(folder, path, MISSING)
    read_schedule(folder)


@pytest.mark.parametrize(
    ("content", "expected", "line"),
    [
        (b"", "schedule: is not JSON: Expecting value", 1),
        (b'{\n"format": 1,\n}', "schedule: is not JSON: ", 3),
        (b"[]", "schedule: must be an object", 0),
        (b"null", "schedule: must be an object", 0),
        (b'{"a": "\xff"}', "schedule: is not JSON in UTF-8, or is nested too deeply", 0),
        (b"[" * 100_000, "schedule: is not JSON in UTF-8, or is nested too deeply", 0),
        (b'{"a":' * 100_000, "schedule: is not JSON in UTF-8, or is nested too deeply", 0),
        (b'{"a": ' + b"9" * 5000 + b"}", "schedule: is not JSON in UTF-8, or is nested", 0),
        (b'{"format": 1, "format": 2}', "format: is used twice", 0),
    ],
    ids=["empty", "comma", "list", "null", "latin", "lists", "objects", "digits", "twice"],
)
def test_what_is_no_json_is_refused_with_its_line(folder, content, expected, line):
    """No crash at any depth or length."""
    (folder / "schedule.json").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_schedule(folder)
    (diagnostic,) = caught.value.diagnostics
    if line:  # the wording is Python's own and varies; the place does not
        assert diagnostic.line in (line, line - 1)
    assert diagnostic.message.startswith(expected)


def test_a_schedule_nested_deep_within_a_member_is_refused(folder):
    """Numbers within a thousand lists."""
    text = (folder / "schedule.json").read_text()
    deep = text.replace('"time": [0.0', '"time": [' + "[" * 500 + "0.0" + "]" * 500, 1)
    assert deep != text
    (folder / "schedule.json").write_text(deep)
    assert message(folder).startswith(("motion.all.time: must", "schedule: is not JSON"))


def test_a_file_that_is_not_there_a_pipe_and_a_giant_are_refused(tmp_path, monkeypatch):
    """None is opened; a pipe would be waited for without end."""
    with pytest.raises(InputError, match="there is no such file"):
        read_schedule(tmp_path)
    os.mkfifo(tmp_path / "schedule.json")
    with pytest.raises(InputError, match="there is no such file"):
        read_schedule(tmp_path)
    (tmp_path / "schedule.json").unlink()
    with (tmp_path / "schedule.json").open("wb") as file:
        file.truncate(4_000_000_001)  # sparse: takes no space
    with pytest.raises(InputError, match="is larger than 4000 MB"):
        read_schedule(tmp_path)


@pytest.mark.parametrize("indent", [None, 1])
def test_a_schedule_read_in_small_pieces_is_the_same(folder, monkeypatch, indent):
    """Wherever a piece ends: within numbers, names, escapes, characters of three bytes; against Python's reader."""
    file = folder / "schedule.json"
    document = json.loads(file.read_bytes())
    document["notes"] = ["\u2603 snow", '\U0001f600 \\ "', "x" * 300]
    motion = document["motion"]["all"]
    assert motion["anchor"] == list(range(7))
    motion["velocity"][2] = [float("nan"), -float("inf")]
    for ascii_only in (True, False):
        file.write_text(json.dumps(document, indent=indent, ensure_ascii=ascii_only), "utf-8")
        for block in (1, 2, 3, 7, 64, 1 << 20):
            sizes = replace(json_reader.JSON, block=block, batch=block)
            monkeypatch.setattr(json_reader, "JSON", sizes)
            read = read_schedule(folder)
            for name in ("time", "position", "velocity", "acceleration"):
                expected = np.array(motion[name])
                assert getattr(read.trajectory, name).tobytes() == expected.tobytes()
            assert list(read.notes) == document["notes"]
            assert [segment.kind for segment in read.segments] == [
                row["kind"] for row in document["segments"]
            ]


def test_a_defect_far_down_is_told_with_its_line(folder, monkeypatch):
    """Pieces of 64 bytes; the line is counted by hand: the comma is taken from before the last member."""
    monkeypatch.setattr(json_reader, "JSON", replace(json_reader.JSON, block=64))
    file = folder / "schedule.json"
    lines = file.read_text().split("\n")
    [at] = [k for k, line in enumerate(lines) if line.startswith(' "verification"')]
    lines[at - 1] = lines[at - 1].removesuffix(",")
    file.write_text("\n".join(lines))
    with pytest.raises(InputError) as caught:
        read_schedule(folder)
    (diagnostic,) = caught.value.diagnostics
    assert diagnostic.message.startswith("schedule: is not JSON: Expecting ',' delimiter")
    assert diagnostic.line == at + 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('"motion": {"a": {"time": [' + "0," * 3000, "motion.a.time: has more than 1,000 numbers"),
        ('"motion": {"x": [' + "[0,0]," * 3000, "motion.x: has more than 1,000 numbers"),
        (
            '"motion": {' + '"a": {"x": [' + "0," * 600 + '0]}, "b": {"x": [' + "0," * 600,
            "motion.b.x: has more than 399 numbers",
        ),
        ('"motion": {"a": {"b": {"c": [' + "0," * 3000, "schedule: is not JSON: A value is too"),
        ('"stages": [' + "{}," * 3000, "stages: has more than 1,000 entries"),
        ('"notes": [' + '"",' * 3000, "notes: has more than 1,000 entries"),
        ('"name": "' + "x" * 5000, "schedule: is not JSON: A value is too long"),
        ('"a": {"b": [' + "0," * 5000, "schedule: is not JSON: A value is too long"),
        ('"stages": [' + "[" * 900 + "0," * 5000, "schedule: is not JSON: A value is too long"),
    ],
)
def test_what_would_fill_the_memory_is_refused_before_it_does(folder, monkeypatch, text, expected):
    """Each limit made small; none of these texts ends."""
    limits = replace(json_reader.JSON, numbers=1000, rows=1000, batch=256, value=2000, block=128)
    monkeypatch.setattr(json_reader, "JSON", limits)
    (folder / "schedule.json").write_text("{" + text)
    assert message(folder).startswith(expected)


def test_reading_takes_memory_for_the_numbers_and_not_for_their_text(folder):
    """60,000 knots, 9 MB of text: as Python's objects its numbers would be 13 MB, as doubles they are 3."""
    knots = 60_000
    random = np.random.default_rng(0)
    file = folder / "schedule.json"
    document = json.loads(file.read_bytes())
    document["motion"]["all"] = {
        "time": np.linspace(0.0, 100.0, knots).tolist(),
        "anchor": list(range(knots)),
        **{
            name: random.normal(size=(knots, 2)).tolist()
            for name in ("position", "velocity", "acceleration")
        },
    }
    tables = document["motion"]["all"]
    expected = {name: np.array(table) for name, table in tables.items() if name != "anchor"}
    del tables
    file.write_text(json.dumps(document))
    size = file.stat().st_size
    del document
    gc.collect()
    tracemalloc.start()
    try:
        read = read_schedule(folder)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert all(np.array_equal(getattr(read.trajectory, name), x) for name, x in expected.items())
    assert size > 9_000_000
    # Reading the shortest schedule takes 18 MB.
    assert most < 20_000_000 + size


def test_a_urdf_that_is_a_pipe_or_a_link_out_or_around_is_refused(folder):
    """What the name leads to counts, not the name."""
    urdf = folder / "robot.urdf"
    text = urdf.read_text()
    urdf.unlink()
    os.mkfifo(urdf)
    assert "is not a regular file" in message(folder)
    urdf.unlink()
    (folder.parent / "secret.urdf").write_text(text)
    urdf.symlink_to(folder.parent / "secret.urdf")
    assert "must lie in the schedule's own folder" in message(folder)
    urdf.unlink()
    urdf.symlink_to(urdf)
    assert message(folder).startswith("robot.urdf: ")
    urdf.unlink()
    urdf.write_bytes(b"\xff\xfe")
    assert "UTF-16 or UTF-32" in message(folder)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["time", "position", "velocity", "acceleration"])
def test_numbers_of_the_motion_that_are_not_finite_are_findings_and_no_crash(folder, name, value):
    """They are read as they are; the verifier says where they are."""
    path = ["motion", "all", name, 3] + ([] if name == "time" else [1])
    edit(folder, path, value)
    schedule = read_schedule(folder)
    assert np.array_equal(
        np.ravel(getattr(schedule.trajectory, name)[3])[-1], value, equal_nan=True
    )
    failed = {check.name: check.detail for check in verify(schedule).failures}
    assert failed == {"finite": f"1 in {name} not finite"}


def test_the_stated_judgement_is_not_believed(folder):
    """`passed` in the file is nothing that the reader takes over."""
    assert read_schedule(folder).verification is None


def test_a_schedule_is_found_by_its_folder_and_by_its_name(folder, schedule):
    """Both give the same motion."""
    one, two = read_schedule(folder), read_schedule(folder / "schedule.json")
    assert np.array_equal(one.trajectory.position, two.trajectory.position)
    assert one.duration == schedule.duration


def test_files_that_were_changed_or_lost_are_named(folder):
    """Against the hashes in schedule.json; nothing outside the folder is looked at."""
    schedule = read_schedule(folder)
    assert torn_files(folder, schedule) == []
    assert torn_files(folder / "schedule.json", schedule) == []
    with (folder / "schedule.csv").open("a") as file:
        file.write("\n")
    (folder / "report.json").unlink()
    assert torn_files(folder, schedule) == ["report.json is missing", "schedule.csv was changed"]
    edit(folder, ["files"], {"../../etc/passwd": "00"})
    assert torn_files(folder, read_schedule(folder)) == ["../../etc/passwd is missing"]


def test_a_urdf_of_40000_joints_in_a_row_is_refused(folder):
    """URDF libraries follow the tree by recursion, and the process would end without a word."""
    names = [f"l{k}" for k in range(40_001)]
    joints = [
        f'<joint name="j{k}" type="fixed"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(40_000)
    ]
    for count, words in (
        (40_000, "exceeds the limits of XML files"),
        (2_000, "2000 joints; at most 1000 are read"),
    ):
        parts = [*(f'<link name="{name}"/>' for name in names[: count + 1]), *joints[:count]]
        (folder / "robot.urdf").write_text(f'<robot name="a">\n{chr(10).join(parts)}\n</robot>')
        with pytest.raises(InputError, match=words) as caught:
            read_schedule(folder)
        (diagnostic,) = caught.value.diagnostics
        assert diagnostic.file == "robot.urdf"
        assert diagnostic.line > 1000
