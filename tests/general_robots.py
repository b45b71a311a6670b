"""Small URDFs of robots whose arms are not spherical-revolute-spherical, from published numbers, for tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

QUARTER = "1.5707963267948966"
TURN = 6.283185307179586
Row = tuple[str, str, str, float, float, float]
"""Place in the parent, its rotation, the axis; lower, upper [rad] and speed [rad/s]."""


def _deg(*values: float) -> tuple[float, ...]:
    return tuple(float(v) for v in np.radians(values))


def yumi_arm(side: int) -> list[Row]:
    """ABB IRB 14000 as in KTH's yumi_description; side is 1 for the left arm, -1 for the right one."""
    first = "0.9781 -0.5716 2.3180" if side > 0 else "-0.9795 -0.5682 -2.3155"
    plus, minus = f"{QUARTER} 0 0", f"-{QUARTER} 0 0"
    return [
        (f"0.05355 {side * 0.0725} 0.41492", first, "0 0 1", *_deg(-168.5, 168.5, 180)),
        ("0.03 0 0.1", plus, "0 0 1", *_deg(-143.5, 43.5, 180)),
        ("-0.03 0.17283 0", minus, "0 0 1", *_deg(-168.5, 168.5, 180)),
        ("-0.04188 0 0.07873", f"{QUARTER} -{QUARTER} 0", "0 0 1", *_deg(-123.5, 80, 180)),
        ("0.0405 0.16461 0", minus, "0 0 1", *_deg(-290, 290, 400)),
        ("-0.027 0 0.10039", plus, "0 0 1", *_deg(-88, 138, 400)),
        ("0.027 0.029 0", minus, "0 0 1", *_deg(-229, 229, 400)),
    ]


def nextage_arm(side: int) -> list[Row]:
    """Kawada Nextage Open as in its nextage_description: six axes, 90 mm between the last two."""
    wrist = (-1.8326, 2.87979) if side > 0 else (-2.87979, 1.8326)
    speed = _deg(172, 133, 215, 264, 224, 300)
    return [
        (
            f"0 {side * 0.145} 0.370296",
            f"{-side * 0.261799} 0 0",
            "0 0 1",
            -1.53589,
            1.53589,
            speed[0],
        ),
        ("0 0 0", "0 0 0", "0 1 0", -2.44346, 1.0472, speed[1]),
        (f"0 {side * 0.095} -0.25", "0 0 0", "0 1 0", -2.75762, 0.0, speed[2]),
        ("-0.03 0 0", "0 0 0", "0 0 1", *wrist, speed[3]),
        ("0 0 -0.235", "0 0 0", "0 1 0", -1.74533, 1.74533, speed[4]),
        ("-0.047 0 -0.09", "0 0 0", "1 0 0", -2.84489, 2.84489, speed[5]),
    ]


def spherical_wrist_arm(side: int) -> list[Row]:
    """A six-axis arm of 0.4 and 0.4 m links with a spherical wrist, its shoulder 0.3 m beside the middle."""
    return [
        (f"0 {side * 0.3} 0.4", "0 0 0", "0 0 1", -2.9, 2.9, 2.0),
        ("0 0 0", "0 0 0", "0 1 0", -2.0, 2.0, 2.0),
        ("0.4 0 0", "0 0 0", "0 1 0", -2.6, 2.6, 2.0),
        ("0.2 0 0", "0 0 0", "1 0 0", -3.1, 3.1, 4.0),
        ("0.2 0 0", "0 0 0", "0 1 0", -2.1, 2.1, 4.0),
        ("0 0 0", "0 0 0", "1 0 0", -6.2, 6.2, 4.0),
    ]


def ur5_arm(side: int) -> list[Row]:
    """Universal Robots UR5 as in ROS-Industrial's ur_description, 0.4 m beside the middle."""
    return [
        (f"0 {side * 0.4} 0.089159", "0 0 0", "0 0 1", -TURN, TURN, 3.15),
        ("0 0.13585 0", f"0 {QUARTER} 0", "0 1 0", -TURN, TURN, 3.15),
        ("0 -0.1197 0.425", "0 0 0", "0 1 0", -0.5 * TURN, 0.5 * TURN, 3.15),
        ("0 0 0.39225", f"0 {QUARTER} 0", "0 1 0", -TURN, TURN, 3.2),
        ("0 0.093 0", "0 0 0", "0 0 1", -TURN, TURN, 3.2),
        ("0 0 0.09465", "0 0 0", "0 1 0", -TURN, TURN, 3.2),
    ]


