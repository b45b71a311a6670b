"""Candidate postures of one arm at its stops, with joints and line times."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.rotations import outward
from dualarm_cli.kinematics.platform_chain import PlatformChain, rotation_z
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, SequenceProblem
from dualarm_cli.timing.line_profile import joint_line_durations

LINE_SAMPLES = 7
"""Samples of a line."""
MIDDLE = LINE_SAMPLES - 1
"""Index of the target among the samples of approach and retract."""
BETWEEN = (2, 4, LINE_SAMPLES + 1, LINE_SAMPLES + 3)
"""Samples of both lines, approach first, that are kept for clearance.

The target is between the middle ones.
"""


@dataclass(frozen=True)
class CandidatePostures:
    """Candidate postures of one arm with joints and line times."""

    q_approach: FloatArray
    """Joints where the approach starts [rad], shape (n, joints)."""
    q_target: FloatArray
    """Joints at the target [rad], shape (n, joints)."""
    q_retract: FloatArray
    """Joints where the retract ends [rad], shape (n, joints)."""
    work: FloatArray
    """Time of approach, dwell and retract [s]; infinite where the candidate cannot be, shape (n,)."""
    approach: FloatArray
    """Rest-to-rest joint times on the approach [s], shape (n, joints).

    The largest is the time of the approach.
    """
    retract: FloatArray
    """Rest-to-rest time of each joint on the retract [s], shape (n, joints)."""
    q_between: FloatArray
    """Joints at two places on each line, approach first [rad], shape (n, 4, joints)."""
    shares: FloatArray
    """Durations of approach and retract over rest-to-rest times, shape (n, 2)."""
    rates: FloatArray
    """Velocities and accelerations at the outer ends of lines, shape (n, 2, 2, joints).

    The approach begins with the first and the retract ends with the second; 0 at rest."""

    @property
    def possible(self) -> BoolArray:
        """Flags of candidates within reach and limits on both lines, shape (n,)."""
        return np.isfinite(self.work)

    def where(self, mask: BoolArray, single: CandidatePostures) -> CandidatePostures:
        """Select between these candidates and single-plan ones by a mask (stages, plans)."""
        parts = {}
        for field in fields(self):
            mine, theirs = getattr(self, field.name), getattr(single, field.name)[:, None]
            wide = mask.reshape(*mask.shape, *(1,) * (mine.ndim - 2))
            parts[field.name] = np.where(wide, mine, theirs)
        return CandidatePostures(**parts)

    def take(self, rows: IntArray) -> CandidatePostures:
        """Select rows."""
        return CandidatePostures(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True)
class Grid:
    """Resolution of the nodes of a stop."""

    angles: FloatArray
    """Platform angles [rad], shape (f,); one where it cannot be turned."""
    arm_angles: int
    """Number of arm angles around the circle."""
    most: int
    """Most nodes of one stop; more are thinned out."""


@dataclass(frozen=True)
class Nodes:
    """The n nodes of one arm at one stop."""

    angle_index: IntArray
    """Index of the platform angle within the grid's, shape (n,)."""
    decisions: ArmDecisions
    """Decisions of each node; `near` has its joints at the target."""
    q_approach: FloatArray
    """Joints where the approach starts [rad], shape (n, joints)."""
    q_retract: FloatArray
    """Joints where the retract ends [rad], shape (n, joints)."""
    work: FloatArray
    """About how long approach, dwell and retract take [s], shape (n,)."""
    free_last: bool
    """Whether the last joint is free: any yaw will do, and it turns that joint alone."""

    @property
    def q_target(self) -> FloatArray:
        """Joints at the target [rad], shape (n, joints)."""
        return self.decisions.near

    def take(self, rows: IntArray) -> Nodes:
        """Select nodes."""
        return Nodes(
            self.angle_index[rows],
            self.decisions.take(rows),
            self.q_approach[rows],
            self.q_retract[rows],
            self.work[rows],
            self.free_last,
        )


def thinned(nodes: Nodes, most: int) -> Nodes:
    """Select a limited number of nodes, spread evenly over platform angles and line times."""
    n = len(nodes.work)
    if n <= most:
        return nodes
    order = np.lexsort((nodes.work, nodes.angle_index))
    return nodes.take(np.sort(order[np.linspace(0, n - 1, most).astype(np.int64)]))


