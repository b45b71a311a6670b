"""Tool of a cell without tools: direction, length, and the robot's hand or a gripper.

One decision says where the tool points, where its tool centre point is, and why. `dualarm robot import`, `dualarm init`
and `dualarm robot reach` take it from here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    Solid,
    cell_solids,
    geometry_model,
    link_solids,
    pairs_that_must_keep_apart,
    solid_distance,
)
from dualarm_cli.files.robots.visual_meshes import drawn_meshes
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import general_arms
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Arm, Robot
from dualarm_cli.model.shape import Shape
from dualarm_cli.notes import Note, NoteTable, of_arm
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import in_model_order, random_postures
from dualarm_cli.robot_import.structure import GRIPPER, word_among, words

_note = NoteTable(
    "tools",
    gripper="{tool}: along {axis} of {flange} ({why}), {mm:.4g} mm long: an assumed gripper",
    hand="{tool}: along {axis} of {flange} ({why}), {mm:.4g} mm long: to the end of the robot's hand",
    frame="{tool}: along {axis} of {flange} ({why}), {mm:.4g} mm long: to {frame} of the robot's hand",
    named="{tool}: along {axis} of {flange} ({why}), 0 mm long: {flange} is a tool centre point by its name",
    shapeless="{tool}: along {axis} of {flange} ({why}), 0 mm long: the hand {hand} has no shapes beyond it",
    within="{tool}: along {axis} of {flange} ({why}), 0 mm long: {flange} is within the robot's hand",
    shapes="where {links:listed} {links:is|are}",
    links="where {link} is, away from the wrist",
    last="where the last link's shapes are",
    given="{tool}: along {axis} of {flange}, {mm:.4g} mm long: by the `tcp` of the cell",
    guessed="guessed, as nothing stands beyond the wrist",
)


@dataclass(frozen=True)
class ToolSettings:
    """Dimensions of a proposed tool, and settings of its search."""

    length: float = 0.12
    """Maximum length of a gripper on a bare flange [m]."""
    length_share: float = 0.13
    """Maximum length of a gripper as a fraction of the reach."""
    radius_share: float = 0.25
    """Radius of a gripper as a fraction of its length."""
    hand: float = 0.06
    """Extent along the tool from which unnamed shapes count as a hand [m]."""
    beyond: float = 0.01
    """Distance beyond the flange from which a named hand is there [m]."""
    longer: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
    """Candidate distances between flange and gripper, relative to the gripper's length.

    The gripper must not touch the arm's own shapes.
    """
    postures: int = 200
    """Number of random postures in which a gripper is tested against its arm."""
    touched: float = 0.3
    """Maximum fraction of tested postures in which gripper and arm touch."""
    rounded: float = 0.005
    """Step to which dimensions of a gripper are rounded [m].

    A fifth of it for arms shorter than `short`.
    """
    short: float = 0.3
    """Maximum reach of a short arm [m]."""
    along: float = 0.6
    """Minimum cosine at which a tool points along the last joint's axis."""
    same: float = 1e-6
    """Difference up to which a tool is the proposed one [m, and of rotation matrices]."""
    away: float = 1e-3
    """Distance from the wrist from which a body shows the tool's side [m]."""


TOOL = ToolSettings()

_DIRECTIONS = {
    "+x": ((1.0, 0.0, 0.0), (0.0, 90.0, 0.0)),
    "-x": ((-1.0, 0.0, 0.0), (0.0, -90.0, 0.0)),
    "+y": ((0.0, 1.0, 0.0), (-90.0, 0.0, 0.0)),
    "-y": ((0.0, -1.0, 0.0), (90.0, 0.0, 0.0)),
    "+z": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    "-z": ((0.0, 0.0, -1.0), (180.0, 0.0, 0.0)),
}
"""Axes of a flange, and roll, pitch, yaw from z to them [deg]."""
_HAND_WORDS = GRIPPER | {"palm", "tcp"}
_POINT_WORDS = frozenset(("ee", "eef", "effector", "grasp", "grasping", "tip", "tool"))
"""Words of frames on the tool's axis that are tool centre points, if they carry nothing."""


