"""Evaluations go through JSON without loss, and documents that are none are refused."""

from __future__ import annotations

import json
import math

import pytest

from dualarm_cli.model.budget import Kept
from dualarm_cli.model.studies.evaluation import Evaluation, Finding

WHOLE = Evaluation(
    case="a/tasks.yaml",
    status="planned",
    cycle_time=0.1 + 0.2,
    closes=True,
    lower_bound=0.25,
    gap=1 / 3,
    clearance=-0.001,
    required_clearance=0.0,
    travel=12.5,
    torque=0.75,
    torque_joint="j1",
    limiting={"j1": 0.1, "dwell": 2},
    limits={"j1": {"velocity": 1.5, "lower": -2.0}},
    sliding=("j7",),
    budgets=(Kept("clearance", 0.01, None, False, "t.yaml", 3, 5),),
    findings=(Finding("too slow", "t.yaml", 2), Finding("as a whole")),
    inputs={"tasks.yaml": "ab"},
)


def changed(*keys: str, value: object) -> object:
    """The document of WHOLE with one value replaced; entries of lists are the first ones."""
    document = json.loads(json.dumps(WHOLE.as_document()))
    place = document
    for key in keys[:-1]:
        place = place[0] if key == "0" else place[key]
    place[keys[-1]] = value
    return document


def test_an_evaluation_comes_back_as_it_was() -> None:
    """Through the text of JSON, to the last digit; whoever changes the document does not change the noun."""
    document = WHOLE.as_document()
    assert Evaluation.of_document(json.loads(json.dumps(document))) == WHOLE
    for name in ("limiting", "limits", "inputs"):
        document[name].clear()
    assert WHOLE.limiting and WHOLE.limits and WHOLE.inputs
    least = Evaluation("b", "crashed")
    assert Evaluation.of_document(json.loads(json.dumps(least.as_document()))) == least


@pytest.mark.parametrize(
    "document",
    [
        None,
        [],
        {},
        {**WHOLE.as_document(), "more": 1},
        {key: value for key, value in WHOLE.as_document().items() if key != "gap"},
        changed("status", value="great"),
        changed("case", value=3),
        *(
            changed(name, value=value)
            for name in (
                "cycle_time",
                "lower_bound",
                "gap",
                "clearance",
                "required_clearance",
                "travel",
                "torque",
            )
            for value in (math.nan, math.inf, "1", True)
        ),
        changed("torque_joint", value=None),
        changed("closes", value=1),
        changed("closes", value=None),
        changed("limiting", value=[]),
        changed("limiting", "j1", value=None),
        changed("limiting", "j1", value=math.inf),
        changed("limits", value=None),
        changed("limits", "j1", value=3.0),
        changed("limits", "j1", "velocity", value="2"),
        changed("inputs", value=[]),
        changed("inputs", "tasks.yaml", value=7),
        changed("sliding", value="j7"),
        changed("budgets", value={}),
        changed("findings", value=None),
        changed("findings", "0", "line", value=2.5),
        changed("findings", "0", "line", value=True),
        changed("findings", "0", "message", value=None),
        changed("findings", "0", "more", value=1),
        changed("findings", value=[{"message": "m"}]),
        changed("findings", value=["message"]),
        changed("budgets", "0", "allowed", value=math.inf),
        changed("budgets", "0", "allowed", value=None),
        changed("budgets", "0", "measured", value=math.nan),
        changed("budgets", "0", "kept", value=1),
    ],
)
def test_what_is_no_evaluation_is_refused(document: object) -> None:
    """Keys, types and numbers that are not finite, at every depth."""
    with pytest.raises(ValueError, match=r"."):
        Evaluation.of_document(document)


def test_whole_numbers_are_numbers() -> None:
    """JSON writes 2.0 as 2 where another tool made it."""
    found = Evaluation.of_document(changed("cycle_time", value=2))
    assert found.cycle_time == 2
    assert Evaluation.of_document(changed("budgets", "0", "allowed", value=1)).budgets[0].allowed


def test_only_planned_has_a_plan() -> None:
    """One that fails verification has none that could be used."""
    assert WHOLE.has_plan
    assert not Evaluation("a", "fails_verification").has_plan


@pytest.mark.parametrize(
    ("finding", "words"),
    [
        (Finding("m"), "m"),
        (Finding("m", "f"), "f: m"),
        (Finding("m", "f", 1), "f:1: m"),
        (Finding("m", "f", 3, 1), "f:3:1: m"),
    ],
)
def test_a_finding_says_as_much_of_its_place_as_is_known(finding: Finding, words: str) -> None:
    """File, line and column, from the left."""
    assert str(finding) == words


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (Kept("cycle_time", 5.0, 4.5, True, "f", 1, 2), "cycle time 4.500 s, at most 5 s: kept"),
        (
            Kept("cycle_time", 5.0, None, False, "f", 1, 2),
            "cycle time not known, at most 5 s: MISSED (f:1:2)",
        ),
        (
            Kept("clearance", 0.01, 0.0125, True, "f", 1, 2),
            "clearance 12.5 mm, at least 10 mm: kept",
        ),
        (
            Kept("clearance", 0.01, None, False, "f", 1, 2),
            "clearance not proven, at least 10 mm: MISSED (f:1:2)",
        ),
    ],
)
def test_a_budget_line_says_what_was_measured_and_where_it_is_missed(
    kept: Kept, words: str
) -> None:
    """Seconds and millimetres."""
    assert str(kept) == words
