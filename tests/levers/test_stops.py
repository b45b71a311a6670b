"""Stops of sliders, and what a page has of the document of `dualarm why`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dualarm_cli.cli.parts.while_planning import Replanning
from dualarm_cli.cli.run import run
from dualarm_cli.files.source.amounts import read_amount
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.levers.changes import Lever, changed_by
from dualarm_cli.levers.stops import part
from dualarm_cli.page.page import DATA
from dualarm_cli.page.what_helps import levers_of


def test_a_part_of_a_lever_is_between_the_values_of_the_file() -> None:
    """By hand, in the file's units; a missing rotation is none."""
    data = {"gripper": "0.12 s", "xyz": [0.4, 0.0, 0.1], "frame": {}}
    documents: dict[str, Document] = {"tasks": type("", (), {"data": data})()}  # type: ignore[dict-item]
    dwell = Lever("gripper", "0.12 s to 0.06 s", "process", {"tasks:/gripper": "0.06 s"})
    half = part(dwell, documents, 0.5)
    assert (half.values, half.change) == ({"tasks:/gripper": "0.09 s"}, "0.12 s to 0.09 s")
    assert part(dwell, documents, 0.0).values == {"tasks:/gripper": "0.12 s"}
    frame = Lever("frame a: x", "+20 mm", "layout", {"tasks:/xyz/0": 0.42})
    back = part(frame, documents, -0.5)
    assert (back.values, back.change) == ({"tasks:/xyz/0": 0.39}, "-10 mm")
    turn = Lever("frame a: yaw", "+5 deg", "layout", {"tasks:/frame/rpy": [0, 0, "5 deg"]})
    assert part(turn, documents, -1.0).values == {"tasks:/frame/rpy": [0.0, 0.0, "-5.0 deg"]}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([("approach", "80 mm", "40 mm"), ("approach", "80 mm", "40 mm")], "80 mm to 40 mm"),
        ([("approach", 0.08, 0.04)], "0.08 to 0.04 m"),
        ([("acceleration", 7.6, 9.12), ("jerk", 76, 91.2)], "+20%"),
        ([("approach", "80 mm", "60 mm"), ("retract", "60 mm", "45 mm")], "-25%"),
    ],
)
def test_a_change_has_its_unit_or_a_percentage(changes: list[Any], words: str) -> None:
    """Old and new value if they are the same everywhere; several values share one factor."""
    assert changed_by([(k, read_amount(a), read_amount(b)) for k, a, b in changes]) == words


def test_sliders_that_change_the_same_value_exclude_each_other() -> None:
    """Approach alone, retract alone, both, and one without stops."""

    def row(stops: list[Any], *keys: str) -> dict[str, Any]:
        members = {name: None for name in ("estimate", "gain")}
        texts = {name: "" for name in ("name", "change", "kind", "reason", "status")}
        return {**members, **texts, "values": dict.fromkeys(keys, 1), "stops": stops}

    rows = [row([1], "a", "b"), row([1], "a"), row([1], "b"), row([], "a")]
    shown = levers_of({"levers": rows, "combinations": [], "sentences": []})["levers"]
    assert [lever.get("excludes") for lever in shown] == [[1, 2], [0], [0], None]


def data_of(page: Path) -> dict[str, Any]:
    """Returns the data of a page."""
    text = page.read_text(encoding="utf-8").partition(DATA)[2].partition("</script>")[0]
    data: dict[str, Any] = json.loads(text)
    return data


def test_the_page_has_the_levers_of_its_plan(
    planned_files: Callable[[str], Path], tmp_path: Path, tasks_folder: Path
) -> None:
    """Written by `why`, kept by `report`, left out where they are of another plan; planning again changes nothing."""
    plan = tmp_path / "plan"
    shutil.copytree(planned_files("01_first_pick"), plan)
    tasks = tasks_folder / "01_first_pick" / "tasks.yaml"
    assert run(["report", str(plan), "--tasks", str(tasks), "-q"]) == 0
    assert "levers" not in data_of(plan / "report.html")
    assert run(["why", str(plan), "--tasks", str(tasks), "--budget", "0", "-q"]) == 0
    document = json.loads((plan / "why.json").read_text())
    with_stops = [lever for lever in document["levers"] if lever["stops"]]
    assert with_stops
    for lever in with_stops:
        assert lever["stops"][-1]["estimate"] == lever["estimate"]
        if lever["name"] in ("gripper", "settle", "dwell"):
            # The arms do not wait for each other in this job: time of dwells goes in proportion.
            gains = [stop["estimate"] / stop["share"] for stop in lever["stops"]]
            assert gains == pytest.approx([lever["estimate"]] * len(gains), abs=1e-6)
    assert data_of(plan / "report.html")["levers"] == levers_of(document)
    assert run(["report", str(plan), "--tasks", str(tasks), "-q"]) == 0
    assert data_of(plan / "report.html")["levers"] == levers_of(document)

    asked = [[f"{with_stops[0]['name']} {with_stops[0]['change']}", 0.0]]
    answer = Replanning(tasks, plan)({"levers": asked})
    assert answer["status"] == "planned"
    # Tests search more briefly than the process does.
    assert answer["cycle_time"] == pytest.approx(document["cycle_time"], rel=0.01)
    assert answer["gain"] == pytest.approx(document["cycle_time"] - answer["cycle_time"])
    for request in ({"levers": [["unknown", 1.0]]}, [], {"levers": 1}):
        assert "reload the page" in Replanning(tasks, plan)(request)["error"]

    document["pieces"][0]["slack"] += 1.0
    (plan / "why.json").write_text(json.dumps(document))
    assert run(["report", str(plan), "--tasks", str(tasks), "-q"]) == 0
    assert "levers" not in data_of(plan / "report.html")