@dataclass(frozen=True)
class ProposedTool:
    """Tool of an arm: where it points, where its tool centre point is, and why."""

    axis: str
    """Axis of the flange along which the tool points, such as +z."""
    tip: tuple[float, float, float]
    """Tool centre point in the flange's frame [m]."""
    note: Note
    """Sentence with direction, length and reason."""
    length: float = 0.0
    """Length of an assumed gripper, which ends at the tip [m]; 0 without one."""
    radius: float = 0.0
    """Radius of its capsule [m]."""
    beyond: float = 0.0
    """Extent of the hand beyond the tip, along the tool [m]."""

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the tool's frame in the flange's [deg]."""
        return _DIRECTIONS[self.axis][1]

    @property
    def tcp(self) -> pin.SE3:
        """Tool frame in the flange's; its z axis points along the tool."""
        return pin.SE3(pin.rpy.rpyToMatrix(*np.radians(self.rpy)), np.array(self.tip))

    @property
    def middle(self) -> pin.SE3:
        """Frame of an assumed gripper's capsule in the flange's."""
        return self.tcp * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * self.length]))

    @property
    def tool(self) -> Tool:
        """Proposed tool in the data model; a hand's shapes are those of its links."""
        size = (self.radius, self.length - 2.0 * self.radius)
        shapes = (Shape("capsule", size, self.middle),) if self.length else ()
        return Tool(self.tcp, shapes=shapes)


def with_tools(cell: Cell) -> tuple[Cell, dict[str, ProposedTool]]:
    """Mount a proposed tool on every arm of a cell; returns the cell and the tools.

    Args:
        cell: the cell, whose own tools are ignored.
    """
    tools = proposed_tools(cell)
    return replace(cell, tools={name: proposed.tool for name, proposed in tools.items()}), tools


def proposed_tools(cell: Cell) -> dict[str, ProposedTool]:
    """Propose a tool for every arm of a cell.

    Args:
        cell: robot and base.
    """
    kinematics = general_arms(cell)
    return {arm.name: _tool(cell, arm, kinematics[arm.name]) for arm in cell.robot.arms}


def tool_notes(cell: Cell) -> list[Note]:
    """Describe the tools of a cell: those proposed with their reasons, others by their frames.

    Args:
        cell: robot with the tools of a cell file.
    """
    notes = []
    for name, proposed in proposed_tools(cell).items():
        tcp = cell.tools[name].tcp
        if tcp.isApprox(proposed.tcp, TOOL.same):
            notes.append(proposed.note)
            continue
        axis = _nearest_axis(tcp.rotation[:, 2])
        length = 1e3 * float(norm(tcp.translation))
        data = {"arm": name, "flange": cell.robot.arm(name).flange, "axis": axis, "mm": length}
        notes.append(_note("given", tool=of_arm(name, "tool", len(cell.robot.arms)), **data))
    return notes


@dataclass(frozen=True)
class _Beyond:
    """Bodies beyond an arm's last joint, in the flange's frame."""

    flange: str
    """Name of the flange."""
    frames: Mapping[str, FloatArray]
    """Origins of the hand's links [m]."""
    shaped: tuple[str, ...]
    """Links of the hand with shapes."""
    points: tuple[str, ...]
    """Links of the hand that are points: without shapes, and nothing is fixed to them."""
    named: str
    """Link of the hand that the robot file names, or empty."""
    hand: FloatArray
    """Lower and upper corner of the hand's shapes [m], shape (k, 2, 3).

    k is 0 without shapes, else 1.
    """
    last: FloatArray
    """Lower and upper corner of the shapes that the last joint moves otherwise [m], likewise."""

    @classmethod
    def of(cls, robot: Robot, arm: Arm) -> _Beyond:
        """Measure the bodies beyond an arm's last joint."""
        model = pin.buildModelFromXML(robot.urdf)
        flange = model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
        T = flange.placement.inverse()
        poses = {
            frame.name: T * frame.placement
            for frame in model.frames
            if frame.type == pin.FrameType.BODY and frame.parentJoint == flange.parentJoint
        }
        solids = [s for s in link_solids(model, robot) if s.body in poses]
        solids = [replace(solid, pose=T * solid.pose) for solid in solids]
        corners: dict[str, list[FloatArray]] = {link: [] for link in poses}
        for solid in solids:
            corners[solid.body].append(_extent(solid))
        undrawn = {link for link, rows in corners.items() if rows}
        for mesh in robot.visuals:
            if mesh.link in poses and mesh.link not in undrawn:
                for surface in drawn_meshes([mesh]).values():
                    pose = poses[mesh.link] * mesh.pose
                    rows = product(surface.corners, pose.rotation.T) + pose.translation
                    corners[mesh.link].append(rows)
        hand = robot.hands[arm.name]
        carrying = {model.frames[frame.parentFrame].name for frame in model.frames}
        return cls(
            arm.flange,
            {link: poses[link].translation for link in hand},
            tuple(link for link in hand if corners[link]),
            tuple(link for link in hand if not corners[link] and link not in carrying),
            arm.hand,
            _box([rows for link in hand for rows in corners[link]]),
            _box([rows for link in poses if link not in hand for rows in corners[link]]),
        )

    @property
    def is_named(self) -> bool:
        """Flag of a hand by the robot file, or by the names of links."""
        return bool(self.named) or any(
            word_among(link, _HAND_WORDS) for link in (*self.frames, self.flange)
        )


