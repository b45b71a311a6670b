"""Evaluations and baselines that tests compare with each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.scoring.baseline import Recorded


@pytest.fixture
def evaluation() -> Callable[..., Evaluation]:
    """Makes an evaluation with a plan, changed as a test wants it."""

    def make(case: str = "cells/a/tasks.yaml", **changes: Any) -> Evaluation:
        values: dict[str, Any] = {
            "status": "planned",
            "cycle_time": 10.0,
            "closes": True,
            "lower_bound": 9.0,
            "gap": 0.1,
            "clearance": 0.02,
            "required_clearance": 0.01,
            "travel": 12.5,
            "limiting": {"left_s": 6.0, "dwells": 4.0},
            "limits": {"left_s": {"velocity": 3.0}, "right_s": {"velocity": 3.0}},
            "inputs": {"cell.yaml": "aa", "tasks.yaml": "bb"},
        }
        return Evaluation(case, **(values | changes))

    return make


@pytest.fixture
def recorded(evaluation: Callable[..., Evaluation]) -> Callable[..., Recorded]:
    """Makes what a baseline holds of such an evaluation."""

    def make(**changes: Any) -> Recorded:
        return Recorded.of(evaluation(**changes))

    return make
