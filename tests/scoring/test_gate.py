"""The gate: what passes, what does not, and that whatever is not known to be good does not."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.model.budget import Kept
from dualarm_cli.model.studies.evaluation import STATUSES, Finding
from dualarm_cli.scoring.gate import judge, judge_all
from dualarm_cli.scoring.verdict import EXIT_CODES, SEVERITY, STATES, exit_code

CASE = "cells/a/tasks.yaml"


@pytest.mark.parametrize(
    ("before", "now", "allowed", "state"),
    [
        (10.0, 10.0, 0.02, "pass"),
        (10.0, 10.199, 0.02, "pass"),
        (10.0, 10.201, 0.02, "regressed"),
        (10.0, 10.0009, 0.0, "pass"),  # below a millisecond nothing is a change
        (10.0, 10.0011, 0.0, "regressed"),
        (0.01, 0.0109, 0.02, "pass"),  # 9 %, but 0.9 ms
        (0.01, 0.0112, 0.02, "regressed"),
        (10.0, 9.99, 0.5, "pass"),  # 0.1 % is the least that is told
        (10.0, 9.989, 0.5, "improved"),
        (0.0, 0.0, 0.02, "pass"),
        (0.0, 1.0, 0.02, "regressed"),
    ],
)
def test_cycle_times_are_held_against_a_share_and_a_millisecond(
    evaluation, recorded, before, now, allowed, state
):
    """Both the share and the absolute floor have to be exceeded."""
    verdict = judge(
        CASE, evaluation(cycle_time=now), recorded(cycle_time=before), allowed, compared=True
    )
    assert verdict.state == state
    assert verdict.failed is (state == "regressed")


def test_a_longer_cycle_on_another_machine_is_no_regression(evaluation, recorded):
    """Unless a file has changed; and whatever the machine, budgets count."""
    other = {"compared": True, "elsewhere": "the baseline was made on A, this is B"}
    longer = evaluation(cycle_time=10.5)
    verdict = judge(CASE, longer, recorded(), 0.02, **other)
    assert (verdict.state, verdict.failed) == ("other_machine", False)
    assert "10.000 s -> 10.500 s, and no file has changed: the baseline was made on A" in str(
        verdict.reasons[0]
    )
    changed = evaluation(cycle_time=10.5, inputs={"cell.yaml": "cc", "tasks.yaml": "bb"})
    assert judge(CASE, changed, recorded(), 0.02, **other).state == "regressed"
    assert judge(CASE, longer, recorded(), 0.02, compared=True).state == "regressed"
    assert judge(CASE, evaluation(), recorded(), 0.02, **other).state == "pass"


def test_cases_are_new_missing_or_left_out(evaluation, recorded):
    """A case that the baseline lacks passes as new; one that only the baseline has fails, unless it is left out."""
    found = {"a": evaluation("a"), "b": evaluation("b")}
    baseline = {"b": recorded(), "c": recorded()}
    states = {v.case: v.state for v in judge_all(found, baseline, 0.0)}
    assert states == {"a": "new", "b": "pass", "c": "missing"}
    assert exit_code(judge_all(found, baseline, 0.0)) == 1
    some = judge_all(found, baseline, 0.0, subset=True)
    assert {v.case: v.state for v in some} == {"a": "new", "b": "pass"}
    assert exit_code(some) == 0
    assert {v.state for v in judge_all(found, None, 0.0)} == {"pass"}


def test_a_case_with_another_name_is_missing_but_is_told_as_renamed(evaluation, recorded):
    """By its files, which have the same names from its folder; other content, or none known, is another case."""
    files = {"cell.yaml": "11", "tasks.yaml": "22"}
    found = {"new": evaluation("new", inputs=files), "odd": evaluation("odd", inputs={})}
    baseline = {
        "old": recorded(inputs=files),
        "other": recorded(inputs=files | {"cell.yaml": "33"}),
        "bare": recorded(inputs={}),
    }
    missing = {v.case: v for v in judge_all(found, baseline, 0.0) if v.state == "missing"}
    assert set(missing) == {"old", "other", "bare"}
    told = {
        case: "is now named 'new', with the same files" in str(v.reasons[0])
        for case, v in missing.items()
    }
    assert not any("is now" in str(missing[case].reasons[0]) for case in ("other", "bare"))
    assert told == {"old": True, "other": False, "bare": False}


@pytest.mark.parametrize("status", [status for status in STATUSES if status != "planned"])
def test_what_has_no_verified_plan_never_passes(evaluation, recorded, status):
    """Whatever its cycle time says, and whether it is in the baseline or not."""
    failed = evaluation(status=status, cycle_time=1.0, findings=(Finding("why", CASE, 3, 4),))
    for before in (None, recorded()):
        verdict = judge(CASE, failed, before, 1.0, compared=True)
        assert verdict.failed
        assert verdict.state == status
        assert verdict.reasons == failed.findings


@pytest.mark.parametrize("time", [None, math.nan, math.inf, -1.0])
def test_a_cycle_time_that_is_none_never_passes(evaluation, recorded, time):
    """Comparisons with NaN are all false: it is refused before any."""
    verdict = judge(CASE, evaluation(cycle_time=time), recorded(), 1.0, compared=True)
    assert verdict.state == "internal_error"


def test_a_missed_budget_fails_with_its_place_and_a_regression_comes_first(evaluation, recorded):
    """Both are told; the state is the graver one."""
    lines = (
        Kept("cycle_time", 9.0, 10.0, False, CASE, 4, 11),
        Kept("clearance", 0.01, 0.02, True, CASE, 4, 30),
    )
    over = judge(CASE, evaluation(budgets=lines), recorded(), 0.0, compared=True)
    assert over.state == "over_budget"
    assert [(r.line, r.column, r.message) for r in over.reasons] == [
        (4, 11, "cycle time 10.000 s, at most 9 s (budget)")
    ]
    both = judge(CASE, evaluation(budgets=lines), recorded(cycle_time=8.0), 0.0, compared=True)
    assert both.state == "regressed"
    assert len(both.reasons) == 2


@given(st.lists(st.sampled_from(STATES), min_size=1, max_size=6))
def test_the_most_severe_case_decides_the_exit_code(states):
    """In the order 4, 2, 3, 1, 0, and in whatever order the cases are."""
    from dualarm_cli.scoring.verdict import Verdict

    verdicts = [Verdict("x", state, None, None, ()) for state in states]
    wanted = next(code for code in (4, 2, 3, 1, 0) if code in {EXIT_CODES[s] for s in states})
    assert exit_code(verdicts) == wanted
    assert exit_code(verdicts[::-1]) == wanted
    assert SEVERITY == (4, 2, 3, 1, 0)


def test_only_four_states_are_good():
    """A new state has to be decided here."""
    good = {state for state in STATES if EXIT_CODES[state] == 0}
    assert good == {"pass", "improved", "new", "other_machine"}
    assert set(STATUSES) - {"planned"} <= set(STATES)
    ranks = [SEVERITY.index(EXIT_CODES[state]) for state in STATES]
    assert ranks == sorted(ranks)