def _extent(solid: Solid) -> FloatArray:
    """Compute the lower and upper corner of a solid [m], shape (2, 3)."""
    far, here = 100.0, coal.Transform3s.Identity()
    place = coal.Transform3s(solid.pose.rotation, solid.pose.translation)
    corners = np.empty((2, 3))
    for row, sign in ((0, -1.0), (1, 1.0)):
        for k in range(3):
            # The distance from a half-space far away gives the extent exactly.
            wall = replace(solid, geometry=coal.Halfspace(-sign * np.eye(3)[k], -far))
            corners[row, k] = sign * (far - solid_distance(solid, place, wall, here))
    return corners


def _box(corners: Sequence[FloatArray]) -> FloatArray:
    """Compute the box around points [m]: lower and upper corner, shape (k, 2, 3)."""
    if not corners:
        return np.zeros((0, 2, 3))
    rows = np.concatenate(corners)
    return np.array([[rows.min(axis=0), rows.max(axis=0)]])


def _outward(arm: GeneralArm, beyond: _Beyond) -> tuple[str, Note]:
    """Select the axis of the flange that points away from the wrist, with the reason.

    It is the last joint's axis, unless what stands beyond the wrist is off to its side. The hand's shapes decide on the
    side, else the farthest of its links or the flange, else the last link's shapes; + is a guess.
    """
    R, p = arm.forward(np.zeros((1, arm.axes)))
    wrist = product(R[0].T, arm.meeting_point - p[0])
    _, _, jacobian = arm.linearised(np.zeros((1, arm.axes)))
    last = product(R[0].T, jacobian[0, 3:, -1])
    farthest = max(
        {beyond.flange: np.zeros(3), **beyond.frames}.items(),
        key=lambda item: round(float(norm(item[1] - wrist)), 9),
    )
    votes = [
        *((box.mean(axis=0), _note("shapes", links=beyond.shaped)) for box in beyond.hand),
        (farthest[1], _note("links", link=farthest[0])),
        *((box.mean(axis=0), _note("last")) for box in beyond.last),
    ]
    direction, why = last * np.sign(last[np.argmax(np.abs(last))]), _note("guessed")
    for place, reason in votes:
        away = place - wrist
        length = float(norm(away))
        if length > TOOL.away:
            cosine = float(product(away, last)) / length
            direction = last * np.sign(cosine) if abs(cosine) >= TOOL.along else away
            why = reason
            break
    return _nearest_axis(direction), why


def _nearest_axis(direction: FloatArray) -> str:
    """Select the axis of a frame nearest to a direction (3,)."""
    return max(
        _DIRECTIONS, key=lambda axis: round(float(product(direction, _DIRECTIONS[axis][0])), 6)
    )