def chain(prefix: str, rows: list[Row], parent: str, tool: str) -> str:
    """Returns the links and joints of one arm and its flange."""
    found = []
    for k, (xyz, rpy, axis, lower, upper, speed) in enumerate(rows, start=1):
        found.append(
            f'<link name="{prefix}_{k}"/><joint name="{prefix}_j{k}" type="revolute">'
            f'<parent link="{parent}"/><child link="{prefix}_{k}"/><origin xyz="{xyz}" rpy="{rpy}"/>'
            f'<axis xyz="{axis}"/><limit lower="{lower!r}" upper="{upper!r}" velocity="{speed!r}" effort="1"/></joint>'
        )
        parent = f"{prefix}_{k}"
    found.append(
        f'<link name="{prefix}_flange"/><joint name="{prefix}_fix" type="fixed"><parent link="{parent}"/>'
        f'<child link="{prefix}_flange"/><origin {tool}/></joint>'
    )
    return "".join(found)


@dataclass(frozen=True)
class GeneralRobot:
    """What a robot file needs."""

    name: str
    urdf: str
    kind: str
    platform: bool
    home: dict[str, list[float]]

    def write(self, folder: Path) -> None:
        """Writes robot.urdf and robot.yaml; every joint gets its top speed in 0.3 s."""
        (folder / "robot.urdf").write_text(self.urdf)
        arms = {
            side: [f"{side}_j{k}" for k in range(1, len(home) + 1)]
            for side, home in self.home.items()
        }
        joints = [*(["waist"] if self.platform else []), *arms["left"], *arms["right"]]
        lines = ["dualarm: robot/1", f"name: {self.name}", "urdf: robot.urdf", "arms:"]
        if self.platform:
            lines.insert(3, "platform: [waist]")
        for side, names in arms.items():
            lines.append(
                f"  {side}: {{joints: [{', '.join(names)}], flange: {side}_flange, kind: {self.kind}}}"
            )
        lines.append("limits:")
        lines += [f"  {name}: {{acceleration: 8, jerk: 80, source: assumed}}" for name in joints]
        home = ", ".join(
            f"{side}_j{k}: {q}" for side in arms for k, q in enumerate(self.home[side], start=1)
        )
        lines.append(f"postures: {{home: {{{home}}}}}")
        (folder / "robot.yaml").write_text("\n".join(lines) + "\n")


def _robot(left: str, right: str, waist: str = "") -> str:
    return f'<robot name="r"><link name="base"/>{waist}{left}{right}</robot>'


