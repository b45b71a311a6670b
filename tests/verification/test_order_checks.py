"""Order, precedence and windows where the file leaves arms and order open."""

from __future__ import annotations

import dataclasses
from itertools import pairwise, permutations, product

import numpy as np
import pytest

from dualarm_cli.verification.order_checks import check_order, check_precedence, check_windows

STOPS = {"a": ("pick", "place"), "b": ("move",), "c": ("pick", "place"), "d": ("move",)}


@pytest.fixture(scope="module")
def problem(clean):
    """Makes jobs of a to d and schedules of rows of (task, action) by arm, one event a second."""
    template = clean.job.tasks[0]
    blank = clean.schedule.events[0]

    def job(arms, order="optimise", sequences=(), **changes):
        tasks = []
        for name, arm in arms.items():
            stops = tuple(
                dataclasses.replace(template.stops[0], action=action) for action in STOPS[name]
            )
            task = dataclasses.replace(template, id=name, arm=arm, stops=stops)
            tasks.append(dataclasses.replace(task, **changes.get(name, {})))
        return dataclasses.replace(
            clean.job, tasks=tuple(tasks), order=order, sequences=tuple(sequences)
        )

    def schedule(**rows):
        events = [
            dataclasses.replace(blank, time=float(k), arm=arm, task=task, action=action, dwell=0.0)
            for arm, row in rows.items()
            for k, (task, action) in enumerate(row, start=1)
        ]
        # Listed in any order: the times count.
        return dataclasses.replace(clean.schedule, events=tuple(events[::-1]), segments=())

    return job, schedule


def stops(*names):
    """Returns the targets of whole tasks one after the other."""
    return [(name, action) for name in names for action in STOPS[name]]


A1, A2, C1, C2 = ("a", "pick"), ("a", "place"), ("c", "pick"), ("c", "place")
B, D = ("b", "move"), ("d", "move")
ANY = dict.fromkeys("abcd", "any")


@pytest.mark.parametrize(
    ("left", "right", "detail"),
    [
        ([A1, A2, B, D], [C2], "c pick is not done"),
        ([A1, A2, D], [C1, C2], "b move is not done"),
        ([A1, A2, B, D], [C1, C2, C2], "c place is done 2 times"),
        ([A1, A2, B, D, ("e", "move")], [C1, C2], "e move is done, which no task requires"),
        ([A1, A2, B, D, ("b", "pick")], [C1, C2], "b pick is done, which no task requires"),
        (
            [A1, C2, B, D],
            [C1, A2],
            "a is done by left and right; one arm does all of a task",
        ),
        ([A1, B, A2, D], [C1, C2], "left arm: b move is done within a"),
        ([A2, A1, B, D], [C1, C2], "left arm: a place is done before a pick"),
        ([A1, C1, A2, C2], [B, D], "left arm: c pick is done within a"),
    ],
)
def test_what_breaks_a_task_is_named(problem, left, right, detail):
    """Any arm, any order; two tasks of two targets, two bare moves."""
    job, schedule = problem
    check = check_order(schedule(left=left, right=right), job(ANY))
    assert (check.verdict, check.detail) == ("failed", detail)