def _tool(cell: Cell, arm: Arm, kinematics: GeneralArm) -> ProposedTool:
    """Propose the tool of an arm."""
    beyond = _Beyond.of(cell.robot, arm)
    axis, why = _outward(kinematics, beyond)
    name = of_arm(arm.name, "tool", len(cell.robot.arms))
    data = {"arm": arm.name, "tool": name, "axis": axis, "flange": arm.flange, "why": why}
    along = np.array(_DIRECTIONS[axis][0])
    far = max(product(box, along).max() for box in (np.zeros((1, 3)), *beyond.hand, *beyond.last))

    def tool(tip: FloatArray, note: Note) -> ProposedTool:
        """Make a tool without an assumed gripper from its tool centre point [m]."""
        left = max(0.0, float(far - product(tip, along)))
        return ProposedTool(axis, _point(tip), note, beyond=left)

    if "tcp" in words(arm.flange):
        return tool(np.zeros(3), _note("named", **data))
    for link, origin in sorted(beyond.frames.items(), key=lambda item: item[0] != arm.hand):
        is_ahead = product(origin, along) > TOOL.beyond
        is_point = "tcp" in words(link) or (link == arm.hand and link not in beyond.shaped)
        if link in beyond.points and len(beyond.hand) and word_among(link, _POINT_WORDS):
            is_point |= bool(norm(origin - product(origin, along) * along) < TOOL.away)
        if is_ahead and is_point:
            return tool(origin, _note("frame", frame=link, mm=1e3 * float(norm(origin)), **data))
    end = 0.0
    for box in beyond.hand:
        behind, ahead = sorted(product(box, along).tolist())
        if beyond.is_named or ahead - behind > TOOL.hand:
            if behind < 0.0 and ahead <= -behind:
                return tool(np.zeros(3), _note("within", **data))
            end = ahead if ahead > TOOL.beyond else 0.0
    for box in beyond.last:
        ahead = max(product(box, along).tolist())
        end = end or (ahead if ahead > TOOL.hand else 0.0)
    if end:
        return tool(end * along, _note("hand", mm=1e3 * end, **data))
    if arm.hand:
        return tool(np.zeros(3), _note("shapeless", hand=arm.hand, **data))
    return _gripper(cell, arm, kinematics.reach, data)


def _point(place: FloatArray) -> tuple[float, float, float]:
    """Round a point to 1 mm."""
    x, y, z = (np.round(place, 3) + 0.0).tolist()
    return x, y, z


def _gripper(cell: Cell, arm: Arm, reach: float, data: Mapping[str, object]) -> ProposedTool:
    """Assume a gripper on an arm's bare flange, clear of the arm's own shapes."""
    step = TOOL.rounded if reach > TOOL.short else 0.2 * TOOL.rounded
    length = step * float(np.ceil(round(min(TOOL.length, TOOL.length_share * reach) / step, 6)))
    radius = step * round(TOOL.radius_share * length / step)
    axis, tools = str(data["axis"]), []
    for share in TOOL.longer:
        whole = step * round(share * length / step) + length
        tip = _point(whole * np.array(_DIRECTIONS[axis][0]))
        note = _note("gripper", mm=1e3 * whole, **data)
        tools.append(ProposedTool(axis, tip, note, length, radius))
    return next((tool for tool in tools if _has_room(cell, arm, tool)), tools[0])


def _has_room(cell: Cell, arm: Arm, tool: ProposedTool) -> bool:
    """Check that a tool touches its arm in few postures."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    whole = replace(cell, tools={arm.name: tool.tool}, obstacles=())
    solids = cell_solids(whole, model, ())
    arm_joints = {model.getJointId(joint) for joint in arm.joints}
    pairs = [
        (pair.first, pair.second)
        for pair in pairs_that_must_keep_apart(model, solids, whole)
        if {solids[pair.first].joint, solids[pair.second].joint} <= arm_joints
        and f"{arm.name}_tool" in (solids[pair.first].body, solids[pair.second].body)
    ]
    if not pairs:
        return True
    geometry, data = geometry_model(solids, pairs), model.createData()
    results = pin.GeometryData(geometry)
    postures = in_model_order(model, cell.robot, random_postures(cell.robot, TOOL.postures, 0))
    collisions = sum(
        pin.computeCollisions(model, data, geometry, results, q, True) for q in postures
    )
    return collisions <= TOOL.touched * TOOL.postures
