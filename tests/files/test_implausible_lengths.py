# ruff: noqa: E501 (a table, one case a line)
"""Lengths in millimetres without a unit: refused where no cell has so many metres."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dualarm_cli.files.tasks.tasks import load_job


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("cell.yaml", "120 mm", "150", "4:28: E200 150 without a unit is m, and more than 5 m; did you mean '150 mm'?"),
        ("cell.yaml", "clearance: 10 mm", "clearance: 10", "10:12: E200 10 without a unit is m, and more than 1 m; did you mean '10 mm'?"),
        ("cell.yaml", "[0.4, 0.1, 0.7]", "[400, 0.1, 0.7]", "6:15: E200 400 without a unit is m, and more than 50 m; did you mean '400 mm'?"),
        ("cell.yaml", "[1, 2, 40 mm]", "[1000, 2, 40 mm]", "9:17: E200 1000 without a unit is m, and more than 50 m; did you mean '1000 mm'?"),
        ("tasks.yaml", "approach: 80 mm", "approach: 80", "6:22: E200 80 without a unit is m, and more than 5 m; did you mean '80 mm'?"),
        ("tasks.yaml", "approach: 80 mm", "approach: '80'", "6:22: E200 '80' without a unit is m, and more than 5 m; did you mean '80 mm'?"),
        ("tasks.yaml", "start: bent", "start: bent\nlimits: {tool_speed: 250}", "6:22: E200 250 without a unit is m/s, and more than 20 m/s; did you mean '250 mm/s'?"),
    ],
)  # fmt: skip
def test_each_is_told_with_what_was_meant(
    file: str,
    old: str,
    new: str,
    expected: str,
    change: Callable[..., None],
    messages: Callable[[Callable[[], object]], list[str]],
) -> None:
    change(file, old, new)
    assert messages(lambda: load_job("tasks.yaml")) == [f"{file}:{expected}"]