@pytest.mark.parametrize(
    ("arms", "order", "sequences", "left", "right", "detail"),
    [
        ({**ANY, "c": "left"}, "optimise", (), "ab", "cd", "c is the left arm's, the right arm does it"),
        (ANY, "given", (), "ba", "cd", "left arm: b is done before a, not as order: given has it"),
        ({**ANY, "d": "left"}, "given", (), "dab", "c", "left arm: d is done before a, not as order: given has it"),
        (ANY, "optimise", ["ab"], "adb", "c", "left arm: b must follow a directly, but d is done"),
        (ANY, "optimise", ["ab"], "ba", "cd", "left arm: b must follow a directly, but nothing is done"),
        (ANY, "optimise", ["ab"], "ad", "bc", "a and b belong to one sequence, but are done by left and right"),
        (ANY, "optimise", ["abc"], "dab", "c", "b and c belong to one sequence, but are done by left and right"),
        (ANY, "optimise", ["abc"], "abdc", "", "left arm: c must follow b directly, but d is done"),
        (ANY, "optimise", ["ab", "cd"], "ab", "dc", "right arm: d must follow c directly, but nothing is done"),
        (ANY, "optimise", ["ab", "cd"], "cdab", "", ""),
        (ANY, "optimise", ["abcd"], "", "abcd", ""),
        (ANY, "given", (), "ad", "bc", ""),
        ({**ANY, "c": "left"}, "optimise", (), "cba", "d", ""),
    ],
)  # fmt: skip
def test_rules_across_tasks_are_kept_or_named(problem, arms, order, sequences, left, right, detail):
    """All tasks are whole; the arm, the file's order or a sequence is what fails, once."""
    job, schedule = problem
    asked = job(arms, order, [tuple(row) for row in sequences])
    check = check_order(schedule(left=stops(*left), right=stops(*right)), asked)
    assert check.verdict == ("failed" if detail else "passed")
    assert check.measured == (1.0 if detail else 0.0)
    assert check.detail == (
        detail or "every target once, by an allowed arm and in an allowed order"
    )


def test_a_task_that_is_not_done_breaks_no_sequence(problem):
    """It is one fault, not two; in the middle of a sequence too."""
    job, schedule = problem
    for row in (("a", "b"), ("b", "a"), ("a", "b", "c")):
        asked = job(ANY, sequences=[row])
        check = check_order(schedule(left=stops(*"adc"), right=[]), asked)
        assert (check.measured, check.detail) == (1.0, "b move is not done")


def legal(job):
    """Returns every pair of rows that a job allows, by trying all."""
    names = [task.id for task in job.tasks]
    found = set()
    for arms in product(("left", "right"), repeat=len(names)):
        if any(t.arm not in (arm, "any") for t, arm in zip(job.tasks, arms, strict=True)):
            continue
        own = {arm: [n for n, by in zip(names, arms, strict=True) if by == arm] for arm in arms}
        for left in permutations(own.get("left", ())):
            for right in permutations(own.get("right", ())):
                orders = (left, right)
                if job.order == "given" and any(list(o) != sorted(o) for o in orders):
                    continue
                neighbours = {pair for order in orders for pair in pairwise(order)}
                if all(pair in neighbours for row in job.sequences for pair in pairwise(row)):
                    found.add((tuple(stops(*left)), tuple(stops(*right))))
    return found


@pytest.mark.parametrize("seed", range(12))
def test_the_check_allows_just_what_is_legal(problem, seed):
    """Against all legal rows; legal ones, random ones, and legal ones with two targets swapped between any places."""
    job, schedule = problem
    rng = np.random.default_rng(seed)
    arms = {name: str(rng.choice(["any", "any", "left", "right"])) for name in "abcd"}
    arms["a"] = arms["b"] = "any"  # the sequence has one arm in any case
    order = "given" if seed % 4 == 0 else "optimise"
    asked = job(arms, order, [("a", "b")] if seed % 2 else ())
    allowed = legal(asked)
    assert allowed
    listed, everything = sorted(allowed), stops(*"abcd")
    verdicts = []
    for _ in range(60):
        left, right = (list(row) for row in listed[rng.integers(len(listed))])
        for _ in range(rng.integers(3)):
            both = [*left, *right]
            i, j = rng.integers(len(both), size=2)
            both[i], both[j] = both[j], both[i]
            cut = len(left)
            if rng.random() < 0.3:
                cut = int(rng.integers(len(both) + 1))
            left, right = both[:cut], both[cut:]
        if rng.random() < 0.1:
            left = [everything[k] for k in rng.permutation(len(everything))]
            right = []
        check = check_order(schedule(left=left, right=right), asked)
        assert (check.verdict == "passed") == ((tuple(left), tuple(right)) in allowed), (
            left,
            right,
        )
        verdicts.append(check.verdict)
    assert {"passed", "failed"} == set(verdicts)


