"""Six-axis arms with closed forms for tests: of random axes in space, and of rows of Denavit and Hartenberg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.kinematics.general_arm import GeneralArm

KINDS = ("elbow", "elbow_meeting", "meeting", "parallel", "any")
"""Axes 2 and 3 parallel; and 1 and 2 meeting; axes 1 and 2 meeting; parallel; nothing of that."""
FAMILY = dict(zip(KINDS, ("elbow", "elbow", "two_steps", "two_steps", "quartic"), strict=True))


@dataclass(frozen=True)
class Built:
    """An arm and the pinocchio model that it was measured on."""

    model: pin.Model
    arm: GeneralArm

    def forward(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Flange poses by pinocchio: rotations (b, 3, 3), positions (b, 3)."""
        data, frame = self.model.createData(), self.model.getFrameId("flange")
        R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
        for k, row in enumerate(q):
            pin.framesForwardKinematics(self.model, data, row)
            R[k], p[k] = data.oMf[frame].rotation, data.oMf[frame].translation
        return R, p


def unit(rng: np.random.Generator) -> np.ndarray:
    """A random direction."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_arm(kind: str, rng: np.random.Generator, orthogonal: bool = False) -> Built:
    """Axes of a kind anywhere in space, joint frames turned anyhow, origins anywhere along their axes.

    Args:
        kind: one of KINDS.
        rng: where it comes from.
        orthogonal: whether neighbouring wrist axes are at right angles.
    """
    axes = np.array([unit(rng) for _ in range(6)])
    points = rng.uniform(-0.6, 0.6, (6, 3))
    points[3:] = points[3]
    if kind in ("elbow", "elbow_meeting"):
        axes[2] = axes[1] * rng.choice([-1.0, 1.0])
    if kind in ("elbow_meeting", "meeting"):
        points[1] = points[0]
    if kind == "parallel":
        axes[1] = axes[0] * rng.choice([-1.0, 1.0])
    if orthogonal:
        for k in (4, 5):
            axes[k] -= axes[k] @ axes[k - 1] * axes[k - 1]
            axes[k] /= np.linalg.norm(axes[k])
    points = points + rng.uniform(-0.3, 0.3, (6, 1)) * axes
    return build(axes, points, _pose(rng), rng)


def random_parallel_arm(rng: np.random.Generator, meeting: bool, orthogonal: bool) -> Built:
    """Axes 2, 3 and 4 parallel, pointing either way, all else anywhere in space.

    Args:
        rng: where it comes from.
        meeting: whether axes 5 and 6 meet.
        orthogonal: whether axes 1 and 2, 4 and 5, 5 and 6 are at right angles.
    """
    axes = np.array([unit(rng) for _ in range(6)])
    points = rng.uniform(-0.6, 0.6, (6, 3))
    for k in (2, 3):
        axes[k] = axes[1] * rng.choice([-1.0, 1.0])
    if orthogonal:
        for k, other in ((0, 1), (4, 3), (5, 4)):
            axes[k] -= axes[k] @ axes[other] * axes[other]
            axes[k] /= np.linalg.norm(axes[k])
    if meeting:
        points[5] = points[4]
    points = points + rng.uniform(-0.3, 0.3, (6, 1)) * axes
    return build(axes, points, _pose(rng), rng)


def _pose(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.uniform(0, 3) * unit(rng)), rng.uniform(-0.3, 0.3, 3))


def build(
    axes: np.ndarray, points: np.ndarray, flange: pin.SE3, rng: np.random.Generator | None = None
) -> Built:
    """An arm with these axes (6, 3) through points (6, 3) and flange at q = 0; limits of one turn, 0 in the middle."""
    model, parent, at = pin.Model(), 0, pin.SE3.Identity()
    for k, (axis, point) in enumerate(zip(axes, points, strict=True)):
        R = np.eye(3) if rng is None else pin.exp3(rng.uniform(0, 3) * unit(rng))
        here = pin.SE3(R, np.array(point))
        joint = pin.JointModelRevoluteUnaligned(*(R.T @ axis))
        parent = model.addJoint(parent, joint, at.inverse() * here, f"j{k + 1}")
        at = here
    model.addFrame(pin.Frame("flange", parent, at.inverse() * flange, pin.FrameType.OP_FRAME))
    joints = [f"j{k + 1}" for k in range(6)]
    limits = np.full(6, -np.pi), np.full(6, np.pi)
    return Built(model, GeneralArm.from_model(model, joints, "flange", pin.SE3.Identity(), limits))


def dh_pose(rows: np.ndarray, q: np.ndarray) -> pin.SE3:
    """The product of Rz(q) Tz(d) Tx(a) Rx(alpha) over rows (a, alpha, d)."""
    T = pin.SE3.Identity()
    for (a, alpha, d), angle in zip(rows, q, strict=True):
        T = T * pin.SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.array([0.0, 0.0, d]))
        T = T * pin.SE3(pin.exp3(np.array([alpha, 0.0, 0.0])), np.array([a, 0.0, 0.0]))
    return T


def dh_arm(rows: np.ndarray) -> Built:
    """The arm of rows (a, alpha, d)."""
    T = [dh_pose(rows[:k], np.zeros(k)) for k in range(7)]
    axes = np.array([t.rotation[:, 2] for t in T[:6]])
    return build(axes, np.array([t.translation for t in T[:6]]), T[6])


HEAVY = np.column_stack(
    [
        [0.35, 1.2, 0.0, 0.0, 0.0, 0.0],
        np.radians([-90.0, 0.0, -90.0, 90.0, -90.0, 0.0]),
        [0.335, 0.0, 0.0, 1.05, 0.0, 0.0],
    ]
)
"""Rows of an industrial arm: links of 1.2 and 1.05 m, the shoulder 0.35 m in front of axis 1 and 0.335 m high."""
UR5 = np.column_stack(
    [
        [0.0, -0.425, -0.39225, 0.0, 0.0, 0.0],
        np.radians([90.0, 0.0, 0.0, 90.0, -90.0, 0.0]),
        [0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823],
    ]
)
"""Rows of the UR5 as its maker publishes them."""
