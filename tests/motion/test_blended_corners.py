"""Corners passed in motion: against an IPOPT optimum, all pairs of ways, and the verifier's limits."""

from __future__ import annotations

import importlib
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.compiled import trajectories
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.launch import COMPARED, CUTS, PROFILES, launches
from dualarm_cli.timing.line_ends import RANGES, Passings, _place, quickest_pair, refined_pair
from dualarm_cli.timing.line_profile import path_of
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def script():
    """The benchmark of blended corners, as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        return importlib.import_module("benchmarks.quality.blended_corners")


def families(corner):
    """Both lines' ways, the transfer, and how long it takes from rest to rest."""
    first = LineProblem(corner.limits.joints, corner.retract, corner.length, corner.limits)
    second = replace(first, position=corner.approach[::-1])
    line = TIMING_SOLVERS["ruckig"].line
    before = Passings.along(first, line(first).duration, away=True)
    after = Passings.along(second, line(second).duration, away=False)
    start, goal, own = corner.retract[-1], corner.approach[0], corner.limits
    law = RestToRest(own.velocity, own.acceleration, own.jerk)
    problem = TransferProblem(own.joints, start, goal, own)
    return before, after, problem, float(law.duration(goal - start))


def narrowed(corner, room):
    """The same corner where no joint may leave the ranges of both lines by more than some room [rad]."""
    both = np.concatenate([corner.retract, corner.approach])
    limits = replace(corner.limits, lower=both.min(axis=0) - room, upper=both.max(axis=0) + room)
    return replace(corner, limits=limits)


def test_durations_are_within_5_percent_of_the_optimum(script, monkeypatch):
    """Two corners on a coarse grid, and the program's own limits hold between its constraints as well."""
    monkeypatch.setattr(script, "LINE", 14)
    monkeypatch.setattr(script, "TRANSFER", 28)
    corners = islice((c for c in script.random_corners(0.08, 0) if c.margin > script.MARGIN), 2)
    reference = None
    for corner in corners:
        reference = reference or script.Reference(corner.limits)
        ours = script.blend(corner)
        least, used = reference.solve(corner, ours)
        assert used < 1.005
        # No slower than allowed, and a reference that we beat would be none.
        assert 0.995 * least < ours.duration < 1.05 * least < 1.05 * ours.rest


@pytest.mark.slow
@pytest.mark.parametrize("line", [0.08, 0.04, 0.02])
def test_50_corners_are_within_5_percent_of_the_optimum(script, line):
    """And a fifth faster than from rest to rest in the median, as measured without any blending of ours."""
    ratio, gain = script.compare(line, 0, 50).T
    assert ratio.min() > 0.999
    assert ratio.max() < 1.05
    assert np.median(gain) < 0.85


@pytest.mark.parametrize("line", [0.08, 0.02])
def test_no_corner_breaks_a_limit_or_is_slower_than_rest_to_rest(script, line):
    """Postures as they come, also at position limits; judged by the verifier."""
    for corner in islice(script.random_corners(line, 3), 60):
        found = script.blend(corner)
        assert script.broken_limits(corner, found) == []
        assert found.duration <= found.rest + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("line", "count"), [(0.08, 4000), (0.04, 3000), (0.02, 3000)])
def test_10_000_corners_break_no_limit(script, line, count):
    """With and without room for joints beyond their lines."""
    for k, corner in enumerate(islice(script.random_corners(line, 1), count)):
        tried = corner if k % 2 else narrowed(corner, 0.02)
        found = script.blend(tried)
        assert script.broken_limits(tried, found) == []
        assert found.duration <= found.rest + 1e-9


@pytest.mark.parametrize("room", [3.0, 0.02])
@pytest.mark.parametrize("jerk", ["limited", "unlimited"])
def test_the_pair_is_nearly_the_best_of_all_pairs(script, room, jerk):
    """Every third way of either line with every third one; near limits of position and without jerk limits too."""
    for corner in islice(script.random_corners(0.04, 7), 4):
        tried = narrowed(corner, room)
        if jerk == "unlimited":
            limits = replace(tried.limits, jerk=np.full(7, np.inf))
            tried = replace(tried, limits=limits)
        before, after, problem, rest = families(tried)
        i, j, time = quickest_pair(before, after, problem, rest)
        transfer = MovingTransfer(problem)
        best = float(before.time[0] + rest + after.time[0])
        assert time <= best
        if i or j:
            taken = transfer.duration(before.rates[i], after.rates[j])
            assert time == pytest.approx(before.time[i] + taken + after.time[j], rel=1e-12)
        for a in range(0, len(before.launches), 3):
            for b in range(0, len(after.launches), 3):
                lines = float(before.time[a] + after.time[b])
                if lines < best:
                    taken = transfer.duration(before.rates[a], after.rates[b], best - lines)
                    best = min(best, lines + taken)
        assert time <= 1.02 * best


