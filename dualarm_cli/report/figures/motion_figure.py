"""Joint motion over time, drawn into axes of matplotlib for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.errors import MissingDependencyError, UsageError
from dualarm_cli.model.schedule import Schedule

UNITS = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "acceleration": ("rad/s²", "m/s²")}
"""Units of quantities for joints that turn, and for joints that slide."""
COLOURS = {"left": "#0072b2", "right": "#d55e00"}
"""Colours of arms, also distinct without red or green; other joints are grey."""
DASHES = ("-", "--", ":", "-.", (0, (6, 1)), (0, (3, 1, 1, 1, 1, 1)), (0, (1, 3)))
"""Line styles of the joints of a group, base first."""


def plot_motion(
    schedule: Schedule, quantity: str, joints: str | Sequence[str] | None, axes: Any
) -> Any:
    """Draw a quantity of joints over time; see `Schedule.plot`."""
    if quantity not in UNITS:
        raise UsageError(f"quantity {quantity!r}: choose one of {', '.join(UNITS)}")
    robot, motion = schedule.robot, schedule.trajectory
    shown = motion.joints if joints is None else [joints] if isinstance(joints, str) else joints
    if not shown:
        raise UsageError(f"joints: names no joint; choose of {', '.join(motion.joints)}")
    if axes is None:
        try:
            import matplotlib.pyplot as plt
        except ImportError:
            raise MissingDependencyError("matplotlib", "plot") from None
        axes = plt.subplots(layout="constrained")[1]
    # Knots, where curves have corners, and points between them for the eye.
    knots = motion.time
    time = np.union1d(knots, np.linspace(knots[0], knots[-1], 500))
    values = dict(zip(UNITS, motion.clamped(time), strict=True))[quantity]
    groups = {
        name: (group, k) for group, names in robot.groups.items() for k, name in enumerate(names)
    }
    for name in shown:
        schedule.joint(name)  # refuses an unknown one
        group, k = groups[name]
        axes.plot(
            time - knots[0],
            values[:, motion.joints.index(name)],
            color=COLOURS.get(group, "0.35"),
            linestyle=DASHES[k % len(DASHES)],
            label=name,
        )
    kinds = {name in robot.sliding for name in shown}
    units = ", ".join(
        unit for unit, slides in zip(UNITS[quantity], (False, True), strict=True) if slides in kinds
    )
    axes.set(xlabel="time [s]", ylabel=f"{quantity} [{units}]")
    # Outside: curves fill the axes.
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    return axes
