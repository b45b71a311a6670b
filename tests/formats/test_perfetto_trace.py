"""The trace, read as Chrome's trace event format says."""

from __future__ import annotations

import itertools
import json

import pytest

from dualarm_cli.formats import export


@pytest.fixture
def rows(exported):
    """The trace's events."""
    text = b"".join(export("perfetto", exported.request())["gantt.json"])
    return json.loads(text)["traceEvents"]


def test_each_arm_has_its_track_with_its_segments_and_events(exported, rows):
    """Names, begins and lengths in µs, to a nanosecond."""
    schedule = exported.schedule
    tracks = {row["tid"]: row["args"]["name"] for row in rows if row["name"] == "thread_name"}
    assert set(tracks.values()) == {"stages", *schedule.robot.arms}
    spans = [row for row in rows if row["ph"] == "X" and tracks[row["tid"]] != "stages"]
    assert len(spans) == len(schedule.segments)
    for span, segment in zip(spans, schedule.segments, strict=True):
        assert tracks[span["tid"]] == segment.arm
        assert span["cat"] == segment.kind
        assert span["ts"] * 1e-6 == pytest.approx(segment.start, abs=1e-9)
        assert (span["ts"] + span["dur"]) * 1e-6 == pytest.approx(segment.end, abs=1e-9)
    instants = [row for row in rows if row["ph"] == "i"]
    times = [row["ts"] * 1e-6 for row in instants]
    assert times == pytest.approx([event.time for event in schedule.events], abs=1e-9)


def test_spans_of_a_track_do_not_overlap(rows):
    """Perfetto nests spans that overlap by a nanosecond."""
    tracks = {}
    for row in rows:
        if row["ph"] == "X":
            tracks.setdefault(row["tid"], []).append((row["ts"], round(row["ts"] + row["dur"], 3)))
    for spans in tracks.values():
        spans.sort()
        assert all(one[1] <= other[0] for one, other in itertools.pairwise(spans))
