"""One arm's stops in arrays, and the flange poses of many candidates at once."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.platform_chain import PlatformChain, rotation_z
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem


@dataclass(frozen=True)
class StopTable:
    """The stops of one arm, a row per stage and per alternative configuration of it."""

    first: IntArray
    """Row of each stage's first alternative, shape (n,); idle stages have some row of no meaning."""
    active: BoolArray
    """Which stages the arm has something to do in, shape (n,)."""
    R: FloatArray
    """Tool rotations, in the world or (configurations) in the carried frame, shape (m, 3, 3)."""
    p: FloatArray
    """Tool positions likewise [m], shape (m, 3)."""
    carried: BoolArray
    """Which rows are configurations, and so move with the platform, shape (m,)."""
    configuration: FloatArray
    """Their joints [rad], shape (m, joints); zeros elsewhere."""
    approach: FloatArray
    """Length of each stage's approach [m], shape (n,)."""
    retract: FloatArray
    """Length of each stage's retract [m], shape (n,)."""
    dwell: FloatArray
    """How long the tool stands still in each stage [s], shape (n,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("R", "p", "configuration", "approach", "retract", "dwell"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, arm: ArmWork) -> StopTable:
        """Returns an arm's stops in arrays."""
        first: list[int] = []
        R: list[FloatArray] = []
        p: list[FloatArray] = []
        carried: list[bool] = []
        configuration: list[FloatArray] = []
        for stop in arm.stops:
            first.append(len(R))
            if stop is None:
                continue
            if stop.configurations is None:
                R.append(stop.R_world_tool)
                p.append(stop.p_world_tool)
                carried.append(False)
                configuration.append(np.zeros(arm.joints))
                continue
            R_flange, p_flange = arm.kinematics.forward(stop.configurations)
            R_tool = product(R_flange, arm.R_tool_flange.T)
            R.extend(R_tool)
            p.extend(p_flange - product(R_tool, arm.p_tool_flange))
            carried.extend([True] * len(stop.configurations))
            configuration.extend(stop.configurations)
        if not R:
            # An arm without any stop: one row of no meaning, so that idle stages have some.
            R, p, carried, configuration = (
                [np.eye(3)],
                [np.zeros(3)],
                [False],
                [np.zeros(arm.joints)],
            )
        return cls(
            np.minimum(np.array(first, dtype=np.int64), len(R) - 1),
            np.array([stop is not None for stop in arm.stops]),
            np.array(R).reshape(-1, 3, 3),
            np.array(p).reshape(-1, 3),
            np.array(carried, dtype=np.bool_),
            np.array(configuration).reshape(-1, arm.joints),
            *(
                np.array([0.0 if stop is None else getattr(stop, name) for stop in arm.stops])
                for name in ("approach", "retract", "dwell")
            ),
        )


def flange_poses(
    platform: PlatformChain,
    arm: ArmWork,
    table: StopTable,
    row: IntArray,
    yaw: FloatArray,
    position: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns flange rotations and positions at targets in the carried frame, and tool directions there.

    Args:
        platform: the chain that carries the arm.
        arm: which arm.
        table: its stops.
        row: rows of the table, shape (...).
        yaw: turns about the tool's z axis [rad], shape (...).
        position: platform joints, shape (..., k).

    Returns:
        Rotations (..., 3, 3), positions (..., 3) [m], the tool's z axes (..., 3).
    """
    R_world, p_world = platform.pose(position)
    R_inverse = np.swapaxes(R_world, -1, -2)
    carried = table.carried[row]
    if carried.any():
        R_inverse = np.where(carried[..., None, None], np.eye(3), R_inverse)
        p_world = np.where(carried[..., None], 0.0, p_world)
    R_tool = product(R_inverse, table.R[row], rotation_z(yaw))
    p_tool = product(R_inverse, (table.p[row] - p_world)[..., None])[..., 0]
    return (
        product(R_tool, arm.R_tool_flange),
        p_tool + product(R_tool, arm.p_tool_flange),
        R_tool[..., :, 2],
    )


def platform_positions(problem: SequenceProblem, angle: FloatArray) -> FloatArray:
    """Returns platform joints, shape (..., k), for platform angles (...) [rad]."""
    if problem.turns:
        return angle[..., None]
    held = problem.platform_start
    return np.broadcast_to(held, (*angle.shape, len(held)))
