"""How refusals are told."""

from __future__ import annotations

import pytest

from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.model.place import Place
from dualarm_cli.refusals import Refusal, message

LATE = Refusal("late", Place("t.yaml", 3, 5), "a", "left", 4.0, 3.0, data={"late": 1.0})
LATE_TOO = Refusal("late", Place("t.yaml", 9, 5), "b", "left", 6.0, 4.5, data={"late": 1.5})


def test_what_refusals_have_in_common_is_said_once():
    """Before and after them; each has its place."""
    head, one, other, helps = str(InfeasibleError(LATE, LATE_TOO)).splitlines()
    assert head == "no plan was found that is in time:"
    assert one == (
        "  t.yaml:3:5: task 'a' is done at 4.000 s, 1.000 s after its window closes (not_after: 3 s)"
    )
    assert other.startswith("  t.yaml:9:5: task 'b' is done at 6.000 s")
    assert helps.startswith("try later windows")


def test_a_place_can_be_told_apart():
    """Of one refusal, the others keep theirs."""
    text = message((LATE, LATE_TOO), placed=LATE)
    assert "t.yaml:3:5" not in text
    assert "t.yaml:9:5: task 'b'" in text


@pytest.mark.parametrize(
    "remedy, end",
    [
        ((), "knots"),
        (("less_speed",), "knots; lower its speed"),
        (
            ("raise_cap", "less_speed", "slower"),
            "knots; raise it, lower its speed, or say 'slower: allowed'",
        ),
    ],
)
def test_remedies_follow_the_fault(remedy, end):
    """The last one after an or."""
    assert str(Refusal("seam_uneven", measured=0.02, remedy=remedy)).endswith(end)


def test_a_refusal_may_name_its_cause_and_how_many():
    """Causes are told in their places; nothing is said of none."""
    puts = Refusal("puts", data={"names": ["a", "b"]})
    data = {"buffer": "bin", "stage": 2, "causes": [puts], "either": []}
    found = Refusal("buffer_in_stage", measured=1, allowed=2, data=data)
    assert str(found) == (
        "buffer 'bin' holds 1 of at most 2 parts before stage 2, in which 'a' and 'b' put 2 in"
    )


def test_errors_carry_their_refusals():
    """With the stages that are blocked, for a search that learns from them."""
    error = BlockedError(LATE, stages=(1,), alone=True)
    assert (error.refusals, error.stages, error.alone) == ((LATE,), (1,), True)
