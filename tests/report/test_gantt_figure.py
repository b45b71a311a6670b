"""The chart of who does what when: the same bytes, words that fit, rows, and the platform's lane."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.report.figures.gantt_figure import (
    POINTS,
    STYLE,
    Bar,
    Wanted,
    draw_gantt,
    labels,
    place_text,
    platform_moves,
    platform_words,
    row_count,
    task_words,
    text_width,
    title,
)

JOB = SimpleNamespace(returns=True)
SMALLEST = min(STYLE.word_sizes)


@pytest.fixture
def schedule(by_hand):
    """Left alone: a for 4 s, a wait, b for 5 s; the platform turns by 30 degrees from 1 s to 3 s."""
    left = by_hand.row(
        "left",
        ("transfer", "a", 2.0),
        ("approach", "a", 2.0),
        ("wait", "b", 1.0, "shared_zone"),
        ("transfer", "b", 1.0),
        ("dwell", "b", 4.0),
    )
    turn = math.radians(30.0)
    return by_hand.schedule(left, way=[(0.0, 0.0), (1.0, 0.0), (3.0, turn), (10.0, turn)])


def test_the_same_schedule_gives_the_same_bytes_with_all_its_lanes_and_names(schedule):
    """Words are drawn as shapes with the word beside them; reasons that there are stand in the legend, others not."""
    one = draw_gantt(schedule, JOB, "svg")
    assert one == draw_gantt(schedule, JOB, "svg")
    drawn = one.decode()
    for word in ("left", "right", "platform", "a", "b", "0°", "30°", "waits: shared zone", "dwell"):
        assert f"<!-- {word} -->" in drawn
    for word in ("waits: partner", "return", "seam"):
        assert f"<!-- {word} -->" not in drawn
    assert draw_gantt(schedule, JOB, "png").startswith(b"\x89PNG")


def test_dollars_in_an_id_are_dollars(by_hand):
    """Two of them would be a formula, and this one none that can be read."""
    left = by_hand.row("left", ("transfer", r"part $\frac$", 2.0))
    drawn = draw_gantt(by_hand.schedule(left), JOB, "svg").decode()
    assert r"<!-- part $\frac$ -->" in drawn


def test_the_title_has_time_bound_and_gap_where_there_are_such(schedule):
    """10 s and a bound of 8 s: a gap of a fifth."""
    assert title(schedule, JOB) == "by hand: cycle time 10.000 s"
    bounded = dataclasses.replace(schedule, lower_bound=8.0)
    assert title(bounded, SimpleNamespace(returns=False)) == (
        "by hand: duration 10.000 s, bound 8.000 s, gap 20.0%"
    )
    # That all takes more than no time is nothing to tell.
    nothing = dataclasses.replace(schedule, lower_bound=0.0)
    assert title(nothing, JOB) == "by hand: cycle time 10.000 s"


@pytest.mark.parametrize(
    ("stops", "rows"),
    [(1, 1), (STYLE.stops_a_row, 1), (STYLE.stops_a_row + 1, 2), (500, STYLE.most_rows)],
)
def test_the_axis_is_broken_where_an_arm_has_many_stops(by_hand, stops, rows):
    """The arm with most of them decides; there are never more than MOST_ROWS."""
    left = by_hand.row("left", *(("transfer", f"t{k}", 1.0) for k in range(stops)))
    right = by_hand.row("right", ("transfer", "other", 1.0))
    schedule = by_hand.schedule([*left, *right])
    assert row_count(schedule) == rows
    assert draw_gantt(schedule, JOB, "png").startswith(b"\x89PNG")


def test_the_platform_moves_from_its_first_speed_to_its_last(by_hand, schedule):
    """Braking half way is no stop; two moves that follow one another are two."""
    assert platform_moves(schedule) == [(1.0, 3.0)]
    left = by_hand.row("left", ("transfer", "a", 6.0))
    way = [(0.0, 0.0), (2.0, 1.0), (4.0, -1.0), (6.0, -1.0)]
    assert platform_moves(by_hand.schedule(left, way=way)) == [(0.0, 2.0), (2.0, 4.0)]


def test_where_the_platform_stands_is_written_between_its_moves(schedule):
    """0 degrees until 1 s, 30 from 3 s on; of a row from 2 s to 5 s only what lies in it, and it is cut."""
    moves = platform_moves(schedule)
    words = platform_words(schedule, moves, 2, 0.0, 10.0)
    found = [(w.text, w.lane, w.bars[0].start, w.bars[0].end, w.whole) for w in words]
    assert found == [("0°", 2, 0.0, 1.0, True), ("30°", 2, 3.0, 10.0, True)]
    (cut,) = platform_words(schedule, moves, 2, 2.0, 5.0)
    assert (cut.text, cut.bars[0].start, cut.bars[0].end, cut.whole) == ("30°", 3.0, 5.0, False)


def test_a_platform_that_slides_stands_at_a_way(by_hand):
    """As its URDF says: 0.25 m are no angle."""
    left = by_hand.row("left", ("transfer", "a", 4.0))
    urdf = '<robot><joint name="turn" type="prismatic"/></robot>'
    schedule = by_hand.schedule(left, way=[(0.0, 0.25), (4.0, 0.25)], urdf=urdf)
    (word,) = platform_words(schedule, [], 2, 0.0, 4.0)
    assert word.text == "250 mm"


@pytest.mark.parametrize(
    ("degrees", "text"),
    [(30.04, "30°"), (29.96, "30°"), (-9.03, "−9°"), (12.34, "12.3°"), (-0.01, "0°")],
)
def test_angles_are_whole_degrees_where_they_nearly_are(degrees, text):
    """Else with one decimal; nothing is minus nought."""
    assert place_text(math.radians(degrees), False) == text


def test_an_id_stands_in_its_transfer_if_that_holds_it_and_else_in_the_longest_bar(schedule):
    """The transfer of b is 1 s, its dwell 4 s: at a scale at which the word takes 2 s it goes into the dwell."""
    words = task_words(schedule, ["left", "right"], 0.0, 10.0)
    assert [word.text for word in words] == ["a", "b"]
    need = (text_width("b") * SMALLEST + STYLE.padding) / POINTS
    roomy = {label.text: label.time for label in labels(words, 100.0 * need)}
    assert roomy == {"a": 1.0, "b": 5.5}
    tight = {label.text: label.time for label in labels(words, need / 2.0)}
    assert tight["b"] == 8.0


@given(
    ends=st.lists(st.floats(0.01, 3.0), min_size=1, max_size=12),
    names=st.lists(st.text("abw-1", min_size=1, max_size=12), min_size=12, max_size=12),
    inch=st.floats(0.05, 3.0),
)
def test_words_never_reach_beyond_their_bars_and_are_of_one_size(ends, names, inch):
    """Bars side by side in one lane: words within their bars cannot lie on one another."""
    clock, words = 0.0, []
    for name, length in zip(names, ends, strict=False):
        words.append(Wanted(name, 0, (Bar(0, clock, clock + length, False),), True))
        clock += length
    found = labels(words, inch)
    assert len({label.size for label in found}) <= 1
    bars = {(bar.start + bar.end) / 2.0: bar for word in words for bar in word.bars}
    for label in found:
        bar = bars[label.time]
        assert text_width(label.text) * label.size <= (bar.end - bar.start) * inch * POINTS


def test_words_that_do_not_fit_are_shortened():
    """One long bar among nine short ones: each says what differs from the others, or as many letters as fit."""
    inch = (text_width("500") * SMALLEST + 1.05 * STYLE.padding) / POINTS / 0.25
    two_letters = (text_width("9…") * SMALLEST + 1.05 * STYLE.padding) / POINTS / inch
    words = [
        Wanted(f"left-{k}00", 0, (Bar(0, k, k + length, False),), True, f"{k}00")
        for k, length in enumerate([1.0, *[0.25] * 8, two_letters])
    ]
    found = {label.time: label.text for label in labels(words, inch)}
    assert found[0.5] == "left-000"
    assert [found[k + 0.125] for k in range(1, 9)] == [f"{k}00" for k in range(1, 9)]
    assert found[9.0 + two_letters / 2.0] == "9…"
    assert labels(words[-1:], 1e-3) == []


def test_what_ids_of_a_lane_begin_with_is_what_is_left_out(by_hand):
    """Up to a hyphen; an id that others begin with keeps its name, and one alone as well."""
    steps = [("transfer", name, 1.0) for name in ("left-cup", "left-can")]
    schedule = by_hand.schedule(by_hand.row("left", *steps))
    assert [word.short for word in task_words(schedule, ["left"], 0.0, 2.0)] == ["cup", "can"]
    alone = by_hand.schedule(by_hand.row("left", steps[0]))
    assert [word.short for word in task_words(alone, ["left"], 0.0, 2.0)] == ["left-cup"]


def test_zeros_that_all_ids_share_are_left_out_but_never_the_last_digit(by_hand):
    left = by_hand.row("left", ("transfer", "left-0009", 1.0), ("transfer", "left-0010", 1.0))
    words = task_words(by_hand.schedule(left), ["left"], 0.0, 2.0)
    assert [word.short for word in words] == ["09", "10"]
    left = by_hand.row("left", ("transfer", "p-00", 1.0), ("transfer", "p-0", 1.0))
    words = task_words(by_hand.schedule(left), ["left"], 0.0, 2.0)
    assert [word.short for word in words] == ["00", "0"]


def test_numbers_never_lose_digits():
    """An angle that has no room is left out: its first digit would be another angle."""
    narrow = (text_width("3…") * SMALLEST + 1.05 * STYLE.padding) / POINTS
    angle = Wanted("31.4°", 0, (Bar(0, 0.0, narrow, False),), True, number=True)
    assert labels([angle], 1.0) == []
    assert [label.text for label in labels([dataclasses.replace(angle, number=False)], 1.0)] == [
        "3…"
    ]


def test_picks_and_places_approaches_and_retracts_look_different(by_hand):
    parts = ("transfer", "approach", "dwell", "retract")
    row = by_hand.row("left", *((kind, "a", 1.0) for kind in 2 * parts))
    actions = ["pick"] * 4 + ["place"] * 4
    row = [dataclasses.replace(p, action=a) for p, a in zip(row, actions, strict=True)]
    drawn = draw_gantt(by_hand.schedule(row), JOB, "svg").decode()
    for name in ("approach", "retract", "dwell: pick", "dwell: place"):
        assert f"<!-- {name} -->" in drawn


def test_stages_are_numbered_where_both_arms_begin_them(by_hand):
    """Stage 2 begins at 2 s; arms with clocks of their own have no common stages."""
    schedule = by_hand.schedule(by_hand.row("left", ("transfer", "a", 2.0), ("transfer", "b", 2.0)))
    stages = tuple(by_hand.stage(start, start + 2.0) for start in (0.0, 2.0))
    drawn = draw_gantt(dataclasses.replace(schedule, stages=stages), JOB, "svg").decode()
    assert drawn.count("<!-- 2 -->") > draw_gantt(schedule, JOB, "svg").decode().count("<!-- 2 -->")
    own = tuple(dataclasses.replace(stage, arm="left") for stage in stages)
    apart = draw_gantt(dataclasses.replace(schedule, stages=own), JOB, "svg")
    assert apart == draw_gantt(dataclasses.replace(schedule, stages=()), JOB, "svg")
