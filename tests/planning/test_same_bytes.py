"""A plan is the same to the last byte on three classes of processors."""

from __future__ import annotations

import importlib
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def same_bytes():
    """The benchmark that plays three processors; skipped on a processor that cannot tell them apart."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        module = importlib.import_module("benchmarks.correctness.same_bytes")
    if why := module.blind():
        pytest.skip(why)
    return module


@pytest.mark.parametrize("job", ["03_bottin_planar", "09_yumi", "13_hand_over"])
def test_a_plan_is_the_same_on_every_processor(job, same_bytes, tmp_path):
    """With and without AVX-512, and without FMA; a quarter of the circles of 09_yumi."""
    folder = shutil.copytree(ROOT / "tasks" / job, tmp_path / job)
    tasks = folder / "tasks.yaml"
    tasks.write_text(tasks.read_text().replace("angle: 360 deg", "angle: 90 deg"))
    assert same_bytes.same_everywhere(tasks, ["--effort", "quick"]) == []