def test_clocks_of_their_own_change_nothing_in_a_given_order(clean):
    """Each arm's targets in the file's order, word for word as for paired arms."""
    free = dataclasses.replace(clean.job, mode="free")
    assert check_order(clean.schedule, free) == check_order(clean.schedule, clean.job)
    events = tuple(e for e in clean.schedule.events if e.arm == "left")
    torn = dataclasses.replace(clean.schedule, events=events)
    found = check_order(torn, free)
    assert found.detail == "right arm: expected right-part pick, found nothing"
    assert found == check_order(torn, clean.job)
    # Each arm that does otherwise counts once.
    nothing = dataclasses.replace(clean.schedule, events=())
    assert (found.measured, check_order(nothing, free).measured) == (1, 2)


@pytest.fixture
def precedence(measured_lines):
    """The check of a schedule for a job."""
    return lambda schedule, job: check_precedence(schedule, job, measured_lines(schedule, job))


def test_a_task_begins_with_its_approach_and_is_over_with_its_retract(by_clocks, precedence):
    """Fill retracts until 4.0 s, fit approaches from 4.0 s: 10 ms less of the one wait is 10 ms too early."""
    assert precedence(by_clocks.schedule, by_clocks.job).verdict == "passed"
    early = by_clocks.play(left=["fill", "look"], right=["turn", (2.39, "after"), "fit"])
    check = precedence(early, by_clocks.job)
    assert check.verdict == "failed"
    assert check.measured == pytest.approx(0.01, abs=1e-9)
    assert check.detail == "fit begins at 3.990 s, fill is over at 4.000 s"


def test_a_dwell_and_an_event_count_where_there_are_no_lines(by_clocks, precedence):
    """Fit after look, a bare move that ends at 4.8 s; look after turn, whose events are all there is of them."""
    tasks = {task.id: task for task in by_clocks.job.tasks}

    def after(**names):
        changed = [
            dataclasses.replace(task, after=(names[name],) if name in names else ())
            for name, task in tasks.items()
        ]
        return dataclasses.replace(by_clocks.job, tasks=tuple(changed))

    check = precedence(by_clocks.schedule, after(fit="look"))
    assert check.measured == pytest.approx(0.8, abs=1e-9)
    assert check.detail == "fit begins at 4.000 s, look is over at 4.800 s"
    assert precedence(by_clocks.schedule, after(look="turn")).verdict == "passed"
    check = precedence(by_clocks.schedule, after(turn="look"))
    assert check.detail == "turn begins at 0.800 s, look is over at 4.800 s"
    # Lines are measured, whatever segments are listed, and in whatever order events are: fill's last ends at 4.0 s.
    events = by_clocks.schedule.events[::-1]
    bare = dataclasses.replace(by_clocks.schedule, segments=(), events=events)
    assert precedence(bare, after(look="fill")).verdict == "passed"
    check = precedence(bare, after(turn="fill"))
    assert check.detail == "turn begins at 0.800 s, fill is over at 4.000 s"
    check = precedence(bare, after(fill="look"))
    assert check.detail == "fill begins at 0.800 s, look is over at 4.800 s"


@pytest.mark.parametrize(
    ("changes", "verdict", "detail"),
    [
        ({"mode": "paired", "order": "optimise"}, "failed", "look begins at"),
        ({"mode": "free", "order": "given"}, "failed", "look begins at"),
        ({"mode": "paired", "order": "given", "any": True}, "failed", "look begins at"),
        ({"mode": "paired", "order": "given"}, "failed", "look begins at"),
        ({"mode": "free", "order": "given", "after": ()}, "not checked", "no task has `after`"),
    ],
)
def test_precedence_is_asked_of_what_waits(by_clocks, precedence, changes, verdict, detail):
    """Look is at 4.8 s and is to come after fit: whatever the mode, and whoever chose the order."""
    after = changes.get("after", ("fit",))
    arms = {"left": "any"} if "any" in changes else {"any": "left"}
    tasks = tuple(
        dataclasses.replace(
            task, after=after if task.id == "look" else (), arm=arms.get(task.arm, task.arm)
        )
        for task in by_clocks.job.tasks
    )
    kept = {key: value for key, value in changes.items() if key in ("mode", "order")}
    job = dataclasses.replace(by_clocks.job, tasks=tasks, **kept)
    check = precedence(by_clocks.schedule, job)
    assert check.verdict == verdict
    assert check.detail.startswith(detail)


