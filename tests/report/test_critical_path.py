"""Critical path and slack, by brute force: pieces are delayed, and the motion is timed again without re-planning."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion import motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import MotionCache
from dualarm_cli.planning import decided_plan
from dualarm_cli.planning.asynchronous import meeting_arms
from dualarm_cli.planning.asynchronous.own_clock import ClockSteps, Since, leaving_times
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.critical_path import critical_path, pieces_of, retimed
from dualarm_cli.timing import TIMING_SOLVERS
from tests.packing_tasks import packing_job

DELAY = 0.01
"""Delay of a piece [s]."""


def growth(slack: float) -> float:
    """Returns what a delay adds to the cycle, by the definition of slack [s]."""
    return max(0.0, DELAY - slack)


def longer(stop: Any) -> Any:
    """Returns a stop whose dwell is longer by DELAY."""
    return dataclasses.replace(stop, dwell=Dwell(stop.dwell.total + DELAY))


@pytest.mark.parametrize("name", ["01_first_pick", "13_hand_over"])
def test_a_delay_makes_the_cycle_longer_where_the_path_says(
    name: str, tasks_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each dwell, and each transfer that nothing else waits for, with blended lines and a turning platform."""
    decided: list[tuple[Any, list[Any]]] = []
    monkeypatch.setattr(
        decided_plan, "platform_notes", lambda model, plans: decided.append((model, plans)) or []
    )
    job = load_job(tasks_folder / name / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False)
    timing = TIMING_SOLVERS["ruckig"]
    slack = {(p.group, p.task, p.action, p.kind): p for p in critical_path(schedule).pieces}
    grown, expected = [], []

    def compare(plans: list[Any], k: int, slack: float, **changes: Any) -> None:
        delayed = [*plans[:k], dataclasses.replace(plans[k], **changes), *plans[k + 1 :]]
        grown.append(realise(model, job, delayed, timing).trajectory.duration - schedule.duration)
        expected.append(growth(slack))

    model, plans = next(
        (model, plans)
        for model, plans in decided
        if abs(realise(model, job, plans, timing).trajectory.duration - schedule.duration) < 1e-9
    )
    for k, plan in enumerate(plans):
        for arm, stop in plan.stops.items():
            key = arm, stop.task.id, stop.stop.action
            stops = {**plan.stops, arm: dataclasses.replace(stop, stop=longer(stop.stop))}
            compare(plans, k, slack[(*key, "dwell")].slack, stops=stops)
            transfer, alone = slack.get((*key, "transfer")), (arm, "approach") not in plan.passes
            platform = schedule.stages[k].platform_time
            hands_over = stop.stop.action in ("give", "take")
            if transfer and alone and not hands_over and transfer.length > platform:
                waits = {**plan.waits, arm: plan.waits.get(arm, 0.0) + DELAY}
                compare(plans, k, transfer.slack, waits=waits)
    # Where arms wait for each other, a delay of the one that waits is absorbed.
    assert name != "13_hand_over" or min(expected) == 0.0
    assert grown == pytest.approx(expected, abs=1e-6)


