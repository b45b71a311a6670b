"""What tests of every layer share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# As the command does for itself, and before numpy is loaded: small matrices, one thread.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def tasks_folder() -> Path:
    """The shipped task files."""
    return ROOT / "tasks"
