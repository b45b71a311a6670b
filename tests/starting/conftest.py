"""Fixtures of the tests of `dualarm init`."""

from __future__ import annotations

import pytest


@pytest.fixture
def unplanned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the plan by which `init` proves its targets, for tests of other things."""
    monkeypatch.setattr("dualarm_cli.starting.project.plan_without_bound", lambda *_: None)
