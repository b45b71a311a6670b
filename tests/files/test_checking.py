# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dualarm_cli.errors import InputError
from dualarm_cli.files.checking import load_file
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import Robot
from tests.checked_files import check_file

FUZZ = settings(
    max_examples=80,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
FILES = ["robot.yaml", "cell.yaml", "tasks.yaml", "tiny.urdf"]
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from(["30 mm", "left", "bin", "home", "tasks/1", "cell.yaml", "../x", "12:30"])
    | st.text(max_size=6),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4)
    ),
    max_leaves=8,
)


def load_all() -> None:
    """Loads the tiny project's task file; only InputError may come of it."""
    try:
        load_file("tasks.yaml")
    except InputError as error:
        assert error.diagnostics
        assert all(d.file and d.code and d.message for d in error.diagnostics)


def test_each_kind_of_file_is_told_apart_by_its_first_key(project: Path) -> None:
    """Robot, cell and tasks, each checked with what it names."""
    kinds = [type(load_file(name)) for name in ("robot.yaml", "cell.yaml", "tasks.yaml")]
    assert kinds == [Robot, Cell, Job]
    assert check_file("tasks.yaml") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "f:1:1: E200 must be a mapping that begins with 'dualarm: tasks/1', not a list of 2"),
        ("cell: a", "f:1:1: E202 'dualarm' is missing; begin the file with 'dualarm: tasks/1'"),
        ("dualarn: tasks/1", "f:1:1: E202 'dualarm' is missing (there is 'dualarn'); begin the file with 'dualarm: tasks/1'"),
        ("dualarm: task/1", "f:1:10: E200 unknown kind 'task/1', did you mean 'tasks/1'? This version reads: robot/1, cell/1, tasks/1, points/1, base/1, study/1"),
        ("dualarm: [1]", "f:1:10: E200 unknown kind a list of 1; this version reads: robot/1, cell/1, tasks/1, points/1, base/1, study/1"),
    ],
)  # fmt: skip
def test_a_file_of_no_known_kind_is_refused(text: str, message: str, project: Path) -> None:
    """With what the first line should be."""
    (project / "f").write_text(text)
    assert [str(d) for d in check_file("f")] == [message]


def test_a_file_of_another_kind_is_refused(project: Path) -> None:
    """A task file that names a robot file as its cell."""
    (project / "tasks.yaml").write_text("dualarm: tasks/1\ncell: robot.yaml\ntasks: []\n")
    assert "robot.yaml:1:10: E200 this is a robot file (robot/1); required here: cell/1" in [
        str(d) for d in check_file("tasks.yaml")
    ]


@FUZZ
@given(file=st.sampled_from(FILES), data=st.binary(max_size=200))
def test_random_bytes_give_nothing_but_input_errors(project: Path, file: str, data: bytes) -> None:
    """Any of the four files replaced by noise."""
    old = (project / file).read_bytes()
    (project / file).write_bytes(data)
    load_all()
    (project / file).write_bytes(old)


@FUZZ
@given(
    file=st.sampled_from(FILES),
    at=st.floats(0, 1),
    cut=st.integers(0, 12),
    data=st.binary(max_size=8),
)
def test_damaged_files_give_nouns_or_input_errors(
    project: Path, file: str, at: float, cut: int, data: bytes
) -> None:
    """A few bytes replaced somewhere in a good file."""
    old = (project / file).read_bytes()
    start = int(at * len(old))
    (project / file).write_bytes(old[:start] + data + old[start + cut :])
    load_all()
    (project / file).write_bytes(old)


@FUZZ
@given(file=st.sampled_from(FILES[:3]), path=st.lists(st.integers(0, 9), max_size=5), value=VALUES)
def test_random_values_give_nouns_or_input_errors(
    project: Path, file: str, path: list[int], value: object
) -> None:
    """Any value of a good file replaced by any YAML value."""
    old = (project / file).read_text()
    data = yaml.safe_load(old)
    holder = data
    for step in path:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        key = keys[step % len(keys)]
        if not isinstance(holder[key], dict | list) or not holder[key] or step == path[-1]:
            holder[key] = value
            break
        holder = holder[key]
    (project / file).write_text(yaml.safe_dump(data, allow_unicode=True))
    load_all()
    (project / file).write_text(old)
