"""Search for the posture home of an imported robot, with tools down."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product as combinations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import MeasuredRobot
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import INVERSE, descend
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note, NoteTable, of_arm
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import random_postures, sampled_range, touches


@dataclass(frozen=True)
class HomeSettings:
    """Settings of the search for a posture home."""

    sampled: int = 20_000
    """Number of sampled postures that are compared."""
    inner: float = 0.7
    """Fraction of the joint ranges that is sampled, around their middle."""
    tried: int = 400
    """Maximum number of postures tested for collisions, best first."""
    few: int = 40
    """Number of postures of each arm that are combined with the other arm's."""
    room: float = 0.05
    """Minimum distance to a joint limit, as a fraction of the joint's range."""
    ahead: float = 0.45
    """Preferred distance of tools in front of the shoulder, as a fraction of the reach."""
    below: float = 0.35
    """Preferred depth of tools below the shoulder, as a fraction of the reach."""
    above: float = 0.25
    """Minimum preferred height of tools above the robot's root, as a fraction of the reach."""
    turned: float = 1.0
    """Weight of joints far from zero: root mean square of their positions, in half turns."""
    raised: float = 2.0
    """Weight of the height of elbows above shoulders, as a fraction of the reach."""
    upright: float = 0.9
    """Minimum cosine between the vertical and the first axis of an arm that stands."""
    down: float = 0.9962
    """Minimum cosine between a mirrored tool and the vertical: 5 degrees."""
    mirror: float = 0.01
    """Largest distance of mirrored axes [m] and largest sine of their angle [rad]."""


SETTINGS = HomeSettings()
_note = NoteTable(
    "home",
    not_down="no posture within the joint limits was found that turns the {tools:* or the } straight down",
    colliding="every posture tried with tools down collides",
)


def propose_home(robot: Robot, tcps: Mapping[str, pin.SE3], seed: int) -> FloatArray | Note:
    """Find a collision-free posture with tools down (joints,) [rad or m], or the reason for none.

    The platform is at 0 or nearest to it; if that collides, a sliding platform is tried in the middle and at the ends.

    Args:
        robot: with its allowed contacts.
        tcps: tool frame of each arm in its flange's, z along the tool.
        seed: of the random postures.
    """
    columns = robot.columns(robot.platform)
    lower, upper = robot.limits.lower[columns], robot.limits.upper[columns]
    places = [np.clip(0.0, lower, upper)]
    if robot.platform and robot.sliding.issuperset(robot.platform):
        places += [0.5 * (lower + upper), upper, lower]
    reason = _note("colliding")
    for place in places:
        home = _home_at(robot, tcps, seed, place)
        if not isinstance(home, Note):
            return home
        reason = home
    return reason


def _home_at(
    robot: Robot, tcps: Mapping[str, pin.SE3], seed: int, place: FloatArray
) -> FloatArray | Note:
    """Find a collision-free posture for a platform position (k,), or the reason for none."""
    measured = MeasuredRobot.of(robot, pin.SE3.Identity())
    middle = np.clip(0.0, robot.limits.lower, robot.limits.upper)
    middle[robot.columns(robot.platform)] = place
    R, p = measured.platform.pose(place)
    postures = random_postures(robot, SETTINGS.sampled, seed)
    centre = 0.5 * np.sum(sampled_range(robot), axis=0)
    # Around the middle of the ranges: postures in the outer half are seldom a useful start.
    postures = centre + SETTINGS.inner * (postures - centre)
    best: dict[str, FloatArray] = {}
    for arm in robot.arms:
        rating = Rating(robot, arm.name, measured.general(arm), pin.SE3(R, p), tcps[arm.name])
        q = postures[:, robot.columns(arm.joints)]
        q = q[np.argsort(-rating.scores(q), kind="stable")[: SETTINGS.tried]]
        q = rating.tools_down(q)
        best[arm.name] = q[np.argsort(-rating.scores(q), kind="stable")]
    lacking = [name for name, q in best.items() if not len(q)]
    if lacking:
        return _note("not_down", tools=[of_arm(name, "tool", len(best)) for name in lacking])

    def combined(chosen: Mapping[str, FloatArray]) -> FloatArray:
        """Combine postures of arms, all other joints in the middle, shape (n, joints)."""
        rows = np.tile(middle, (len(next(iter(chosen.values()))), 1))
        for name, q in chosen.items():
            rows[:, robot.columns(robot.arm(name).joints)] = q
        return rows

    signs = _mirror_signs(robot, middle)
    if signs is not None:
        columns = robot.columns(robot.arm("right").joints)
        right = best["left"] * signs
        within = (right >= robot.limits.lower[columns]) & (right <= robot.limits.upper[columns])
        # The tools mirror too, unless they are mounted otherwise.
        within[:, 0] &= rating.tools(right)[0][:, 2, 2] < -SETTINGS.down
        left, right = (q[within.all(axis=1)] for q in (best["left"], right))
        rows = combined({"left": left, "right": right})
        usable = np.flatnonzero(~touches(robot, rows, ["left", "right"]))
        if len(usable):
            return rows[usable[0]]
    free = {
        name: q[~touches(robot, combined({name: q}), [name])][: SETTINGS.few]
        for name, q in best.items()
    }
    if not all(map(len, free.values())):
        return _note("colliding")
    # Combinations of both arms' best postures come first.
    pairs = sorted(combinations(*(range(len(q)) for q in free.values())), key=sum)
    numbers = np.array(pairs[: SETTINGS.tried])
    rows = combined({name: q[numbers[:, k]] for k, (name, q) in enumerate(free.items())})
    usable = np.flatnonzero(~touches(robot, rows, list(free)))
    return rows[usable[0]] if len(usable) else _note("colliding")