def test_the_pair_near_a_given_one_is_never_slower_than_it(script, monkeypatch):
    """From any pair and from rest; from the best one with fewer transfers than without it."""
    timed = []
    duration = MovingTransfer.duration

    def counted(*given):
        timed.append(given)
        return duration(*given)

    monkeypatch.setattr(MovingTransfer, "duration", counted)
    rng = np.random.default_rng(4)
    for corner in islice(script.random_corners(0.08, 9), 4):
        before, after, problem, rest = families(corner)
        transfer = MovingTransfer(problem)
        still = float(before.time[0] + rest + after.time[0])
        begun = rng.integers(1, [len(before.launches), len(after.launches)], size=(6, 2)).tolist()
        for i, j in [(0, 0), *begun]:
            lines = float(before.time[i] + after.time[j])
            taken = transfer.duration(before.rates[i], after.rates[j]) if i or j else rest
            near = quickest_pair(before, after, problem, rest, start=(i, j))
            assert near[2] <= min(still, lines + taken)
        timed.clear()
        best = quickest_pair(before, after, problem, rest)
        without = len(timed)
        assert quickest_pair(before, after, problem, rest, start=best[:2])[2] <= best[2]
        assert len(timed) - without < without


def test_lines_are_as_short_as_can_be_where_the_platform_decides(script):
    """It takes two seconds: nothing but the lines' own time is left to save."""
    corner = next(script.random_corners(0.08, 2))
    before, after, problem, rest = families(corner)
    problem = replace(problem, minimum_duration=2.0)
    i, j, time = quickest_pair(before, after, problem, 2.0)
    assert 2.0 + before.time.min() + after.time.min() <= time
    assert time < before.time[0] + 2.0 + after.time[0] - 0.05
    assert rest < 2.0 and before.time[i] < before.time[0] and after.time[j] < after.time[0]


def test_ways_are_found_by_profile_and_cut(limits):
    """Rest first, then all cuts of the first profile; beyond the cuts, and without a line, is rest."""
    length = np.linspace(0.0, 0.08, 65)
    path = length[:, None] * np.linspace(1, 2, 7)
    problem = LineProblem(limits.joints, path, length, limits)
    ways = Passings.along(problem, 0.4, away=True)
    assert ways.launches[0] is None and ways.time[0] == 0.4 and not ways.rates[0].any()
    found = ways.launches[ways.indices[2, 3]]
    assert (found.constant, found.cruise, found.inner) == PROFILES[2]
    assert found.cut == CUTS[3]
    assert ways.indices[5, len(CUTS)] == 0
    assert all(ways.indices[_place(i)] == i for i in range(len(ways.launches)))
    assert Passings.none(7).indices[2, 3] == 0
    coming = Passings.along(problem, 0.4, away=False)
    estimated = launches(problem)
    np.testing.assert_array_equal(ways.rates[1:, 0], estimated.velocity)
    np.testing.assert_array_equal(coming.rates[1:, 0], -estimated.velocity)
    np.testing.assert_array_equal(coming.rates[1:, 1], estimated.acceleration)


def test_without_lines_it_is_the_transfer_from_rest_to_rest(limits):
    """Nothing to choose."""
    none = Passings.none(7)
    problem = TransferProblem(limits.joints, np.zeros(7), np.ones(7), limits)
    assert quickest_pair(none, none, problem, 1.25) == (0, 0, 1.25)


@pytest.mark.parametrize("platform", [0.0, 0.9])
def test_refined_ways_are_quicker_than_the_pair_they_come_from(script, platform):
    """Judged by estimates from all samples and ruckig's transfer; all numbers within their ranges."""
    gained = []
    for corner in islice(script.random_corners(0.08, 5), 6):
        before, after, problem, rest = families(corner)
        problem = replace(problem, minimum_duration=platform)
        i, j, time = quickest_pair(before, after, problem, max(rest, platform))
        assert refined_pair((before, after), (i, j, time), problem, 0) == (
            before.launches[i],
            after.launches[j],
        )
        spent = [time]
        for widths in (1, 4):
            ways = refined_pair((before, after), (i, j, time), problem, widths)
            spent.append(estimated((before, after), ways, problem))
            for way in filter(None, ways):
                numbers = way.constant, way.cruise, way.inner, way.cut
                assert all(
                    low <= x <= high for x, (low, high, _) in zip(numbers, RANGES, strict=True)
                )
        assert max(spent[1:]) <= time + 1e-9
        gained.append(1.0 - spent[-1] / time)
    assert np.mean(gained) > (0.004 if platform == 0.0 else 0.0)


def estimated(lines, ways, problem):
    """How long both lines passed in some ways and the transfer between them take."""
    spent, rates = 0.0, []
    for one, way in zip(lines, ways, strict=True):
        if way is None:
            spent += float(one.time[0])
            rates.append(one.rates[0])
            continue
        profile = np.array([[way.constant, way.cruise, way.inner]])
        _, time, velocity, acceleration = trajectories.launches(
            path_of(one.line), profile, np.array([way.cut]), COMPARED
        )
        spent += float(time[0, 0])
        sign = 1.0 if one.away else -1.0
        rates.append(np.stack([sign * velocity[0, 0], acceleration[0, 0]]))
    return spent + MovingTransfer(problem).duration(*rates)


def test_what_is_at_rest_is_not_refined(limits):
    """Neither without a line nor where rest is best."""
    none = Passings.none(7)
    problem = TransferProblem(limits.joints, np.zeros(7), np.ones(7), limits)
    assert refined_pair((none, none), (0, 0, 1.25), problem, 3) == (None, None)
