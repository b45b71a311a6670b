"""Schedules made by hand: whole seconds, two arms of one joint, a platform that turns and stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import (
    Provenance,
    Schedule,
    ScheduleArm,
    ScheduleRobot,
    Segment,
    Stage,
)

JOINTS = ("turn", "left_a", "right_a")


def platform_knots(way: Sequence[tuple[float, float]]) -> Trajectory:
    """The platform at angles [rad] at times [s]: rest to rest by full braking half way, the arms still."""
    time, angle, speed, push = [], [], [], []

    def knot(t: float, q: float, v: float, a: float) -> None:
        time.append(t)
        angle.append(q)
        speed.append(v)
        push.append(a)

    for (t0, q0), (t1, q1) in pairwise(way):
        half, rate = (t1 - t0) / 2.0, 4.0 * (q1 - q0) / (t1 - t0) ** 2
        knot(t0, q0, 0.0, rate)
        knot(t0 + half, (q0 + q1) / 2.0, rate * half, rate)
        knot(t0 + half, (q0 + q1) / 2.0, rate * half, -rate)
        knot(t1, q1, 0.0, -rate)
    columns = [np.column_stack([row, np.zeros((len(time), 2))]) for row in (angle, speed, push)]
    return Trajectory(JOINTS, np.array(time), *columns)


@pytest.fixture(scope="session")
def by_hand() -> SimpleNamespace:
    """`row`: an arm's segments one after the other; `stage`; `schedule` of them."""

    def row(arm: str, *parts: tuple) -> list[Segment]:
        clock, found = 0.0, []
        for kind, task, length, *reason in parts:
            action = "move" if task else ""
            found.append(Segment(arm, kind, task, action, clock, clock + length, None, *reason))
            clock += length
        return found

    def stage(start: float, end: float, *tasks: str, platform: float = 0.0, **arms: float) -> Stage:
        return Stage(start, end, tasks, "", None, platform, arms, {}, "")

    def schedule(
        segments: Sequence[Segment],
        stages: Sequence[Stage] = (),
        way: Sequence[tuple[float, float]] = (),
        urdf: str = "<robot/>",
    ) -> Schedule:
        end = max(part.end for part in segments)
        robot = ScheduleRobot(
            "by hand",
            urdf,
            pin.SE3.Identity(),
            {
                "left": ScheduleArm("", pin.SE3.Identity(), ("left_a",)),
                "right": ScheduleArm("", pin.SE3.Identity(), ("right_a",)),
            },
            JointLimits(JOINTS, *(np.full(3, x) for x in (-9.0, 9.0, 9.0, 9.0, 9.0)), ("x",) * 3),
            ("turn",),
        )
        return Schedule(
            robot,
            JointMotion.of(platform_knots(way or [(0.0, 0.0), (end, 0.0)])),
            tuple(stages),
            tuple(segments),
            (),
            Provenance("1", {}, {}, 0),
        )

    made: dict[str, Callable] = {"row": row, "stage": stage, "schedule": schedule}
    return SimpleNamespace(**made)