@dataclass(frozen=True)
class Rating:
    """Rating of an arm's postures as its part of home."""

    robot: Robot
    name: str
    numeric: GeneralArm
    T_world_carried: pin.SE3
    T_flange_tcp: pin.SE3

    def tools(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute tool poses in the world, shapes (n, 3, 3) and (n, 3) [m]."""
        R, p = self.numeric.forward(q)
        p = product(R, self.T_flange_tcp.translation) + p
        R_world = self.T_world_carried.rotation
        R = product(product(R_world, R), self.T_flange_tcp.rotation)
        return R, product(p, R_world.T) + self.T_world_carried.translation

    def room(self, q: FloatArray) -> FloatArray:
        """Compute the least distance to a joint limit, as a fraction of its range, shape (n,)."""
        columns = self.robot.columns(self.robot.arm(self.name).joints)
        lower, upper = (side[columns] for side in sampled_range(self.robot))
        share = np.abs(q - 0.5 * (lower + upper)) / np.maximum(upper - lower, 1e-9)
        return np.asarray(0.5 - share.max(axis=1))

    def scores(self, q: FloatArray) -> FloatArray:
        """Rate postures of shape (n, axes) as home, shape (n,)."""
        arm = self.numeric
        R, p = self.tools(q)
        first, second = arm.p_parent_joint[:2]
        shoulder = self.T_world_carried.act(first + product(arm.R_parent_joint[0], second))
        reach = arm.reach
        height = max(shoulder[2] - SETTINGS.below * reach, SETTINGS.above * reach)
        aim = np.array([shoulder[0] + SETTINGS.ahead * reach, shoulder[1], height])
        singular = singular_values(arm.linearised(q)[2])[:, -1]
        return np.asarray(
            2.0 * self.room(q)
            - R[:, 2, 2]
            - 2.0 * norm(p - aim, axis=1) / reach
            + 2.0 * np.minimum(singular, 0.2)
            - SETTINGS.turned * np.sqrt(np.mean(np.square(q / np.pi), axis=1))
            - SETTINGS.raised * self.raised(q, shoulder[2]) / reach
        )

    def raised(self, q: FloatArray, shoulder: float) -> FloatArray:
        """Compute the height of the highest joint above the shoulder [m], shape (n,).

        It is 0 for arms whose first axis is vertical: they stand on what they work on, with the elbow up.
        """
        up = self.T_world_carried.rotation[2]
        if abs(float(product(up, self.numeric.R_parent_joint[0][:, 2]))) > SETTINGS.upright:
            return np.zeros(len(q))
        heights = product(self.numeric.origins(q), up) + self.T_world_carried.translation[2]
        return np.asarray(np.maximum(heights.max(axis=1) - shoulder, 0.0))

    def tools_down(self, q: FloatArray) -> FloatArray:
        """Turn tools straight down in place, and drop postures at limits, shape (m, axes)."""
        R, p = self.tools(q)
        x = R[:, :, 0] * (1.0, 1.0, 0.0)
        # A level x axis stays; that of a tool along x comes from its y axis.
        x = np.where(norm(x, axis=1, keepdims=True) > 0.1, x, R[:, :, 1] * (1.0, 1.0, 0.0))
        x /= norm(x, axis=1, keepdims=True)
        z = np.broadcast_to((0.0, 0.0, -1.0), x.shape)
        down = np.stack([x, np.cross(z, x), z], axis=-1)
        R_carried, T = self.T_world_carried.rotation.T, self.T_flange_tcp.inverse()
        R = product(R_carried, down)
        p = product(p - self.T_world_carried.translation, R_carried.T)
        p = p + product(R, T.translation)
        reached, error = descend(self.numeric, product(R, T.rotation), p, q)
        return reached[
            (error <= INVERSE.residual).all(axis=1) & (self.room(reached) >= SETTINGS.room)
        ]


def _mirror_signs(robot: Robot, at: FloatArray) -> FloatArray | None:
    """Compute the factors from left to right joints of arms that mirror, or None.

    Arms mirror if their axes do with all joints of the arms at zero, in a plane between them along x or y. A turn
    about an axis becomes the opposite turn about the mirrored axis.

    Args:
        robot: of the data model.
        at: positions of all joints; those of the platform are taken.
    """
    if len(robot.arms) != 2 or len(robot.arms[0].joints) != len(robot.arms[1].joints):
        return None
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = pin.neutral(model)
    for name, value in zip(robot.platform, at[robot.columns(robot.platform)], strict=True):
        q[model.idx_qs[model.getJointId(name)]] = value
    pin.computeJointJacobians(model, data, q)
    slides = np.array([name in robot.sliding for name in robot.arms[0].joints])
    axes, points = [], []
    for arm in robot.arms:
        joints = [model.getJointId(name) for name in arm.joints]
        twists = np.array([data.J[:, model.idx_vs[joint]] for joint in joints])
        axes.append(np.where(slides[:, None], twists[:, :3], twists[:, 3:]))
        points.append(np.array([data.oMi[joint].translation for joint in joints]))
    for normal in ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)):
        mirror = np.eye(3) - 2.0 * np.outer(normal, normal)
        mirrored = product(axes[0], mirror)
        apart = points[1] - product(points[0], mirror)
        # Twice the distance of the plane from the origin, along its normal, as most joints have it.
        apart -= np.median(apart, axis=0) * normal
        along = (mirrored * axes[1]).sum(axis=1)
        off = norm(np.cross(mirrored, axes[1]), axis=1) > SETTINGS.mirror
        aside = norm(np.cross(apart, axes[1]), axis=1) > SETTINGS.mirror
        if not off.any() and not (aside & ~slides).any():
            return np.sign(along) * np.where(slides, 1.0, -1.0)
    return None
