"""What the types' constructors see to."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli import model
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.place import Place
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.verification import Check, Verification


def limits(joints=("a", "b"), **change):
    """Limits of two joints."""
    n = len(joints)
    fields = {
        "lower": np.full(n, -1.0),
        "upper": np.full(n, 1.0),
        "velocity": np.ones(n),
        "acceleration": np.ones(n),
        "jerk": np.full(n, np.inf),
    }
    return JointLimits(joints=joints, source=("assumed",) * n, **(fields | change))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lower": np.array([2.0, 0.0])}, "above its upper"),
        ({"velocity": np.zeros(2)}, "velocity limits must be positive"),
        ({"acceleration": np.array([1.0, np.nan])}, "acceleration limits must be 2 numbers"),
        ({"jerk": np.ones(3)}, "jerk limits must be 2 numbers"),
    ],
)
def test_limits_that_no_motion_meets_are_refused(change, words):
    """Zero, NaN, swapped, wrong length."""
    with pytest.raises(ValueError, match=words):
        limits(**change)


def test_scaled_limits_are_a_slower_film():
    """At half speed: velocity / 2, acceleration / 4, jerk / 8."""
    half = limits(jerk=np.array([8.0, 16.0])).scaled(0.5)
    assert half.velocity.tolist() == [0.5, 0.5]
    assert half.acceleration.tolist() == [0.25, 0.25]
    assert half.jerk.tolist() == [1.0, 2.0]


def test_a_joint_belongs_to_one_group():
    """Platform and arms share no joint and leave none over."""
    arm = Arm("left", ("a",), "flange", "srs")
    Robot("good", "", ("b",), (arm,), limits())
    with pytest.raises(ValueError, match="exactly one"):
        Robot("joint b is nobody's", "", (), (arm,), limits())
    with pytest.raises(ValueError, match="exactly one"):
        Robot("joint a is twice", "", ("a", "b"), (arm,), limits())


def test_home_is_always_there():
    """All joints at zero where the file names no home."""
    robot = Robot("r", "", ("b",), (Arm("left", ("a",), "flange", "srs"),), limits())
    assert robot.postures["home"].tolist() == [0.0, 0.0]


def test_a_trajectory_between_knots_is_the_integral_of_its_jerk():
    """Jerk 1, q = t³/6 + t, from a = 0, v = 1; at t = 0.5 it is 0.520833..., v = 1.125, a = 0.5."""
    one = Trajectory(
        ("a",),
        np.array([0.0, 1.0]),
        np.array([[0.0], [1.0 + 1.0 / 6.0]]),
        np.array([[1.0], [1.5]]),
        np.array([[0.0], [1.0]]),
    )
    q, v, a = one.clamped(np.array([0.5, 1.0, 7.0]))
    assert q[:, 0] == pytest.approx([0.5 + 0.125 / 6, 1 + 1 / 6, 1 + 1 / 6], abs=1e-15)
    assert v[0, 0] == pytest.approx(1.125)
    assert a[0, 0] == pytest.approx(0.5)
    assert one.jerk.tolist() == [[1.0]]


def test_frozen_means_frozen():
    """Arrays of types cannot be written to."""
    with pytest.raises(ValueError, match="read-only"):
        limits().velocity[0] = 5.0


def test_a_trajectory_of_the_wrong_shape_is_refused():
    """Every row has a column per joint."""
    with pytest.raises(ValueError, match="velocity has shape"):
        Trajectory(("a",), np.zeros(2), np.zeros((2, 1)), np.zeros((2, 2)), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="at least one knot"):
        Trajectory(("a",), np.zeros(0), np.zeros((0, 1)), np.zeros((0, 1)), np.zeros((0, 1)))


def test_a_motion_that_begins_later_lasts_no_longer():
    """From 2 s to 5 s: three."""
    still = np.zeros((2, 1))
    motion = Trajectory(("a",), np.array([2.0, 5.0]), still, still, still)
    assert motion.duration == 3.0


def test_a_pose_without_freedoms_is_asked_for_as_it_is():
    """Stands of tools and hand-overs name none: half a turn about the tool's axis is another pose."""
    target = PoseTarget(pin.SE3.Identity())
    assert (target.free_yaw, target.symmetry) == (False, 1)


def test_an_arm_is_the_same_wherever_its_kind_is_written():
    """Two files may say the same."""
    arm = Arm("left", ("a",), "flange", "general")
    assert arm == dataclasses.replace(arm, place=Place("robot.yaml", 3, 5))
    assert arm != dataclasses.replace(arm, kind="srs")


SOMETHING = {
    "PoseTarget.symmetry": 1,
    "Grasp.symmetry": 1,
    "Task.not_after": np.inf,
    "Stop.straight": np.inf,
    "Job.speed": 1.0,
    "PathWork.tolerance": 1e-4,
    "PathWork.stiffness": 10.0,
    "Amount.factor": 1.0,
    "Care.speed": 1.0,
    "Care.acceleration": 1.0,
    "Care.tool_speed": np.inf,
    "Care.tilt": np.inf,
}
"""Numbers that are not 0 where they are left out."""


def test_numbers_that_are_left_out_are_none():
    """No mass, no clearance, no length, no wait, no turn, no freedom: all but a few of the data model's defaults.

    Settings of numerical methods are no statements about a cell.
    """
    found = {}
    for module in pkgutil.walk_packages(model.__path__, f"{model.__name__}."):
        for name, value in vars(importlib.import_module(module.name)).items():
            data = isinstance(value, type) and dataclasses.is_dataclass(value)
            if data and not name.endswith("Settings"):
                for field in dataclasses.fields(value):
                    if type(field.default) in (int, float, bool):
                        found[f"{name}.{field.name}"] = field.default
    assert {name: value for name, value in found.items() if value} == SOMETHING
    assert len(found) > 30


@pytest.mark.parametrize(
    ("verdicts", "passed", "failures"),
    [
        (("passed", "not checked"), True, 0),
        (("passed", "failed", "failed"), False, 2),
        (("not checked",), False, 0),
        ((), False, 0),
    ],
)
def test_what_passed_failed_nowhere_and_was_checked_somewhere(verdicts, passed, failures):
    checks = tuple(Check(f"c{k}", one, None, None, "", "") for k, one in enumerate(verdicts))
    found = Verification(checks)
    assert found.passed is passed
    assert found.failures == tuple(check for check in checks if check.verdict == "failed")
    assert len(found.failures) == failures
