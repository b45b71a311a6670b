"""What is said of rules that contradict each other: all of them that it takes, none that it does not."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dualarm_cli.model.place import Place
from dualarm_cli.orders.messages import why_impossible
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import Relaxation

NAMES = "abcde"


def job(count):
    """Tasks a, b, c .. in lines 9, 10, 11 .. of a file; windows are told as the file has them."""
    tasks = [
        SimpleNamespace(
            id=NAMES[k], place=Place("job.yaml", 9 + k, 5), not_before=1.0, not_after=2.0
        )
        for k in range(count)
    ]
    return SimpleNamespace(job=SimpleNamespace(tasks=tasks, buffers={}))


def tasks_of(count, arms=1, **rules):
    """Tasks of a second, a second from any to any other, by so many equal arms."""
    cost = np.full((count + 1, count + 1), 2.0)
    cost[:, count] = 0.0
    return Relaxation((cost,) * arms, np.ones(count), **rules)


def named(text):
    """Returns the rules that a message names, as a relaxation has them."""
    rules = re.split(r"there may be one\): |whatever else is done: ", text)[1].split("; ")
    found = {"before": [], "sequences": [], "not_before": [], "not_after": []}
    for rule in rules:
        ids = [NAMES.index(name) for name in re.findall(r"'(\w)'", rule)]
        if " after " in rule:
            found["before"].append((ids[1], ids[0]))
        elif rule.endswith("in a row"):
            found["sequences"].append(tuple(ids))
        else:
            found[rule.split(" ")[1].rstrip(":")].append(ids[0])
    return found


def only(problem, rules):
    """Returns the problem with some of its rules alone, put together from those, not from what is left of all."""

    def window(values, tasks, none):
        kept = np.full(problem.tasks, none)
        kept[tasks] = values[tasks] if values is not None else none
        return kept

    return Relaxation(
        problem.cost,
        problem.least,
        tuple(rules["before"]),
        tuple(rules["sequences"]),
        window(problem.not_before, rules["not_before"], 0.0),
        window(problem.not_after, rules["not_after"], np.inf),
        problem.in_file_order,
    )


def impossible(problem):
    """Says whether it is proven that there is no order."""
    return prove(problem, None, 4.0, 0).impossible


LATE = np.array([2.5, np.inf, 3.0, np.inf])
CASES = {
    "two windows, and rules that are no matter": (
        tasks_of(4, not_after=LATE, before=((1, 3),), sequences=((0, 1),)),
        ["job.yaml:9:5", "'a' not_after", "'c' not_after"],
    ),
    "a ring, and a window that is no matter": (
        tasks_of(4, before=((0, 1), (1, 2), (2, 0), (0, 3)), not_after=np.full(4, 50.0)),
        ["'b' after 'a'", "'c' after 'b'", "'a' after 'c'"],
    ),
    "one between a row": (
        tasks_of(3, before=((0, 2), (2, 1)), sequences=((0, 1),)),
        ["'c' after 'a'", "'b' after 'c'", "'a', 'b' by one arm in a row"],
    ),
    "a row the other way round": (
        tasks_of(3, before=((1, 0),), sequences=((0, 1),)),
        ["'a' after 'b'", "'a', 'b' by one arm in a row"],
    ),
    "two rows of one task": (
        tasks_of(3, sequences=((0, 1), (2, 1))),
        ["'a', 'b' by one arm in a row", "'c', 'b' by one arm in a row"],
    ),
    "after one that opens late": (
        tasks_of(
            3,
            before=((0, 1), (2, 1)),
            not_before=np.array([5.0, 1.0, 0.0]),
            not_after=np.array([np.inf, 7.0, np.inf]),
        ),
        ["job.yaml:9:5", "'b' after 'a'", "'a' not_before", "'b' not_after"],
    ),
    "two arms, three deadlines": (
        tasks_of(4, 2, not_after=np.array([3.0, 3.0, 3.0, np.inf]), before=((0, 3),)),
        ["'a' not_after", "'b' not_after", "'c' not_after"],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_no_rule_that_is_named_can_be_left_out(name):
    """Together they are impossible, without any one of them they are not; the first of their tasks' places is named."""
    problem, words = CASES[name]
    error = why_impossible(job(problem.tasks), problem)
    assert "no order keeps these rules together" in str(error)
    for word in words:
        assert word in str(error)
    rules = named(str(error))
    assert sum(len(some) for some in rules.values()) == len([w for w in words if "'" in w])
    assert impossible(only(problem, rules))
    for kind, some in rules.items():
        for one in some:
            rest = {**rules, kind: [other for other in some if other != one]}
            assert not impossible(only(problem, rest)), (kind, one)


def test_random_rules_are_left_out_one_by_one():
    """Five tasks with many rules of all kinds; those that contradict each other are named, none more."""
    looked = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        names = rng.permutation(5).tolist()
        pairs = {tuple(rng.choice(5, 2, replace=False).tolist()) for _ in range(4)}
        problem = tasks_of(
            5,
            1 + seed % 2,
            before=tuple(sorted(pairs)),
            sequences=(tuple(names[:2]),),
            not_before=np.where(rng.random(5) < 0.3, rng.uniform(1, 6, 5), 0.0),
            not_after=np.where(rng.random(5) < 0.4, rng.uniform(4, 9, 5), np.inf),
        )
        if not impossible(problem):
            continue
        looked += 1
        rules = named(str(why_impossible(job(5), problem)))
        assert impossible(only(problem, rules)), seed
        for kind, some in rules.items():
            for one in some:
                rest = {**rules, kind: [other for other in some if other != one]}
                assert not impossible(only(problem, rest)), (seed, kind, one)
    assert looked > 8


def test_the_rules_of_both_shares_of_a_handover_are_one():
    """Tasks 0 and 1 are one task of the file: after 2, which is after it; a window of task 3 is no matter of that."""
    problem = tasks_of(4, before=((2, 0), (2, 1), (0, 2)), not_before=np.array([0.0, 0, 0, 1.0]))
    order = job(4)
    order.job.tasks[1].id = order.job.tasks[0].id
    assert impossible(problem)
    text = str(why_impossible(order, problem))
    assert text.endswith("'a' after 'c'; 'c' after 'a'")


def test_the_place_is_that_of_the_first_task_concerned():
    """Not that of the first task of the file."""
    late = np.array([np.inf, np.inf, 1.0, 50.0])
    text = str(why_impossible(job(4), tasks_of(4, not_after=late)))
    assert text.startswith("job.yaml:11:5: ")
    assert text.endswith("no plan keeps this rule, whatever else is done: 'c' not_after: 2 s")


def test_arms_that_lack_the_same_task_are_no_matter_of_rules():
    """One task that neither arm can do."""
    made = tasks_of(3, 2, before=((0, 1),))
    cost = made.cost[0].copy()
    cost[1] = cost[:, 1] = np.inf
    text = str(why_impossible(job(3), replace(made, cost=(cost, cost))))
    assert text.startswith("no order does all tasks")


def test_what_is_not_proven_impossible_is_not_said_to_be():
    """Rules that can be kept."""
    assert why_impossible(job(3), tasks_of(3, before=((0, 1),))) is None