def timed_postures(
    work: ArmWork, q: FloatArray, ok: BoolArray, bulge: FloatArray, dwell: FloatArray
) -> CandidatePostures:
    """Check candidates with traced lines against joint limits and time them in closed form.

    Args:
        work: their arm.
        q: joints at the samples of both lines [rad], shape (n, 2 LINE_SAMPLES - 1, joints); at the target alone, shape
            (n, 1, joints), where there are no lines.
        ok: which of them are within reach, shape (n,).
        bulge: how far joints may be beyond the samples [rad], broadcast against q.
        dwell: at the targets [s], shape (n,).
    """
    n, samples, joints = q.shape
    lines = samples > 1
    middle = MIDDLE if lines else 0
    ok = ok & work.kinematics.within_limits((q - bulge).min(axis=1))
    ok &= work.kinematics.within_limits((q + bulge).max(axis=1))
    spent = np.zeros((2, n, joints))
    if lines and ok.any():
        possible = q[ok]
        both = np.concatenate([possible[:, : middle + 1], possible[:, middle:]])
        spent[:, ok] = joint_line_durations(both, work.limits).reshape(2, -1, joints)
    time = np.where(ok, dwell + spent.max(axis=2).sum(axis=0), np.inf)
    between = q[:, np.array(BETWEEN) if lines else [0, 0, 0, 0]]
    ends = q[:, 0], q[:, middle], q[:, -1]
    rest = np.ones((n, 2)), np.zeros((n, 2, 2, joints))
    return CandidatePostures(*ends, time, spent[0], spent[1], between, *rest)


def bulges(steps: FloatArray) -> FloatArray:
    """Bound joint deviations between neighbouring samples [rad], shape (n, samples, joints).

    A parabola through three samples is beyond the chord by an eighth of the second difference at most; a little more is
    kept. The two lines meet at the middle sample with a bend that means nothing.

    Args:
        steps: from sample to sample of both lines [rad], shape (n, samples - 1, joints).
    """
    second = np.abs(np.diff(steps, axis=1))
    second[:, MIDDLE - 1] = 0.0
    widest = np.zeros((len(steps), steps.shape[1] + 1, steps.shape[2]))
    for first in range(3):
        around = widest[:, first : first + second.shape[1]]
        np.maximum(around, second, out=around)
    return 0.14 * widest


def flange_poses(
    platform: PlatformChain,
    arm: ArmWork,
    row: IntArray,
    yaw: FloatArray,
    position: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute flange poses at targets in the carried frame, and directions of lines there.

    Args:
        platform: the chain that carries the arm.
        arm: which arm.
        row: rows of its table of stops, shape (...).
        yaw: turns about the tool's z axis [rad], shape (...).
        position: platform joints, shape (..., k).

    Returns:
        Rotations (..., 3, 3), positions (..., 3) [m], directions outward (..., 2, 3).
    """
    R_world, p_world = platform.pose(position)
    R_inverse = np.swapaxes(R_world, -1, -2)
    table = arm.stop_table
    carried = table.carried[row]
    if carried.any():
        R_inverse = np.where(carried[..., None, None], np.eye(3), R_inverse)
        p_world = np.where(carried[..., None], 0.0, p_world)
    R_tool = product(R_inverse, table.R[row], rotation_z(yaw))
    p_tool = product(R_inverse, (table.p[row] - p_world)[..., None])[..., 0]
    return (
        product(R_tool, arm.R_tool_flange),
        p_tool + product(R_tool, arm.p_tool_flange),
        outward(table.directions[row], R_tool, R_inverse),
    )


def line_ends(p: FloatArray, away: FloatArray, length: FloatArray) -> FloatArray:
    """Compute flange positions at target, approach and retract [m], shape (n, 3, 3).

    Args:
        p: flange positions at the targets [m], shape (n, 3).
        away: directions of the lines outward, shape (n, 2, 3).
        length: lengths of the lines [m], shape (2,) or (n, 2).
    """
    target = p[:, None, :]
    return np.concatenate([target, target + away * length[..., None]], axis=1)


def platform_positions(problem: SequenceProblem, angle: FloatArray) -> FloatArray:
    """Convert platform angles (...) [rad] to platform joints, shape (..., k)."""
    if problem.turns:
        return angle[..., None]
    held = problem.platform_start
    return np.broadcast_to(held, (*angle.shape, len(held)))