def test_what_nobody_does_neither_begins_nor_ends(by_clocks, precedence):
    """The order names it; nothing is left to compare."""
    events = tuple(e for e in by_clocks.schedule.events if e.task != "fill")
    segments = tuple(s for s in by_clocks.schedule.segments if s.task != "fill")
    lost = dataclasses.replace(by_clocks.schedule, events=events, segments=segments)
    assert precedence(lost, by_clocks.job).verdict == "not checked"
    assert check_order(lost, by_clocks.job).detail == "fill pick is not done"


@pytest.mark.parametrize(
    ("window", "beyond", "detail"),
    [
        ((0.0, 4.7), 0.0, ""),
        ((1.2, 3.2), 0.0, ""),
        ((1.3, np.inf), 0.1, "fill is begun at 1.200 s, not_before is 1.3 s"),
        ((0.0, 3.0), 0.2, "fill ends at 3.200 s, not_after is 3 s"),
        ((0.0, 1.0), 2.2, "fill ends at 3.200 s, not_after is 1 s"),
        ((5.0, 6.0), 3.8, "fill is begun at 1.200 s, not_before is 5 s"),
        ((1.2 + 1e-8, np.inf), 1e-8, "fill is begun at 1.200 s, not_before is 1.2 s"),
    ],
)
@pytest.mark.parametrize("order", ["given", "optimise"])
@pytest.mark.parametrize("mode", ["paired", "free"])
def test_a_window_is_from_the_first_target_to_the_last(
    by_clocks, window, beyond, detail, order, mode
):
    """Fill is at its first target at 1.2 s, at its last at 3.2 s; dwell and retract are no part of it."""
    tasks = tuple(
        dataclasses.replace(
            task,
            not_before=window[0] if task.id == "fill" else 0.0,
            not_after=window[1] if task.id == "fill" else np.inf,
        )
        for task in by_clocks.job.tasks
    )
    job = dataclasses.replace(by_clocks.job, tasks=tasks, order=order, mode=mode)
    check = check_windows(by_clocks.schedule, job)
    assert check.verdict == ("failed" if detail else "passed")
    assert check.measured == pytest.approx(beyond, abs=2e-9)
    assert check.detail == (detail or "every task within its window")


def test_without_windows_or_without_the_task_nothing_is_measured(clean, by_clocks):
    """And nothing passes."""
    assert check_windows(clean.schedule, clean.job).verdict == "not checked"
    nothing = dataclasses.replace(by_clocks.schedule, events=())
    assert check_windows(nothing, by_clocks.job).verdict == "not checked"


def test_what_both_arms_do_together_is_done_by_both(clean):
    """A path of both arms in an open order: as asked for; then only one arm follows it, then neither."""
    blank = clean.schedule.events[0]
    tasks, events = [], []
    for task in clean.job.tasks:
        stop = dataclasses.replace(task.stops[0], action="path")
        tasks.append(dataclasses.replace(task, id="both", stops=(stop,), path=object()))
        events.append(dataclasses.replace(blank, arm=task.arm, task="both", action="path"))
    job = dataclasses.replace(clean.job, tasks=tuple(tasks), order="optimise")

    def found(*some):
        return check_order(dataclasses.replace(clean.schedule, events=some), job)

    assert found(*events).verdict == "passed"
    alone = found(events[0])
    assert (alone.verdict, alone.measured) == ("failed", 2)
    assert alone.detail == "both path is done 1 times"
    nobody = found()
    assert (nobody.detail, nobody.measured) == ("both path is not done", 1)
