"""Both arms and what carries them as one vector of joints: tools, elbows and their Jacobians."""

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
    """Where the tools and elbows of a arms are at one configuration of n joints, in the world."""

    S: FloatArray
    """Screws of the joints: velocity at the world's origin, then angular velocity, per rad/s, shape (n, 6)."""
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
    """The kinematics of a cell's robot with its tools; configurations are in the order of the robot's joints."""

    def __init__(self, cell: Cell) -> None:
        """Builds the model.

        Args:
            cell: robot, base and tools.
        """
        robot = cell.robot
        self._coordinates = JointCoordinates(robot)
        model = self._coordinates.model
        # With the base in the model all that pinocchio computes is in the world.
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
        """Which joints slide, shape (n,)."""
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
        """Which joints move which tool, shape (a, n)."""
        self.moves_elbow: BoolArray = np.zeros_like(self.moves)
        """Which joints move which elbow, shape (a, n)."""
        for a, (tool, elbow) in enumerate(zip(self._tools, self._elbows, strict=True)):
            self.moves[a, [order[k - 1] for k in supports[tool[0]]]] = True
            # The elbow lies on its own joint's axis, so that joint does not move it.
            self.moves_elbow[a, [order[k - 1] for k in supports[elbow] - {elbow}]] = True
        self.before: BoolArray = np.zeros((n, n), dtype=np.bool_)
        """Whether joint i carries joint j, shape (n, n)."""
        for k in range(1, model.njoints):
            self.before[[order[i - 1] for i in supports[k] - {k}], order[k - 1]] = True
        self.moves_carried: BoolArray = np.zeros(n, dtype=np.bool_)
        """Which joints move the frame that carries both arms, shape (n,)."""
        self.moves_carried[[order[k - 1] for k in supports[self._carrier]]] = True
        self._blocks = np.repeat(self.moves, 3, axis=0).astype(np.float64)

    def at(self, q: FloatArray) -> BodyState:
        """Returns tools and elbows at a configuration [rad], shape (n,)."""
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
        """Returns rotations (a, 3, 3) and positions (a, 3) [m] of the tools alone at a configuration (n,) [rad]."""
        data, a = self._data, len(self.arms)
        pin.forwardKinematics(self._model, data, self._coordinates.of(q))
        R, p = np.empty((a, 3, 3)), np.empty((a, 3))
        for k, (parent, R_tool, p_tool) in enumerate(self._tools):
            T = data.oMi[parent]
            R[k] = product(T.rotation, R_tool)
            p[k] = product(T.rotation, p_tool) + T.translation
        return R, p

    def elbow_jacobian(self, state: BodyState) -> FloatArray:
        """Returns the Jacobian of the elbows, shape (a, 3, n)."""
        v, w = state.S[:, :3].T, state.S[:, 3:].T
        found: FloatArray = (v - product(skew(state.elbow), w)) * self.moves_elbow[:, None, :]
        return found

    def carried_points(self, state: BodyState, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns points that platform or waist carries in the world (m, 3) [m] and their Jacobians (m, 3, n).

        Args:
            state: where the robot is.
            points: the points in the frame `carried`, shape (m, 3) [m].
        """
        places = product(points, state.carried.rotation.T) + state.carried.translation
        v, w = state.S[:, :3].T, state.S[:, 3:].T
        return places, (v - product(skew(places), w)) * self.moves_carried

    def shoulders(self) -> tuple[FloatArray, FloatArray]:
        """Returns each shoulder in the frame `carried` at zero [m], shape (a, 3), and upper arm lengths (a,) [m].

        The shoulder is where the second joint of the arm that turns is, the upper arm leads from there to the elbow.
        """
        self.at(np.zeros(len(self.joints)))
        data = self._data
        carried = data.oMi[self._carrier] if self._carrier else self._base
        places, lengths = np.empty((len(self.arms), 3)), np.empty(len(self.arms))
        for a, (elbow, moved) in enumerate(zip(self._elbows, self.moves, strict=True)):
            own = np.flatnonzero(moved & ~self.moves_carried & ~self.slides)
            second = sorted(self._model.getJointId(self.joints[j]) for j in own)[1]
            places[a] = carried.actInv(data.oMi[second].translation)
            lengths[a] = norm(data.oMi[elbow].translation - data.oMi[second].translation)
        return places, lengths


def elbow_joint(count: int) -> int:
    """Returns which joint of an arm of so many joints that turn is its elbow, from 0."""
    return 3 if count >= 7 else 2


def tool_drift(
    S: FloatArray, p: FloatArray, moves: BoolArray, before: BoolArray, qd: FloatArray
) -> FloatArray:
    """Returns the tools' accelerations that the joints' velocities alone cause, dJ/dt qd, shape (6 a,).

    Args:
        S: screws, shape (n, 6).
        p: tool centre points [m], shape (a, 3).
        moves: which joints move which tool, shape (a, n).
        before: whether joint i carries joint j, shape (n, n).
        qd: joint velocities [rad/s], shape (n,).
    """
    Sd = screw_rates(S, before, qd)
    V = product(moves * qd, S)
    A = product(moves * qd, Sd)
    v, w, a, alpha = V[:, :3], V[:, 3:], A[:, :3], A[:, 3:]
    # The point moves: d/dt (v + w x p) = a + alpha x p + w x (v + w x p).
    found = np.empty((len(p), 6))
    found[:, :3] = a + cross(alpha, p) + cross(w, v + cross(w, p))
    found[:, 3:] = alpha
    return found.ravel()


def screw_rates(S: FloatArray, before: BoolArray, qd: FloatArray) -> FloatArray:
    """Returns dS/dt, shape (n, 6): a screw is carried by the joints before it, dS_j/dt = [V_j, S_j].

    Args:
        S: screws, shape (n, 6).
        before: whether joint i carries joint j, shape (n, n).
        qd: joint velocities [rad/s], shape (n,).
    """
    return bracket(product(before.T * qd, S), S)


def bracket(one: FloatArray, other: FloatArray) -> FloatArray:
    """Returns the Lie brackets of screws (..., 6): [w1 x v2 + v1 x w2, w1 x w2]."""
    v1, w1, v2, w2 = one[..., :3], one[..., 3:], other[..., :3], other[..., 3:]
    return np.concatenate([cross(w1, v2) + cross(v1, w2), cross(w1, w2)], axis=-1)


def cobracket(one: FloatArray, other: FloatArray) -> FloatArray:
    """Returns ad(one)^T other, shape (..., 6), for covectors other: y . (ad(one)^T other) = other . [one, y].

    With other = (f, m), paired with (v, w): (f x w1, f x v1 + m x w1).
    """
    v1, w1, f, m = one[..., :3], one[..., 3:], other[..., :3], other[..., 3:]
    return np.concatenate([cross(f, w1), cross(f, v1) + cross(m, w1)], axis=-1)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the cross products of vectors (..., 3); numpy's own is several times slower for few of them."""
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    found[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    found[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    found[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found


@dataclass(frozen=True)
class WholeBodySettings:
    """Numbers of steps of the whole body."""

    rounds: int = 200
    """Maximum number of Gauss-Newton steps."""
    longest: float = 0.3
    """Longest error that one round removes [m, rad]."""
    exact: float = 1e-11
    """Error that counts as none [m, rad]."""
    damping: float = 1e-3
    """Damping of the steps while the error is large, in units of the Jacobian squared."""
    kept_free: float = 1e-3
    """Distance from the joints' limits that is kept [rad]."""


WHOLE_BODY = WholeBodySettings()


@dataclass(frozen=True)
class Reached:
    """Joints, and by how much their tools miss."""

    q: FloatArray
    """All joints [rad], shape (n,)."""
    distance: float
    """How far the tools are from where they should be [m]; 0 where they are there."""
    angle: float
    """By how much they are turned away [rad]."""

    @property
    def exact(self) -> bool:
        """Whether the tools are where they should be."""
        return self.distance == 0.0 and self.angle == 0.0


def reach(
    body: WholeBody,
    limits: JointLimits,
    q: FloatArray,
    follows: BoolArray,
    R: FloatArray,
    p: FloatArray,
) -> Reached:
    """Returns joints within limits whose tools are at given poses, near given joints, or as near as they get.

    Damped Gauss-Newton (Levenberg-Marquardt) with steps of least norm; joints of arms that are not asked for stay.

    Args:
        body: kinematics.
        limits: of its n joints.
        q: where to begin [rad], shape (n,).
        follows: which arms' tools have to be somewhere, shape (a,).
        R: rotations of their tools, shape (b, 3, 3).
        p: their tool centre points [m], shape (b, 3).
    """
    rows, free = np.repeat(follows, 6), body.moves[follows].any(axis=0)
    room = np.minimum(WHOLE_BODY.kept_free, (limits.upper - limits.lower) / 4.0)
    lower, upper = limits.lower + room, limits.upper - room
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