def test_a_late_platform_makes_the_cycle_longer_where_the_path_says(
    tasks_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In each stage the platform alone is slowed by the factor with which its turn takes DELAY more."""
    decided: list[Any] = []
    monkeypatch.setattr(
        decided_plan, "platform_notes", lambda model, plans: decided.append((model, plans)) or []
    )
    job = packing_job(tasks_folder, 6)
    settings = PlanSettings(effort="quick", blend="none")
    schedule = plan_without_bound(job, settings, check_collisions=False)
    model, plans = decided[-1]
    slow: list[tuple[Any, float]] = []
    timed = motion._transfers

    def transfers(drive: Any, before: Any, plan: Any) -> Any:
        for chosen, share in slow:
            if plan is chosen:
                speed = np.ones(len(drive.limits.joints))
                speed[drive.columns["platform"]] = share
                limits = drive.limits.scaled(speed)
                drive = dataclasses.replace(drive, limits=limits, cache=MotionCache())
        return timed(drive, before, plan)

    monkeypatch.setattr(motion, "_transfers", transfers)
    timing = TIMING_SOLVERS["ruckig"]
    cache = MotionCache()
    grown, expected = [], []
    for piece in critical_path(schedule).pieces:
        if piece.kind == "turn":
            slow[:] = [(plans[piece.stage], piece.length / (piece.length + DELAY))]
            late = realise(model, job, plans, timing, cache)
            grown.append(late.trajectory.duration - schedule.duration)
            expected.append(growth(piece.slack))
    assert min(expected) < 0.5 * DELAY < max(expected)  # some turns end before the arms arrive
    assert grown == pytest.approx(expected, abs=1e-6)


def test_asynchronous_arms_wait_for_each_other(
    tasks_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Departures of delayed arms follow from the planner's own rules: who leaves a rest after whom."""
    known: list[tuple[Any, Any]] = []

    def leaving(clocks: Any, rules: Any) -> Any:
        known.append((clocks, rules))
        return leaving_times(clocks, rules)

    monkeypatch.setattr(meeting_arms, "leaving_times", leaving)
    job, after = packing_job(tasks_folder, 6), {2: 3, 5: 2}
    tasks = tuple(
        dataclasses.replace(task, after=(job.tasks[after[k]].id,) if k in after else ())
        for k, task in enumerate(job.tasks)
    )
    job = dataclasses.replace(job, tasks=tasks, mode="free")
    settings = PlanSettings(platform="fixed", blend="none", effort="quick")
    schedule = plan_without_bound(job, settings, check_collisions=False)
    clocks, rules = known[-1]
    leave = leaving_times(clocks, rules)
    assert ends(clocks, leave) == pytest.approx(schedule.duration)
    grown, expected = [], []
    for piece in critical_path(schedule).pieces:
        if piece.kind != "dwell":
            continue
        arm = ("left", "right").index(piece.group)
        rest = np.searchsorted(leave[arm], piece.start + 1e-9) - 1
        own = piece.start - leave[arm][rest] + clocks[arm].rests[rest]
        late, shifted = (
            delayed(clocks[arm], own),
            [shifted_rule(r, arm, own, clocks) for r in rules],
        )
        changed = [late if k == arm else clock for k, clock in enumerate(clocks)]
        grown.append(ends(changed, leaving_times(changed, shifted)) - schedule.duration)
        expected.append(growth(piece.slack))
    assert min(expected) < 0.5 * DELAY < max(expected)  # some are absorbed, others are not
    assert grown == pytest.approx(expected, abs=1e-6)


def ends(clocks: Any, leave: Any) -> float:
    """Returns when the last arm is done [s]."""
    last = zip(clocks, leave, strict=True)
    return max(times[-1] + clock.duration - clock.rests[-1] for clock, times in last)


def delayed(clock: ClockSteps, own: float) -> ClockSteps:
    """Returns a clock on which everything after an instant is DELAY later."""
    rests = tuple(rest + DELAY * (rest > own + 1e-9) for rest in clock.rests)
    return dataclasses.replace(clock, rests=rests, duration=clock.duration + DELAY)


def shifted_rule(rule: Any, arm: int, own: float, clocks: Any) -> Any:
    """Returns a rule whose reference is later by DELAY if the delay is before it."""
    since = rule.reference
    if since is None or rule.arm == arm:
        return rule
    begun = clocks[arm].rests[since.rest] if since.rest >= 0 else 0.0
    if not begun <= own + 1e-9 < begun + since.after:
        return rule
    return dataclasses.replace(rule, reference=Since(since.rest, since.after + DELAY))


@pytest.mark.parametrize("name", ["01_first_pick", "12_chute"])
def test_the_chain_is_the_cycle(name: str, quick_plan: Any) -> None:
    """Its parts follow each other from beginning to end; the times of the plan give its own cycle."""
    schedule = quick_plan(name)
    chain = critical_path(schedule).chain
    assert [start for _, start, _ in chain[1:]] == [end for _, _, end in chain[:-1]]
    assert (chain[0][1], chain[-1][2]) == pytest.approx((0.0, schedule.duration), abs=1e-6)
    lengths = np.array([[piece.length for piece in pieces_of(schedule)]])
    assert retimed(schedule, pieces_of(schedule), lengths) == pytest.approx(schedule.duration)
