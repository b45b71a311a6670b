"""A pendulum of one joint, whose torques are found by hand: m g L cos q and m L² dω/dt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Arm, JointLimits, JointTorques, Robot

MASS, LENGTH, GRAVITY, PART = 2.0, 0.5, 9.81, 3.0
ONE, ARM = np.ones(1), "left"
URDF = """\
<robot name="pendulum"><link name="base"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="9" effort="{effort}"/></joint>
<link name="arm"><inertial><mass value="1e-12"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
</link></robot>
"""


def pendulum(effort: float, base: pin.SE3 | None = None, **torques: object) -> Cell:
    """A bar without mass that turns about y, a tool of 2 kg at its end, and a kind of part of 3 kg."""
    limits = JointLimits(("swing",), -3 * ONE, 3 * ONE, 9 * ONE, 90 * ONE, 900 * ONE, ("assumed",))
    arm = Arm(ARM, ("swing",), "arm", "general")
    robot = Robot("pendulum", URDF.format(effort=effort), (), (arm,), limits)
    if torques:
        known = JointTorques.of_effort(effort * ONE)
        robot = replace(robot, stated_torques=replace(known, **torques))
    tcp = pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0]))
    tool = Tool(tcp, pin.Inertia(MASS, tcp.translation, np.zeros((3, 3))))
    part = pin.Inertia(PART, np.zeros(3), np.zeros((3, 3)))
    parts, inertias = {"box": ()}, {"box": part}
    return Cell(robot, base or pin.SE3.Identity(), {ARM: tool}, parts=parts, part_inertias=inertias)
