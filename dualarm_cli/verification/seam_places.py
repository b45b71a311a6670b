"""Where tool and part are while a seam is worked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.verification.tool_checks import dense_times
from dualarm_cli.verification.tool_model import ToolModel

ROUNDS = 12
"""Newton steps along the seam to the place that is nearest to the tool."""


@dataclass(frozen=True)
class OnSeam:
    """Tool and part during one seam, at k instants."""

    time: FloatArray
    """Instants [s], shape (k,)."""
    length: FloatArray
    """How far along the seam the nearest place is [m], shape (k,)."""
    distance: FloatArray
    """How far the tool's working point is from it [m], shape (k,)."""
    angle: FloatArray
    """By how much the tool is turned away, beyond what is free [rad], shape (k,)."""
    lean: FloatArray
    """By how much its axis leans away from where it should point [rad], shape (k,)."""
    R_part: FloatArray
    """Rotations of the part in the world, shape (k, 3, 3)."""
    p_part: FloatArray
    """Positions of the part [m], shape (k, 3)."""


def on_seam(
    schedule: Schedule, job: Job, model: ToolModel, work: SeamWork, segment: Segment
) -> OnSeam:
    """Returns where tool and part are during a segment of kind seam.

    The part hangs on the master's flange, or stands in the world; the tool's pose is taken in its frame. The place on
    the seam is looked for near where the way that the working point has gone would have it.
    """
    time = dense_times(schedule.trajectory.time, segment.start, segment.end)
    return placed(schedule, job, model, work, time, None)


def placed(
    schedule: Schedule,
    job: Job,
    model: ToolModel,
    work: SeamWork,
    time: FloatArray,
    guess: FloatArray | None,
) -> OnSeam:
    """Returns where tool and part are at instants (k,) [s], near places on the seam (k,) [m] if these are known."""
    position = schedule.trajectory.at(time)[0]
    R, p = model.poses(work.slave, position)
    R_part, p_part = (
        np.tile(work.part.rotation, (len(time), 1, 1)),
        np.tile(work.part.translation, (len(time), 1)),
    )
    if work.master is not None:
        R_tool, p_tool = model.poses(work.master, position)
        T: pin.SE3 = job.cell.tools[work.master].tcp.inverse() * work.part
        R_part, p_part = R_tool @ T.rotation, p_tool + R_tool @ T.translation
    tip = p + work.tool.standoff * R[:, :, 2]
    inside = ((tip - p_part)[:, None] @ R_part)[:, 0]
    if guess is None:
        gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(inside, axis=0), axis=1))])
        guess = gone * (work.length / max(gone[-1], 1e-12))
    s = np.clip(guess, 0.0, work.length)
    for _ in range(ROUNDS):
        along = ((inside - work.curve.at(s)[1]) * work.curve.directions(s)).sum(axis=1)
        s = np.clip(s + along, 0.0, work.length)
    R_seam, p_seam = work.curve.at(s)
    E = np.swapaxes(R_part @ R_seam @ work.tool.R_curve_tool, -1, -2) @ R
    distance = np.linalg.norm(inside - p_seam, axis=1)
    lean = np.arctan2(np.hypot(E[:, 0, 2], E[:, 1, 2]), E[:, 2, 2])
    return OnSeam(time, s, distance, _turned_away(E, lean, work), lean, R_part, p_part)


def _turned_away(E: FloatArray, lean: FloatArray, work: SeamWork) -> FloatArray:
    """Returns by how much tools are turned away beyond what is free, (k,) [rad].

    Args:
        E: rotations of the tools in the frames as they should be, shape (k, 3, 3).
        lean: of their axes [rad], shape (k,).
        work: the seam.
    """
    beyond = np.maximum(lean - work.tool.tilt, 0.0)
    if work.tool.free_spin:
        return beyond
    # What is left once the lean is taken back by the shortest turn.
    axis = np.stack([-E[:, 1, 2], E[:, 0, 2], np.zeros(len(E))], axis=-1)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    back = -np.where(size > 1e-12, axis / np.where(size > 1e-12, size, 1.0), 0.0) * lean[:, None]
    K = np.zeros((len(E), 3, 3))
    K[:, 0, 2], K[:, 1, 2] = back[:, 1], -back[:, 0]
    K[:, 2, 0], K[:, 2, 1] = -back[:, 1], back[:, 0]
    sine = np.where(lean > 1e-12, np.sin(lean) / np.where(lean > 1e-12, lean, 1.0), 1.0)
    cosine = np.where(lean > 1e-6, (1.0 - np.cos(lean)) / np.where(lean > 1e-6, lean**2, 1.0), 0.5)
    upright = (np.eye(3) + sine[:, None, None] * K + cosine[:, None, None] * (K @ K)) @ E
    spin = np.abs(log_rotation(upright)[:, 2])
    return np.maximum(beyond, spin)
