"""A second process gives what this one would, fails as this one would, and is gone when it is no longer needed."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.interface import planned
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.beside import Beside


def no_child_is_left():
    """Returns whether this process has no copy of itself, running or waited for."""
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


@pytest.mark.parametrize("copied", [False, True])
def test_a_result_is_that_of_the_function(copied):
    """Of more bytes than a pipe holds."""
    with Beside(lambda: (os.getpid(), np.arange(1_000_000)), copied=copied) as beside:
        made_by, numbers = beside.result()
    assert (made_by != os.getpid()) == copied
    np.testing.assert_array_equal(numbers, np.arange(1_000_000))
    assert no_child_is_left()


def test_an_error_is_raised_where_the_result_is_asked_for():
    def made():
        raise ValueError("nothing reaches it")

    with Beside(made, copied=True) as beside, pytest.raises(ValueError, match="reaches"):
        beside.result()
    assert no_child_is_left()


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM])
def test_a_copy_that_is_killed_is_replaced(by):
    here = os.getpid()

    def made():
        if os.getpid() != here:
            os.kill(os.getpid(), by)
            time.sleep(60.0)
        return 7

    with Beside(made, copied=True) as beside:
        assert beside.result() == 7
    assert no_child_is_left()


def test_ctrl_c_is_left_to_the_first_process():
    def made():
        os.kill(os.getpid(), signal.SIGINT)
        return os.getpid()

    with Beside(made, copied=True) as beside:
        assert beside.result() != os.getpid()


def test_a_result_that_nobody_asks_for_is_not_waited_for():
    begin = time.monotonic()
    with pytest.raises(KeyError), Beside(lambda: time.sleep(60.0), copied=True):
        raise KeyError
    assert time.monotonic() - begin < 30.0
    assert no_child_is_left()


def test_a_plan_is_the_same_with_a_second_process(tasks_folder):
    """And both have a bound."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    job = replace(job, tasks=job.tasks[:2])
    settings = PlanSettings(effort="quick")
    one, other = (planned(job, settings, beside=beside) for beside in (False, True))
    assert one.schedule.lower_bound is not None
    assert one.report == other.report
