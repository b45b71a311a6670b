"""Points and readings that calibrations are tested with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.calibration import CalibrationProblem
from dualarm_cli.files.calibration.points import load_points
from dualarm_cli.geometry.rotations import exp_rotation
from dualarm_cli.model.touches import Touches

Problem = Callable[..., CalibrationProblem]
TRUE_ROTATION = exp_rotation(np.array([0.3, -0.5, 2.0]))
TRUE_TRANSLATION = np.array([-2.8, 0.3, 0.05])


@pytest.fixture
def qin(tasks_folder: Path) -> Touches:
    """Table 6 of [Qin2024] as it is shipped."""
    return load_points(tasks_folder / "papers" / "qin_calibration" / "points.yaml").touches


@pytest.fixture
def problem() -> Problem:
    """Returns what makes a problem of left points (n, 3), exact or with noise in both robots' points."""

    def make(
        left: np.ndarray, deviation: float = 0.0, stated: float | None = None, seed: int = 0
    ) -> CalibrationProblem:
        random = np.random.default_rng(seed)
        left = np.asarray(left, dtype=float)
        right = (left - TRUE_TRANSLATION) @ TRUE_ROTATION
        return CalibrationProblem(
            left + deviation * random.normal(size=left.shape),
            right + deviation * random.normal(size=left.shape),
            tuple(f"P{k + 1}" for k in range(len(left))),
            stated,
        )

    return make


@pytest.fixture
def truth() -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation that `problem` hides in its points."""
    return TRUE_ROTATION, TRUE_TRANSLATION


@pytest.fixture
def spread_points() -> np.ndarray:
    """Eight points in a box of 1.2 m, one in front of the left robot."""
    random = np.random.default_rng(5)
    return random.uniform([-1.8, -0.1, 0.6], [-0.6, 1.1, 1.8], (8, 3))
