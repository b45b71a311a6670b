"""Requests that are quickly answered."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dualarm_cli.evaluation.request import Request


@pytest.fixture
def request_for() -> Callable[[str], Request]:
    """Makes requests that are quickly answered."""
    return lambda case: Request.of(case, platform="fixed", effort="quick")
