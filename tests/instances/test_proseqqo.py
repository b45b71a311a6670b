"""ProSeqqo's instances: what is in them, and plans against cycle times known otherwise."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

Script = Callable[[str], ModuleType]
# Parts, and grasps of all of them, counted in the original files.
COUNTS = {
    "test01": (3, 15),
    "test02": (3, 14),
    "test11": (4, 19),
    "test21": (5, 19),
    "test31": (5, 33),
    "test41": (10, 64),
    "test42": (10, 87),
    "test61": (20, 178),
}


@pytest.fixture
def proseqqo(script: Script) -> ModuleType:
    """The script."""
    return script("proseqqo")


@pytest.mark.parametrize("name", COUNTS)
def test_parts_grasps_and_places_are_the_original_s(proseqqo, name) -> None:
    """All instances share home and the four configurations of the place."""
    instance, first = proseqqo.read_instance(name), proseqqo.read_instance("test01")
    assert (len(instance.picks), sum(map(len, instance.picks))) == COUNTS[name]
    np.testing.assert_array_equal(instance.home, first.home)
    np.testing.assert_array_equal(instance.places, first.places)
    assert instance.places.shape == (4, 6)


def test_an_original_file_gives_our_data(proseqqo, tmp_path, monkeypatch) -> None:
    """Two parts with the same place; decimal commas; configurations are named by their numbers, not by their place."""
    original = tmp_path / "two.seq"
    original.write_text(
        "Task: General\nConfigList: \n7;[-1,5;0;0;0;0;-0,25];Camera\n1;[1;0;0;0;0;0];Grasp1_1\n"
        "2;[2;0;0;0;0;0];Grasp1_2\n3;[3;0;0;0;0;0];Inter1_1\n4;[4;0;0;0;0;0,5];Grasp2\n5;[3;0;0;0;0;0];Inter2\n\n"
        "ProcessHierarchy: \n4000;3000;1000;1;[7]\n4001;3001;1001;1;[1]\n4001;3001;1001;2;[2]\n4001;3001;2001;3;[3]\n"
        "4002;3002;1002;4;[4]\n4002;3002;2002;5;[5]\nProcessPrecedence: \n"
    )
    monkeypatch.setattr(proseqqo, "FOLDER", tmp_path)
    assert proseqqo.import_sequence(original) == tmp_path / "two.csv"
    instance = proseqqo.read_instance("two")
    np.testing.assert_array_equal(instance.home, [-1.5, 0, 0, 0, 0, -0.25])
    assert [pick[:, 0].tolist() for pick in instance.picks] == [[1.0, 2.0], [4.0]]
    np.testing.assert_array_equal(instance.places, [[3.0, 0, 0, 0, 0, 0]])


@pytest.mark.parametrize(("name", "given"), [("test01", 9.507223), ("test61", 61.933458)])
def test_the_plan_in_the_given_order_takes_the_best_configurations(
    proseqqo, tmp_path: Path, name, given
) -> None:
    """9.507223 s are known from elsewhere; both are the shortest path through the layers of configurations."""
    assert proseqqo.given_order_time(proseqqo.read_instance(name)) == pytest.approx(given, abs=1e-6)
    job = load_job(proseqqo.write_instance(name, tmp_path / name, "given"))
    schedule = plan_without_bound(job, PlanSettings(timing="trapezoid"))
    assert schedule.duration == pytest.approx(given, abs=1e-6)
    assert not verify(schedule, job).failures


@pytest.mark.parametrize("name", ["test01", "test02", "test11", "test21", "test31"])
def test_the_optima_are_the_best_of_all_orders(proseqqo, name) -> None:
    """Up to 120 orders, each with its best configurations."""
    instance = proseqqo.read_instance(name)
    best = min(
        proseqqo.given_order_time(proseqqo.Instance(instance.home, order, instance.places))
        for order in itertools.permutations(instance.picks)
    )
    assert best == pytest.approx(proseqqo.OPTIMA[name], abs=1e-6)


def test_the_first_configurations_are_far_from_the_best(proseqqo) -> None:
    """test01 with the first of every choice: 12.676091 s, known from elsewhere."""
    instance = proseqqo.read_instance("test01")
    firsts = tuple(pick[:1] for pick in instance.picks)
    time = proseqqo.given_order_time(proseqqo.Instance(instance.home, firsts, instance.places[:1]))
    assert time == pytest.approx(12.676091, abs=1e-6)
