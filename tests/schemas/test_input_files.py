# ruff: noqa: E501 (tables, one case a line)
"""The schemas of input files against the readers: bundled files, spellings of quantities, and thousands of mistakes."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from pydantic import ValidationError

from dualarm_cli.cli.run import run
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import quantity_schema
from dualarm_cli.files.source.quantities import Dimension, QuantityError, parse_quantity
from dualarm_cli.files.source.text_source import read_text
from dualarm_cli.files.source.yaml_source import parse_yaml
from dualarm_cli.schemas import KINDS, editor_line, schema_of
from dualarm_cli.schemas.kinds_of_files import INPUT_FILES

ROOT = Path(__file__).parents[2]
FILES = sorted([*(ROOT / "tasks").rglob("*.yaml"), *(ROOT / "robots").rglob("*.yaml")])
DIMENSIONS = [one for one in vars(quantities).values() if isinstance(one, Dimension)]


@cache
def judge(kind: str) -> Draft202012Validator:
    """Returns the validator of a kind of file."""
    return Draft202012Validator(schema_of(kind))


def content(path: Path) -> tuple[str, Any]:
    """Returns kind and content of a file."""
    data = parse_yaml(read_text(path, path.name)).data
    return data["dualarm"].partition("/")[0], data


def wrong(kind: str, data: Any) -> list[str]:
    """Returns what the schema of a kind finds wrong."""
    return [f"{error.json_path}: {error.message}" for error in judge(kind).iter_errors(data)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_schema_is_one(kind: str) -> None:
    Draft202012Validator.check_schema(schema_of(kind))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_bundled_file_is_valid(path: Path) -> None:
    assert wrong(*content(path)) == []


CELL = {"dualarm": "cell/1", "robot": "sda10f"}
TASKS = {"dualarm": "tasks/1", "cell": "cell.yaml"}
TASK = {"id": "a", "arm": "left"}
ROBOT = {"dualarm": "robot/1", "name": "R", "urdf": "r.urdf", "arms": {"left": {"joints": ["a"], "flange": "f"}}}  # fmt: skip
ROW = {"joint": "a", "lower": "-90 deg", "upper": 1, "velocity": "100 deg/s"}
STUDY = {"dualarm": "study/1", "tasks": "tasks.yaml"}


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("cell", CELL | {"obstacles": [{"name": "ball", "sphere": "20 mm"}], "frames": [{"name": "a", "xyz": [0, 0, 1]}], "tools": [{"name": "left", "mass": "800 g"}]}),
        ("cell", CELL | {"obstacles": {"ball": {"sphere": 0.2}, "floor": {"half_space": {}}, "part": {"mesh": "a.stl"}}}),
        ("cell", CELL | {"robot": {"left": {"robot": "iiwa14"}, "right": {"robot": "iiwa14", "base": "base.yaml"}}}),
        ("tasks", TASKS | {"tasks": [TASK | {"move": "home"}], "defaults": {"dwell": "0.2 s"}}),
        ("tasks", TASKS | {"tasks": [TASK | {"move": {"joints": [[0, "30 deg"], ["90°", 1]]}, "dwell": {"gripper": "100 ms"}}]}),
        ("tasks", TASKS | {"tasks": [TASK | {"pick": {"at": "bin", "xyz": ["80 mm", 0, 0], "free": "yaw"}, "place": {"xyz": [0, 0, 0]}, "dwell": 0.2}], "speed": "80%"}),
        ("robot", ROBOT | {"limits": {"default": {"acceleration": "top speed in 0.3 s", "jerk": "acceleration in 100 ms"}, "a": {"jerk": "none"}, "b": {"acceleration": "200 mm/s^2"}}}),
        ("robot", ROBOT | {"frozen": {"lift": "200 mm", "head": 0}, "postures": {"ready": {"a": "30 deg", "b": -1}}}),
        ("robot", {"dualarm": "robot/1", "name": "R", "dh": {"left": [ROW]}, "arms": {"left": {"kind": "general"}}}),
        ("study", STUDY | {"parameters": {"h": {"cell": "base.xyz[2]", "range": {"from": "0 mm", "to": 0.2, "count": 3}}}}),
        ("study", STUDY | {"tasks": ["a.yaml", "b.yaml"], "parameters": {"h": {"robot.left": "x", "values": [True, "2 mm", 1]}}}),
        ("points", {"dualarm": "points/1", "noise": "0.1 mm", "points": [{"name": "A", "left": {"xyz": [0, 0, 0]}, "right": {"joints": [0, "30 deg"]}}]}),
    ],
)  # fmt: skip
def test_short_forms_are_valid(kind: str, data: Any) -> None:
    """As the how-to pages have them; the models read them, too."""
    assert wrong(kind, data) == []
    if not isinstance(data.get("frames"), list):
        INPUT_FILES[kind]().model_validate(data)


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("cell", CELL | {"clearance": 10}),
        ("cell", CELL | {"clearance": "10 kg"}),
        ("cell", CELL | {"obstacle": {}}),
        ("cell", CELL | {"obstacles": {"ball": {"sphere": 0.2, "colour": "red"}}}),
        ("cell", CELL | {"obstacles": [{"sphere": 0.2}]}),
        ("cell", CELL | {"tools": {"left": {"tcp": {"xyz": [0, 0, 150]}}}}),
        ("cell", {"dualarm": "cell/1"}),
        ("tasks", TASKS | {"tasks": [TASK | {"move": ["home"]}]}),
        ("tasks", TASKS | {"tasks": [TASK | {"pick": {"xyz": [0, 0, 0], "rpy": [180, 0, 0]}}]}),
        ("tasks", TASKS | {"tasks": [TASK | {"pick": {"joints": ["30 kg"]}}]}),
        ("tasks", TASKS | {"tasks": []}),
        ("tasks", TASKS | {"tasks": [TASK | {"arm": "both"}]}),
        ("robot", ROBOT | {"limits": {"a": {"acceleration": "none"}}}),
        ("robot", ROBOT | {"limits": {"a": {"acceleration": "acceleration in 0.1 s"}}}),
        ("robot", ROBOT | {"arms": {"left": {"joints": ["a"]}}}),
        ("robot", {key: value for key, value in ROBOT.items() if key != "urdf"}),
        ("robot", ROBOT | {"postures": {"ready": {"a": "30 s"}}}),
        ("study", STUDY | {"parameters": {"h": {"cell": "x", "range": {"from": 0, "to": "1 parsec"}}}}),
        ("points", {"dualarm": "points/1", "points": []}),
    ],
)  # fmt: skip
def test_mistakes_are_not_valid(kind: str, data: Any) -> None:
    assert wrong(kind, data)


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yields the places of all values inside a document."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def mutants(data: Any) -> Iterator[Any]:
    """Yields copies of a document with one change each: a value of another kind, an unknown key, a missing one."""
    for path in places(data):
        for value in ("12 parsec", True, None, [], {}, {"zzz": 1}, [1, 2, 3, 4, 5], -7, 1e5, ""):
            mutant = copy.deepcopy(data)
            inner = mutant
            for step in path[:-1]:
                inner = inner[step]
            if isinstance(inner[path[-1]], dict) and value == {"zzz": 1}:
                inner[path[-1]]["zzz"] = 1
            else:
                inner[path[-1]] = value
            yield mutant
        mutant = copy.deepcopy(data)
        inner = mutant
        for step in path[:-1]:
            inner = inner[step]
        del inner[path[-1]]
        yield mutant


def structural(error: ValidationError) -> bool:
    """Returns whether a model refuses something for what a schema can say: a key, a kind of value, a plain number."""
    for one in error.errors(include_url=False):
        context = one.get("ctx", {})
        if one["type"] == "refused":
            across = isinstance(one["input"], dict | list) or context["key"]
            ranged = isinstance(one["input"], str) and "must be" in str(context["text"])
            if across or ranged or context["code"] != "E200":
                continue
        return True
    return False


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("tasks/04_packing/tasks.yaml", marks=pytest.mark.slow),
        "tasks/10_seam/tasks.yaml",
        "tasks/papers/choi_circles/tasks.yaml",
        "tasks/13_hand_over/tasks.yaml",
        "tasks/14_two_grippers/cell.yaml",
        "tasks/15_conveyor/cell.yaml",
        "tasks/04_packing/study.yaml",
        "robots/qin_150/robot.yaml",
        "robots/iiwa14/robot.yaml",
        "tasks/papers/qin_calibration/points.yaml",
    ],
)
def test_what_a_model_refuses_for_its_structure_the_schema_refuses(name: str) -> None:
    kind, data = content(ROOT / name)
    model, refused, missed = INPUT_FILES[kind](), 0, []
    for mutant in mutants(data):
        if any(isinstance(mutant.get(key), list) for key in ("frames", "obstacles", "tools")):
            continue  # lists with names: a reader makes mappings of them before the model sees them
        try:
            model.model_validate(mutant)
        except ValidationError as error:
            if structural(error):
                refused += 1
                if judge(kind).is_valid(mutant):
                    missed.append(str(error))
    assert missed == []
    assert refused > 100


@given(
    st.sampled_from(DIMENSIONS),
    st.one_of(
        st.floats(-1e4, 1e4),
        st.integers(-1000, 1000),
        st.text(max_size=12),
        st.from_regex(r"[-+]?[0-9.]{1,4}(e[0-9])? ?[a-zµ°%]{0,4}(/s[23²³]?|\^2)?", fullmatch=True),
    ),
)
def test_a_quantity_that_is_read_is_valid(dimension: Dimension, value: object) -> None:
    """Numbers, texts that look like quantities, and any text; what is not read for its spelling is not valid."""
    most = min(dimension.plain, dimension.limit)
    valid = Draft202012Validator(quantity_schema([dimension], -most, most)).is_valid(value)
    try:
        parse_quantity(value, dimension)
    except QuantityError as error:
        ranged = isinstance(value, str) and ("range" in str(error) or "without a" in str(error))
        assert not valid or ranged or "too small" in str(error)
    else:
        assert valid


def test_the_command_prints_lists_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["schema"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(KINDS)
    assert run(["schema", "cell"]) == 0
    printed = capsys.readouterr().out
    assert run(["schema", "cell", "--out", ".dualarm/cell.schema.json"]) == 0
    assert (tmp_path / ".dualarm/cell.schema.json").read_text() == printed
    assert editor_line(".dualarm/cell.schema.json").rstrip() in capsys.readouterr().err
    assert run(["schema", "cell", "--out", ".dualarm/cell.schema.json"]) == 2
    assert run(["schema", "cel"]) == 2
    assert "did you mean 'cell'?" in capsys.readouterr().err
