"""The judgement as a whole: what is believed, what is not, and what it is built on."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
import warnings

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.model.cell import Tool
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.verification import verify

PATHS = ("distance", "angle", "progress", "speed", "time", "corners")
SEAMS = ("distance", "angle", "progress", "speed", "steady", "as_asked", "part", "downhand")
NAMES = (
    *(f"path_{name}" for name in PATHS),
    "paths_together",
    *(f"seam_{name}" for name in SEAMS),
    *(f"handover_{name}" for name in ("order", "grip", "still")),
)
"""Checks of paths, seams and hand-overs."""


def with_cell(job, **changes):
    """Returns the job in another cell."""
    return dataclasses.replace(job, cell=dataclasses.replace(job.cell, **changes))


def test_a_schedule_without_fault_passes_every_check(clean):
    """Made by hand, without the planner; collisions, cap, bound, rules, stores, tools, paths, seams are not checked."""
    verification = verify(clean.schedule, clean.job)
    assert verification.passed
    verdicts = {check.name: check.verdict for check in verification.checks}
    unchecked = {name for name, verdict in verdicts.items() if verdict != "passed"}
    open_orders = {"precedence", "windows", "buffers", "tool_changes"}
    assert unchecked == {
        "collisions",
        "tool_speed",
        "lower_bound",
        *open_orders,
        *NAMES,
        "torque",
    }
    assert len(verdicts) == len(verification.checks)
    assert all(check.detail for check in verification.checks)


def test_measurements_of_a_clean_schedule_are_rounding(clean):
    """Every length, angle and time is below 1e-13: the tools' poses come from trigonometry."""
    for check in verify(clean.schedule, clean.job).checks:
        if check.measured is not None and check.unit != "share of the limit":
            assert check.measured < 1e-13, check


def test_without_a_job_ten_checks_are_not_made_and_say_why(clean):
    """What only a task file can tell."""
    verification = verify(clean.schedule)
    assert verification.passed
    reasons = {
        check.name: check.detail for check in verification.checks if check.verdict == "not checked"
    }
    order = ("order", "tool_changes", "precedence", "windows", "buffers", "pairing")
    tasks = (
        "events_at_targets",
        "stands_at_events",
        *order,
        "dwells",
        "start_posture",
        "return",
        *NAMES,
    )
    assert {reasons[name] for name in tasks} == {"no task file was given (--tasks)"}
    assert set(reasons) == {*tasks, "collisions", "tool_speed", "lower_bound", "torque"}


def test_the_same_checks_in_the_same_order_with_and_without_a_job(clean):
    """A reader of many verifications finds every line at its place."""
    with_job, without = (verify(clean.schedule, job).checks for job in (clean.job, None))
    assert [check.name for check in with_job] == [check.name for check in without]


def test_a_schedule_that_states_another_tool_than_the_job_is_held_to_the_jobs(clean, failing):
    """Consistent in itself, 10 mm off in the cell: lines, dwells, events, all by the job's tool."""
    job = with_cell(
        clean.job,
        tools={
            arm: Tool(pin.SE3(np.eye(3), np.array([0.01, 0.0, 0.1]))) for arm in ("left", "right")
        },
    )
    assert failing(clean.schedule) == {}
    assert {"tool_position_at_events", "tool_still_in_dwells", "lines_straight"} <= set(
        failing(clean.schedule, job)
    )


def test_a_schedule_that_states_another_base_is_held_to_the_jobs(clean, failing):
    """The robot stands 1 mm higher in the cell than the schedule says."""
    base = clean.job.cell.base
    raised = pin.SE3(base.rotation, base.translation + np.array([0.0, 0.0, 1e-3]))
    found = failing(clean.schedule, with_cell(clean.job, base=raised))
    assert "tool_position_at_events" in found


def test_a_schedule_that_states_another_urdf_is_held_to_the_jobs(clean, failing):
    """The forearms of the cell's robot are 1 mm longer."""
    robot = clean.job.cell.robot
    urdf = robot.urdf.replace('xyz="0.4 0 0"', 'xyz="0.401 0 0"')
    assert urdf != robot.urdf
    job = with_cell(clean.job, robot=dataclasses.replace(robot, urdf=urdf))
    assert "tool_position_at_events" in failing(clean.schedule, job)


def test_a_job_for_another_robot_is_bad_input_that_names_joints(clean):
    """Nothing can be measured: exit 2."""
    trajectory = clean.schedule.trajectory
    joints = ("waist", *trajectory.joints[1:])
    schedule = dataclasses.replace(
        clean.schedule, motion=JointMotion.of(dataclasses.replace(trajectory, joints=joints))
    )
    with pytest.raises(InputError, match="different robots: turn, waist"):
        verify(schedule, clean.job)


@pytest.mark.parametrize("seed", range(12))
def test_garbage_of_finite_numbers_is_judged_and_never_passes(clean, moved, seed):
    """Random numbers of every size in the trajectory: findings, no crash, no NaN among the results."""
    rng = np.random.default_rng(seed)
    shape = clean.schedule.trajectory.position.shape
    size = 10.0 ** rng.integers(-3, 300)
    arrays = {
        name: rng.normal(size=shape) * size for name in ("position", "velocity", "acceleration")
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        verification = verify(moved(clean.schedule, **arrays), clean.job)
    assert {"position_agreement", "velocity_agreement", "return"} <= {
        check.name for check in verification.failures
    }
    assert all(c.measured is None or np.isfinite(c.measured) for c in verification.checks)


def test_the_verifier_loads_no_solver(clean, tmp_path):
    """A solver's fault cannot hide in its judge: of the planner it shares readers, model, pinocchio and coal."""
    path = tmp_path / "case.pickle"
    path.write_bytes(pickle.dumps((clean.schedule, clean.job)))
    code = (
        "import pathlib, pickle, sys; from dualarm_cli.verification import verify; "
        f"schedule, job = pickle.loads(pathlib.Path({str(path)!r}).read_bytes()); "
        "assert verify(schedule, job, clearance=True).passed; "
        "print(*sorted(m for m in sys.modules if not m.startswith('_')))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = [name.split(".") for name in result.stdout.split()]
    assert not {"ruckig", "toppra", "piqp", "ortools", "scipy"} & {m[0] for m in loaded}
    rooms = {m[1] for m in loaded if m[0] == "dualarm_cli" and len(m) > 1}
    assert rooms <= {
        *(
            "collision",
            "errors",
            "explanations",  # texts
            "geometry",
            "kinds",
            "model",
            "notes",  # sentences and their values
            "native",  # for products of matrices
            "records",
            "refusals",
            "registry",
            "system",  # what only Linux has
            "verification",
        )
    }
    of_kinds = {m[3] for m in loaded if m[:2] == ["dualarm_cli", "kinds"] and len(m) > 3}
    assert of_kinds == {"checks"}
