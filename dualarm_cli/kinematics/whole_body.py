"""Kinematics of platform and both arms as one vector of joints: tools and elbows."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.linear_systems import solve
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation, skew
from dualarm_cli.kinematics.dynamics import JointCoordinates
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class BodyState:
    """Tools and elbows of a arms in the world, at n joints."""

    S: FloatArray
    """Joint screws per rad/s: velocity at the world's origin, angular velocity, shape (n, 6)."""
    R: FloatArray
    """Rotations of the tools, shape (a, 3, 3)."""
    p: FloatArray
    """Tool centre points [m], shape (a, 3)."""
    J: FloatArray
    """Jacobian of all tools, linear part first, along the world's axes, shape (6 a, n)."""
    elbow: FloatArray
    """Elbows [m], shape (a, 3)."""
    carried: pin.SE3
    """Frame of the last joint of platform or waist, or of the root link without one."""


class WholeBody:
    """Kinematics of a cell's robot with its tools, in robot joint order."""

    def __init__(self, cell: Cell) -> None:
        """Build the model.

        Args:
            cell: robot, base and tools.
        """
        robot = cell.robot
        self._coordinates = JointCoordinates(robot)
        model = self._coordinates.model
        # With the base in the model every result of pinocchio is in the world.
        for k in range(1, model.njoints):
            if model.parents[k] == 0:
                model.jointPlacements[k] = cell.base * model.jointPlacements[k]
        self._tools = []
        for arm in robot.arms:
            flange = model.frames[model.getFrameId(arm.flange)]
            tcp = flange.placement * cell.tools[arm.name].tcp
            self._tools.append((flange.parentJoint, tcp.rotation.copy(), tcp.translation.copy()))
        self._elbows = [
            model.getJointId(joints[elbow_joint(len(joints))])
            for joints in ([j for j in arm.joints if j not in robot.sliding] for arm in robot.arms)
        ]
        self.slides: BoolArray = np.isin(robot.joints, list(robot.sliding))
        """Flags of sliding joints, shape (n,)."""
        self._carrier = model.getJointId(robot.platform[-1]) if robot.platform else 0
        self._base = cell.base
        self._model, self._data = model, model.createData()
        order = self._coordinates.order
        self.joints = robot.joints
        """Names of the n joints."""
        self.arms = tuple(arm.name for arm in robot.arms)
        """Names of the a arms."""
        supports = [set(model.supports[k]) - {0} for k in range(model.njoints)]
        n = len(robot.joints)
        self.moves: BoolArray = np.zeros((len(self.arms), n), dtype=np.bool_)
        """Flags of joints that move a tool, shape (a, n)."""
        self.moves_elbow: BoolArray = np.zeros_like(self.moves)
        """Flags of joints that move an elbow, shape (a, n)."""
        for a, (tool, elbow) in enumerate(zip(self._tools, self._elbows, strict=True)):
            self.moves[a, [order[k - 1] for k in supports[tool[0]]]] = True
            # The elbow lies on its own joint's axis, so that joint does not move it.
            self.moves_elbow[a, [order[k - 1] for k in supports[elbow] - {elbow}]] = True
        self.before: BoolArray = np.zeros((n, n), dtype=np.bool_)
        """Flags: joint i carries joint j, shape (n, n)."""
        for k in range(1, model.njoints):
            self.before[[order[i - 1] for i in supports[k] - {k}], order[k - 1]] = True
        self.moves_carried: BoolArray = np.zeros(n, dtype=np.bool_)
        """Flags of joints that move the frame that carries both arms, shape (n,)."""
        self.moves_carried[[order[k - 1] for k in supports[self._carrier]]] = True
        self._blocks = np.repeat(self.moves, 3, axis=0).astype(np.float64)

    def at(self, q: FloatArray) -> BodyState:
        """Compute tools and elbows at a configuration [rad], shape (n,)."""
        model, data, a = self._model, self._data, len(self.arms)
        pin.computeJointJacobians(model, data, self._coordinates.of(q))
        S = data.J.T[self._coordinates.back]
        R, p, elbow = np.empty((a, 3, 3)), np.empty((a, 3)), np.empty((a, 3))
        for k, ((parent, R_tool, p_tool), joint) in enumerate(
            zip(self._tools, self._elbows, strict=True)
        ):
            T = data.oMi[parent]
            R[k] = product(T.rotation, R_tool)
            p[k] = product(T.rotation, p_tool) + T.translation
            elbow[k] = data.oMi[joint].translation
        J = np.empty((a, 6, S.shape[0]))
        # A screw's velocity at p is its velocity at the origin plus omega x p.
        v, w = S[:, :3].T, S[:, 3:].T
        np.subtract(v, product(skew(p), w), out=J[:, :3])
        J[:, 3:] = w
        J *= self.moves[:, None, :]
        carried = data.oMi[self._carrier].copy() if self._carrier else self._base
        return BodyState(S, R, p, J.reshape(6 * a, -1), elbow, carried)

    def tools(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations (a, 3, 3) and positions (a, 3) [m] of the tools alone."""
        data, a = self._data, len(self.arms)
        pin.forwardKinematics(self._model, data, self._coordinates.of(q))
        R, p = np.empty((a, 3, 3)), np.empty((a, 3))
        for k, (parent, R_tool, p_tool) in enumerate(self._tools):
            T = data.oMi[parent]
            R[k] = product(T.rotation, R_tool)
            p[k] = product(T.rotation, p_tool) + T.translation
        return R, p

    def elbow_jacobian(self, state: BodyState) -> FloatArray:
        """Compute the Jacobian of the elbows, shape (a, 3, n)."""
        v, w = state.S[:, :3].T, state.S[:, 3:].T
        jacobian: FloatArray = (v - product(skew(state.elbow), w)) * self.moves_elbow[:, None, :]
        return jacobian

    def carried_points(self, state: BodyState, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute carried points (m, 3) [m] in the world, their Jacobians (m, 3, n).

        Args:
            state: state of the robot.
            points: the points in the frame `carried`, shape (m, 3) [m].
        """
        places = product(points, state.carried.rotation.T) + state.carried.translation
        v, w = state.S[:, :3].T, state.S[:, 3:].T
        return places, (v - product(skew(places), w)) * self.moves_carried

    def shoulders(self) -> tuple[FloatArray, FloatArray]:
        """Measure shoulders in the frame `carried` (a, 3) and upper arm lengths (a,) [m].

        The shoulder is the origin of the arm's second revolute joint; the upper arm ends at the elbow.
        """
        self.at(np.zeros(len(self.joints)))
        data = self._data
        carried = data.oMi[self._carrier] if self._carrier else self._base
        places, lengths = np.empty((len(self.arms), 3)), np.empty(len(self.arms))
        for a, (elbow, moved) in enumerate(zip(self._elbows, self.moves, strict=True)):
            arm_joints = np.flatnonzero(moved & ~self.moves_carried & ~self.slides)
            second = sorted(self._model.getJointId(self.joints[j]) for j in arm_joints)[1]
            places[a] = carried.actInv(data.oMi[second].translation)
            lengths[a] = norm(data.oMi[elbow].translation - data.oMi[second].translation)
        return places, lengths


def elbow_joint(count: int) -> int:
    """Return the number of the elbow, from 0, by the number of revolute joints."""
    return 3 if count >= 7 else 2


def tool_drift(
    S: FloatArray, p: FloatArray, moves: BoolArray, before: BoolArray, qd: FloatArray
) -> FloatArray:
    """Compute the tools' accelerations by joint velocities alone, dJ/dt qd, shape (6 a,).

    Args:
        S: screws, shape (n, 6).
        p: tool centre points [m], shape (a, 3).
        moves: flags of joints that move a tool, shape (a, n).
        before: flags: joint i carries joint j, shape (n, n).
        qd: joint velocities [rad/s], shape (n,).
    """
    Sd = screw_rates(S, before, qd)
    V = product(moves * qd, S)
    A = product(moves * qd, Sd)
    v, w, a, alpha = V[:, :3], V[:, 3:], A[:, :3], A[:, 3:]
    # The point moves: d/dt (v + w x p) = a + alpha x p + w x (v + w x p).
    accelerations = np.empty((len(p), 6))
    accelerations[:, :3] = a + cross(alpha, p) + cross(w, v + cross(w, p))
    accelerations[:, 3:] = alpha
    return accelerations.ravel()


def screw_rates(S: FloatArray, before: BoolArray, qd: FloatArray) -> FloatArray:
    """Compute rates of screws by the joints before, [V_j, S_j], shape (n, 6).

    Args:
        S: screws, shape (n, 6).
        before: flags: joint i carries joint j, shape (n, n).
        qd: joint velocities [rad/s], shape (n,).
    """
    return bracket(product(before.T * qd, S), S)


def bracket(first: FloatArray, second: FloatArray) -> FloatArray:
    """Compute the Lie brackets of screws (..., 6).

    They are [w1 x v2 + v1 x w2, w1 x w2].
    """
    v1, w1, v2, w2 = first[..., :3], first[..., 3:], second[..., :3], second[..., 3:]
    return np.concatenate([cross(w1, v2) + cross(v1, w2), cross(w1, w2)], axis=-1)


def cobracket(screw: FloatArray, covector: FloatArray) -> FloatArray:
    """Compute ad(screw)^T covector, shape (..., 6).

    It is defined by y . (ad(screw)^T covector) = covector . [screw, y]. With covector = (f, m), paired with (v, w):
    (f x w1, f x v1 + m x w1).
    """
    v1, w1, f, m = screw[..., :3], screw[..., 3:], covector[..., :3], covector[..., 3:]
    return np.concatenate([cross(f, w1), cross(f, v1) + cross(m, w1)], axis=-1)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Compute cross products of vectors (..., 3), for few vectors faster than numpy's."""
    products = np.empty(np.broadcast_shapes(a.shape, b.shape))
    products[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    products[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    products[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return products


@dataclass(frozen=True)
class WholeBodySettings:
    """Settings of the inverse kinematics of the whole body."""

    rounds: int = 200
    """Maximum number of Gauss-Newton steps."""
    longest: float = 0.3
    """Largest error that one step removes [m, rad]."""
    exact: float = 1e-11
    """Error that counts as zero [m, rad]."""
    damping: float = 1e-3
    """Damping of the steps while the error is large, in units of the Jacobian squared."""
    limit_margin: float = 1e-3
    """Margin from the joints' limits [rad]."""


WHOLE_BODY = WholeBodySettings()


@dataclass(frozen=True)
class Reached:
    """Joints with the miss of their tools."""

    q: FloatArray
    """All joints [rad], shape (n,)."""
    distance: float
    """Distance of the tools from their poses [m], 0 if reached."""
    angle: float
    """Angle of the tools from their poses [rad]."""

    @property
    def exact(self) -> bool:
        """Flag of tools that reach their poses."""
        return self.distance == 0.0 and self.angle == 0.0


def reach(
    body: WholeBody,
    limits: JointLimits,
    q: FloatArray,
    follows: BoolArray,
    R: FloatArray,
    p: FloatArray,
) -> Reached:
    """Solve for joints within limits whose tools reach poses, or come near them.

    Damped Gauss-Newton (Levenberg-Marquardt) with steps of least norm; joints of other arms stay.

    Args:
        body: kinematics.
        limits: limits of its n joints.
        q: initial joints [rad], shape (n,).
        follows: flags of arms whose tools have poses, shape (a,).
        R: rotations of the tools, shape (b, 3, 3).
        p: tool centre points [m], shape (b, 3).
    """
    rows, free = np.repeat(follows, 6), body.moves[follows].any(axis=0)
    margin = np.minimum(WHOLE_BODY.limit_margin, (limits.upper - limits.lower) / 4.0)
    lower, upper = limits.lower + margin, limits.upper - margin
    q = np.where(free, np.clip(q, lower, upper), q)
    which = np.flatnonzero(follows)
    best = Reached(q, np.inf, np.inf)
    for _ in range(WHOLE_BODY.rounds):
        state = body.at(q)
        turn = log_rotation(product(R, state.R[which].transpose(0, 2, 1)))
        error = np.concatenate([p - state.p[which], turn], axis=1).ravel()
        size = float(norm(error))
        if np.abs(error).max() < WHOLE_BODY.exact:
            return Reached(q, 0.0, 0.0)
        parts = norm(error.reshape(-1, 2, 3), axis=2).max(axis=0)
        if parts.sum() < best.distance + best.angle:
            best = Reached(q, float(parts[0]), float(parts[1]))
        # Joints at a limit that the step would cross are left out of it.
        active = free.copy()
        for _ in range(3):
            J = state.J[rows] * active
            damping = WHOLE_BODY.damping * min(1.0, size) * np.eye(len(J))
            step = product(
                J.T, solve(product(J, J.T) + damping, error * min(1.0, WHOLE_BODY.longest / size))
            )
            blocked = active & ((q + step < lower) | (q + step > upper))
            stuck = blocked & ((q <= lower) | (q >= upper))
            if not stuck.any():
                break
            active &= ~stuck
        q = np.where(free, np.clip(q + step, lower, upper), q)
    return best
