"""Robots with sliding joints and capsules for links, for tests: lifts and rails that carry arms, and arms on rails.

Each arm has links of 400 and 350 mm and its flange 100 mm beyond the wrist. With seven joints it is spherical-revolute-
spherical; with six it lacks the third one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

QUARTER = "1.5707963267948966"
UPPER, FORE, HAND = 0.4, 0.35, 0.1
"""Lengths of the arms' links [m]."""
SPEED, ACCELERATION, JERK = 0.5, 2.0, 20.0
"""Limits of every sliding joint [m/s, m/s², m/s³]."""
TURN_SPEED = 3.0
"""Limit of every joint that turns [rad/s]: reached in 0.3 s, that acceleration in 0.1 s."""
HOME = [0.0, -40.0, 0.0, 100.0, 0.0, 30.0, 0.0]
"""Seven joints with the tool straight down [deg]: the upper arm 40 deg above the horizon, the forearm 60 deg below."""
BESIDE = 0.25
"""Distance of each shoulder from the middle [m]."""
AHEAD = UPPER * np.cos(np.radians(40.0)) + FORE * np.cos(np.radians(60.0))
"""How far the flange is before the shoulder at home [m]."""
BELOW = FORE * np.sin(np.radians(60.0)) + HAND - UPPER * np.sin(np.radians(40.0))
"""How far it is below it [m]."""


@dataclass(frozen=True)
class Slide:
    """A sliding joint."""

    axis: str
    """Its direction, three numbers."""
    lower: float
    """Lowest position [m]."""
    upper: float
    """Highest position [m]."""


LIFT = Slide("0 0 1", -0.2, 0.5)
RAIL = Slide("0 1 0", -1.0, 1.5)
LONG = Slide("1 0 0", -4.0, 4.0)
"""Longer than a turn has radians."""


def _joint(name: str, parent: str, xyz: str, slide: Slide | None = None, axis: str = "") -> str:
    """Returns a joint and, but for its shape, its link."""
    kind, lower, upper, speed = "revolute", -2.9, 2.9, TURN_SPEED
    if slide is not None:
        kind, axis, lower, upper, speed = "prismatic", slide.axis, slide.lower, slide.upper, SPEED
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower!r}" upper="{upper!r}" velocity="{speed!r}" effort="0"/></joint>'
    )


def _link(name: str, length: float = 0.0, radius: float = 0.05) -> str:
    """Returns a link, with a capsule along x from its origin where it has a length."""
    if not length:
        return f'<link name="{name}_link"/>'
    inner = length - 2.0 * radius
    return (
        f'<link name="{name}_link"><collision><origin xyz="{length / 2} 0 0" rpy="0 {QUARTER} 0"/>'
        f'<geometry><capsule radius="{radius}" length="{inner:.4f}"/></geometry></collision></link>'
    )


def arm_urdf(side: str, parent: str, joints: int, slide: Slide | None = None) -> str:
    """Returns the joints and links of one arm of six or seven joints that turn, on a slide of its own or not."""
    y = BESIDE if side == "left" else -BESIDE
    place = f"0.1 {y} 0"
    found = ""
    if slide is not None:
        found += _joint(f"{side}_slide", parent, place, slide) + _link(f"{side}_slide")
        parent, place = f"{side}_slide_link", "0 0 0"
    rows = [
        ("1", place, "0 0 1", 0.0),
        ("2", "0 0 0", "0 1 0", UPPER if joints == 6 else 0.0),
        ("3", "0 0 0", "1 0 0", UPPER),
        ("4", f"{UPPER} 0 0", "0 1 0", 0.0),
        ("5", "0 0 0", "1 0 0", FORE),
        ("6", f"{FORE} 0 0", "0 1 0", 0.0),
        ("7", "0 0 0", "1 0 0", 0.0),
    ]
    for number, xyz, axis, length in rows:
        if joints == 6 and number == "3":
            continue
        name = f"{side}_{number}"
        found += _joint(name, parent, xyz, axis=axis) + _link(name, length)
        parent = f"{name}_link"
    return found + (
        f'<link name="{side}_flange"/><joint name="{side}_fix" type="fixed"><parent link="{parent}"/>'
        f'<child link="{side}_flange"/><origin xyz="{HAND} 0 0" rpy="0 {QUARTER} 0"/></joint>'
    )


def arm_joints(side: str, joints: int, slide: Slide | None = None) -> list[str]:
    """Returns the names of an arm's joints, base to flange."""
    numbers = [n for n in range(1, 8) if not (joints == 6 and n == 3)]
    return [*([f"{side}_slide"] if slide is not None else []), *(f"{side}_{n}" for n in numbers)]


def write_robot(
    folder: Path,
    platform: dict[str, Slide | None],
    *,
    joints: int = 7,
    own: Slide | None = None,
    frozen: str = "",
    home: str = "",
) -> None:
    """Writes robot.urdf and robot.yaml.

    Args:
        folder: where to.
        platform: joints that carry both arms, world side first: a slide, or None for a waist about z.
        joints: of each arm that turn: six or seven.
        own: the slide that each arm has as its first joint, or None.
        frozen: what the robot file says of frozen joints; such joints of the platform are not named there.
        home: what it says of further joints in the posture home.
    """
    parent, urdf = "base", '<link name="base"/>'
    for name, slide in platform.items():
        place = "0 0 1" if parent == "base" else "0 0 0"
        urdf += _joint(name, parent, place, slide, "0 0 1") + _link(name)
        parent = f"{name}_link"
    sides = ("left", "right")
    for side in sides:
        urdf += arm_urdf(side, parent, joints, own)
    (folder / "dualarm.toml").touch()
    (folder / "robot.urdf").write_text(f'<robot name="sliding">{urdf}</robot>')
    degrees = dict(zip(range(1, 8), HOME, strict=True))
    posture = [
        f"{name}: {degrees[int(name[-1])]:g} deg"
        for side in sides
        for name in arm_joints(side, joints)
    ]
    moving = [name for name in platform if name not in frozen]
    slides = [name for name in moving if platform[name] is not None]
    slides += [f"{side}_slide" for side in sides if own is not None]
    rate = f"{{acceleration: {ACCELERATION:g} m/s^2, jerk: {1e3 * JERK:g} mm/s^3}}"
    lines = [
        "dualarm: robot/1",
        "name: Sliding",
        "urdf: robot.urdf",
        f"platform: [{', '.join(moving)}]",
        "arms:",
        *(
            f"  {side}: {{joints: [{', '.join(arm_joints(side, joints, own))}], flange: {side}_flange}}"
            for side in sides
        ),
        "limits:",
        "  default: {acceleration: top speed in 0.3 s, jerk: acceleration in 0.1 s}",
        *(f"  {name}: {rate}" for name in slides),
        *([f"frozen: {{{frozen}}}"] if frozen else []),
        "allowed_contacts: [[left_UPPER_link, left_5_link], [right_UPPER_link, right_5_link]]".replace(
            "UPPER", "2" if joints == 6 else "3"
        ),
        f"postures: {{home: {{{', '.join([*posture, *([home] if home else [])])}}}}}",
    ]
    (folder / "robot.yaml").write_text("\n".join(lines) + "\n")
