"""What tests of every layer share."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def tasks_folder() -> Path:
    """The shipped task files."""
    return ROOT / "tasks"