TOOL_Z = 'xyz="0 0 0.036" rpy="0 0 0"'
YUMI = GeneralRobot(
    "YuMi",
    _robot(
        chain("left", yumi_arm(1), "base", TOOL_Z), chain("right", yumi_arm(-1), "base", TOOL_Z)
    ),
    "general",
    False,
    {
        "left": [1.27, -0.15, -0.33, 0.77, 0.38, -0.15, 0.0],
        "right": [-0.87, -0.14, -0.05, 0.77, -0.02, -0.14, -0.39],
    },
)
WAIST = (
    '<link name="chest"/><joint name="waist" type="revolute"><parent link="base"/><child link="chest"/>'
    '<origin xyz="0 0 0.97"/><axis xyz="0 0 1"/>'
    '<limit lower="-2.84489" upper="2.84489" velocity="1.92" effort="1"/></joint>'
)
DOWN = 'xyz="0 0 0" rpy="3.141592653589793 0 0"'
NEXTAGE = GeneralRobot(
    "Nextage",
    _robot(
        chain("left", nextage_arm(1), "chest", DOWN),
        chain("right", nextage_arm(-1), "chest", DOWN),
        WAIST,
    ),
    "general",
    True,
    {"left": [0, 0.3, -1.7, 0, 1.4, 0.2618], "right": [0, 0.3, -1.7, 0, 1.4, -0.2618]},
)
FORWARD = f'xyz="0.05 0 0" rpy="0 {QUARTER} 0"'
SPHERICAL = GeneralRobot(
    "Two six-axis arms",
    _robot(
        chain("left", spherical_wrist_arm(1), "base", FORWARD),
        chain("right", spherical_wrist_arm(-1), "base", FORWARD),
    ),
    "spherical_wrist",
    False,
    {"left": [0, -0.9, 1.8, 0, 0.67, 0], "right": [0, -0.9, 1.8, 0, 0.67, 0]},
)
UR5 = GeneralRobot(
    "Two UR5",
    _robot(
        chain("left", ur5_arm(1), "base", f'xyz="0 0.0823 0" rpy="-{QUARTER} 0 0"'),
        chain("right", ur5_arm(-1), "base", f'xyz="0 0.0823 0" rpy="-{QUARTER} 0 0"'),
    ),
    "parallel_axes",
    False,
    {"left": [0, -1.9, 1.9, -1.57, -1.57, 0], "right": [0, -1.9, 1.9, -1.57, -1.57, 0]},
)
MIXED = GeneralRobot(
    "Six and seven axes on a waist",
    _robot(
        chain("left", nextage_arm(1), "chest", DOWN),
        chain("right", yumi_arm(-1), "chest", TOOL_Z),
        WAIST,
    ),
    "general",
    True,
    {"left": NEXTAGE.home["left"], "right": YUMI.home["right"]},
)
ROBOTS = {"yumi": YUMI, "nextage": NEXTAGE, "spherical": SPHERICAL, "ur5": UR5, "mixed": MIXED}
TARGETS = {
    "yumi": (0.1, [(0.35, 0.15, 0.3, 0.35), (0.4, 0.2, 0.25, 0.3), (0.3, 0.12, 0.2, 0.4)]),
    "nextage": (0.8, [(0.25, 0.15, 0.2, 0.25), (0.28, 0.1, 0.15, 0.28), (0.27, 0.18, 0.2, 0.26)]),
    "spherical": (0.1, [(0.45, 0.2, 0.4, 0.45), (0.5, 0.25, 0.35, 0.5), (0.4, 0.22, 0.3, 0.45)]),
    "ur5": (0.1, [(0.5, 0.25, 0.3, 0.6), (0.45, 0.35, 0.35, 0.5), (0.4, 0.3, 0.2, 0.7)]),
}
"""Height, and x and |y| of pick and place of some tasks that both arms can do [m]."""


def write_cell(folder: Path, name: str, tasks: int = 2, shapes: str = "", more: str = "") -> Path:
    """Writes robot, cell and tasks of one of ROBOTS; returns the task file.

    Args:
        folder: where to.
        name: of the robot.
        tasks: how many for each arm.
        shapes: of both tools, as in a cell file.
        more: further lines of the cell file.
    """
    (folder / "dualarm.toml").write_text("")
    ROBOTS[name].write(folder)
    tool = "{tcp: {xyz: [0, 0, 100 mm]}" + (f", shapes: [{shapes}]" if shapes else "") + "}"
    (folder / "cell.yaml").write_text(
        f"dualarm: cell/1\nrobot: robot.yaml\ntools: {{left: {tool}, right: {tool}}}\n{more}"
    )
    z, places = TARGETS[name]
    lines = [
        "dualarm: tasks/1",
        "cell: cell.yaml",
        "return: true",
        "defaults: {approach: 50 mm, retract: 50 mm, dwell: 0.1 s}",
        "tasks:",
    ]
    for k, (x1, y1, x2, y2) in enumerate(places[:tasks]):
        for arm, side in (("left", 1), ("right", -1)):
            lines += [
                f"  - id: {arm} {k}",
                f"    arm: {arm}",
                f"    pick:  {{xyz: [{x1}, {side * y1}, {z}], rpy: [180 deg, 0, 0]}}",
                f"    place: {{xyz: [{x2}, {side * y2}, {z + 0.05}], rpy: [180 deg, 0, {side * 20} deg]}}",
            ]
    file = folder / "tasks.yaml"
    file.write_text("\n".join(lines) + "\n")
    return file
