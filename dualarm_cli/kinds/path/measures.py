"""Measurements of followed paths, and their lines, tables and curves in reports.

They include the least distance between an arm's elbow and a point while the tool stays where it is, in closed form.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinds.path.checks import along_path, followed_work
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.reporting import (
    KindMeasures,
    joint_use,
    least_clearance,
    methods_table,
    room_words,
    travel_words,
)
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.manipulability import manipulability
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.curves.tool_path import RoundedCorner
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.verification.tool_model import ToolModel


def path_lines(report: dict[str, Any]) -> list[str]:
    """Returns a sentence for every path of a report.

    Args:
        report: as built by `build_report`.
    """
    lines = []
    for path in report["paths"]:
        springs = path["method"].startswith("virtual_spring")
        least = path["least_elbow_distance"]
        elbows = ", ".join(
            f"{arm} {distance * 1e3:.0f} mm"
            + (
                f" (at least {least[arm] * 1e3:.0f} mm with tools and platform there)"
                if least is not None
                else ""
            )
            for arm, distance in path["elbow_distance"].items()
        )
        each = ", ".join(f"{arm} {value:.4g}" for arm, value in path["manipulability"].items())
        lines.append(
            f"path {path['task']} by {path['method']}: {path['length'] * 1e3:.1f} mm in {path['duration']:.3f} s; "
            f"tools within {_small(path['tool_error'])} of it; "
            + _rounded(path["rounded_corners"])
            + (f"elbows from their critical points on average {elbows}; " if springs else "")
            + f"mean manipulability {each}, together {path['manipulability_together']:.4g}; "
            f"joints travel {travel_words(path)} in all, "
            f"{path['limit_joint']} comes within {room_words(path)} of its limit, "
            f"{path['speed_joint']} uses {path['speed_share']:.0%} of its speed"
        )
    return lines


def _rounded(left_by: list[float]) -> str:
    """Returns the words about rounded corners, from how far the tool leaves each [m]."""
    if not left_by:
        return ""
    one = len(left_by) == 1
    many, them = ("one corner is", "it") if one else (f"{len(left_by)} corners are", "them")
    return f"{many} rounded, the tool leaves {them} by at most {_small(max(left_by))}; "


def _small(length: float) -> str:
    """Returns a small length in a unit that shows it; below a nanometre it means nothing."""
    if length >= 1e-4:
        return f"{length * 1e3:.2f} mm"
    if length >= 1e-7:
        return f"{length * 1e6:.1f} um"
    return f"{length * 1e9:.0f} nm" if length >= 1e-9 else "< 1 nm"


def paths_table(section: dict[str, Any]) -> Any:
    """Returns the table of how each method follows a task file's paths; None where it has none.

    Args:
        section: one member of the comparison's `comparisons`.
    """
    methods = len({row["method"] for row in section["rows"] if row["paths"]}) > 1

    def cells(row: dict[str, Any], path: dict[str, Any]) -> list[str]:
        elbows = list(path["elbow_distance"].values())
        least = list((path["least_elbow_distance"] or {}).values())
        return [
            *([row["method"]] if methods else []),
            path["method"],
            _small(path["tool_error"]),
            f"{sum(elbows) / len(elbows) * 1e3:.1f}",
            f"{sum(least) / len(least) * 1e3:.1f}" if least else "–",
            f"{path['manipulability_together']:.4g}",
            f"{path['least_manipulability_together']:.4g}",
        ]

    texts = [*(["method"] if methods else []), "follower"]
    return methods_table(
        section, "path", texts, ("tool", "elbow mm", "least", "M", "least M"), cells
    )


CURVE = 101
"""Instants of curves that are compared."""
SPACING = 0.005
"""Time between the instants at which bodies are measured [s]."""


@dataclass(frozen=True)
class PathSamples:
    """One path as it is followed, at k instants of m arms that follow."""

    task: str
    """Id of the task."""
    method: str
    """What found the joints."""
    work: PathWork
    """What was asked for."""
    arms: tuple[str, ...]
    """Arms that follow."""
    time: FloatArray
    """Instants since the path began [s], shape (k,)."""
    position: FloatArray
    """All joints [rad], shape (k, n)."""
    velocity: FloatArray
    """Their velocities [rad/s], shape (k, n)."""
    acceleration: FloatArray
    """Their accelerations [rad/s²], shape (k, n)."""
    tool: FloatArray
    """Tool centre points [m], shape (k, m, 3)."""
    elbow: FloatArray
    """Elbows [m], shape (k, m, 3)."""
    critical: FloatArray
    """Critical points [m], shape (k, m, 3)."""
    least: FloatArray | None
    """Least distance of each elbow from its critical point over all postures of its arm within limits, with tool and
    platform where they are [m], shape (k, m); None for arms that are not in closed form."""
    alone: FloatArray
    """Manipulability of each arm by its own joints, shape (k, m)."""
    together: FloatArray
    """Manipulability of all tools by all joints that move them, shape (k,)."""

    @property
    def distance(self) -> FloatArray:
        """Distances of the elbows from their critical points [m], shape (k, m)."""
        found: FloatArray = norm(self.elbow - self.critical, axis=-1)
        return found

    @property
    def force(self) -> FloatArray:
        """Contraction forces of the virtual springs, K times the distances ([Choi2020] Eq. 9-10), shape (k, m)."""
        return self.work.stiffness * self.distance


def path_samples(schedule: Schedule, job: Job) -> list[PathSamples]:
    """Returns the paths of a planned job as they are followed, in their order.

    Args:
        schedule: the plan.
        job: what it was planned for.
    """
    if not job.has_paths:
        return []
    job = schedule.blending.straight(job)
    context, tools = PathContext.of(CellModel.from_cell(job.cell), job), ToolModel(schedule)
    return [
        _sampled(schedule, context, section, followed_work(schedule, tools, work, section[0].id))
        for section in job.sections()
        if (work := section[0].path) is not None and _span(schedule, section) is not None
    ]


def _span(schedule: Schedule, section: tuple[Task, ...]) -> tuple[float, float] | None:
    """Returns from when to when a section's path is followed [s]; None where the schedule does not say."""
    spans = [
        (s.start, s.end)
        for s in schedule.segments
        if s.kind == "path" and s.task == section[0].id and s.end > s.start
    ]
    return spans[0] if spans else None


def _sampled(
    schedule: Schedule, context: PathContext, section: tuple[Task, ...], work: PathWork
) -> PathSamples:
    span = _span(schedule, section)
    assert span is not None  # asked before
    body, trajectory = context.body, schedule.trajectory.select(context.body.joints)
    count = max(2, int(np.ceil((span[1] - span[0]) / SPACING)) + 1)
    time = np.linspace(*span, count)
    q, qd, qdd = trajectory.at(time)
    which = [a for a, arm in enumerate(body.arms) if arm in work.paths]
    points = context.critical_points(work.critical_points)
    own = body.moves & ~body.moves_carried
    rows: list[tuple[FloatArray, ...]] = []
    follows = np.repeat(np.isin(np.arange(len(body.arms)), which), 6)
    free = body.moves[which].any(axis=0)
    for configuration in q:
        state = body.at(configuration)
        alone = [manipulability(state.J[6 * a : 6 * a + 6][:, own[a]]) for a in which]
        together = manipulability(state.J[follows][:, free])
        critical = body.carried_points(state, points)[0]
        rows.append(
            (
                state.p[which],
                state.elbow[which],
                critical[which],
                np.array(alone),
                together,
                state.R[which],
            )
        )
    tool, elbow, critical, alone_all, together_all, rotation = (
        np.array([row[i] for row in rows]) for i in range(6)
    )
    methods = [stage.platform_solver for stage in schedule.stages if section[0].id in stage.tasks]
    arms = tuple(body.arms[a] for a in which)
    samples = PathSamples(
        section[0].id,
        methods[0] if methods else "",
        work,
        arms,
        time - span[0],
        q,
        qd,
        qdd,
        tool,
        elbow,
        critical,
        None,
        alone_all,
        together_all,
    )
    if not context.model.has_arm_angles:
        return samples
    return replace(samples, least=_least(context, samples, rotation))


def _least(context: PathContext, samples: PathSamples, R: FloatArray) -> FloatArray:
    """Returns the least distances of the elbows of m arms from their critical points [m], shape (k, m).

    Args:
        context: the job.
        samples: the path as it is followed, with elbows on the axes of the arms' fourth joints, as springs pull them.
        R: rotations of the tools, shape (k, m, 3, 3).
    """
    model, q, found = context.model, samples.position, []
    R_world, p_world = model.carried_frame(q)
    R_carried = np.swapaxes(R_world, -1, -2)
    for m, name in enumerate(samples.arms):
        arm = model.arms[name]
        T = arm.T_flange_tcp.inverse()
        turned = product(R_carried, R[:, m])
        tool, place, point = (
            product(R_carried, (there[:, m] - p_world)[..., None])[..., 0]
            for there in (samples.tool, samples.elbow, samples.critical)
        )
        flange = tool + product(turned, T.translation)
        middle, axis = arm.closed_form.elbow(q[0, arm.columns])
        along = float(product(place[0] - middle, axis))
        found.append(
            least_elbow_distance(arm.closed_form, product(turned, T.rotation), flange, point, along)
        )
    return np.stack(found, axis=1)


def path_curves(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Returns what of every path is drawn over time beside that of other methods, JSON-ready, at CURVE instants.

    Contraction forces where the file gives critical points, manipulability of each arm and of all tools together.

    Args:
        schedule: the plan.
        job: what it was planned for.
    """
    found = []
    for path in path_samples(schedule, job):
        which = np.linspace(0, len(path.time) - 1, CURVE).round().astype(int)
        forces = path.force if path.work.critical_points else np.empty((len(path.time), 0))
        found.append(
            {
                "task": path.task,
                "time": path.time[which].tolist(),
                "force": {
                    arm: f[which].tolist() for arm, f in zip(path.arms, forces.T, strict=False)
                },
                "manipulability": {
                    arm: one[which].tolist()
                    for arm, one in zip(path.arms, path.alone.T, strict=True)
                },
                "manipulability_together": path.together[which].tolist(),
            }
        )
    return found


def path_measures(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Returns what is measured of every path, JSON-ready; m, rad, s.

    Args:
        schedule: the plan, with its verification where there is one.
        job: what it was planned for.
    """
    samples = path_samples(schedule, job)
    if not samples:
        return []
    model = ToolModel(schedule)
    robot = job.cell.robot
    found = []
    for path in samples:
        segments = [s for s in schedule.segments if s.kind == "path" and s.task == path.task]
        along = [along_path(schedule, model, s, path.work.paths[s.arm]) for s in segments]
        idle = {j for arm in robot.arms if arm.name not in path.arms for j in arm.joints}
        counted = [k for k, joint in enumerate(robot.joints) if joint not in idle]
        numbers = [k for k, stage in enumerate(schedule.stages) if path.task in stage.tasks]
        found.append(
            {
                "task": path.task,
                "method": path.method,
                "arms": list(path.arms),
                "duration": float(path.time[-1]),
                "length": path.work.length,
                "tool_error": max(float(one.distance.max()) for one in along),
                "tool_angle_error": max(float(one.angle.max()) for one in along),
                "rounded_corners": [
                    piece.left_by
                    for way in path.work.paths.values()
                    for piece in way.pieces
                    if isinstance(piece, RoundedCorner)
                ],
                "elbow_distance": dict(
                    zip(path.arms, path.distance.mean(axis=0).tolist(), strict=True)
                ),
                "least_elbow_distance": None
                if path.least is None
                else dict(zip(path.arms, path.least.mean(axis=0).tolist(), strict=True)),
                "manipulability": dict(
                    zip(path.arms, path.alone.mean(axis=0).tolist(), strict=True)
                ),
                "manipulability_together": float(path.together.mean()),
                "least_manipulability_together": float(path.together.min()),
                **joint_use(job, path.position, path.velocity, counted),
                "clearance": least_clearance(schedule, numbers),
            }
        )
    return found


MEASURES = KindMeasures(
    "work",
    {"paths": path_measures},
    path_lines,
    {"paths": path_measures, "path_curves": path_curves},
    paths_table,
)


THIRDS = np.arange(3) * (TURN / 3.0)
"""Arm angles that tell a sinusoid over the arm angle [rad]."""


def least_elbow_distance(
    arm: SrsArm, R: FloatArray, p: FloatArray, point: FloatArray, along: float = 0.0
) -> FloatArray:
    """Compute the least elbow distance from a point within joint limits [m], shape (k,).

    The elbow is on a circle about the line from shoulder to wrist, so that its squared distance from a point is
    a + b cos psi + c sin psi: the least is where that is least, or at an end of the interval of arm angles that the
    joints' limits leave. Infinite where they leave none.

    Args:
        arm: the arm and its limits.
        R: flange rotations in the base frame, shape (k, 3, 3).
        p: flange positions in the base frame [m], shape (k, 3).
        point: in the base frame [m], shape (k, 3).
        along: how far along the axis of joint 4 from it what counts as the elbow is [m].
    """
    intervals = arm.feasible_arm_angles(R, p)
    q = np.stack([arm.solve(R, p, float(psi)).q for psi in THIRDS])
    elbow, axis = arm.elbow(q)
    offset = elbow + along * axis - point[..., None, :]
    squared = (offset * offset).sum(axis=-1)
    a = squared.mean(axis=0)
    b, c = (2.0 / 3.0 * np.einsum("i,i...->...", wave(THIRDS), squared) for wave in (cos, sin))
    lowest = arctan2(-c, -b)[..., None]
    a, b, c = a[..., None], b[..., None], c[..., None]
    reached = np.mod(lowest - intervals.start, TURN) <= intervals.end - intervals.start
    ends = (a + b * cos(psi) + c * sin(psi) for psi in (intervals.start, intervals.end))
    least = np.where(reached, a - np.hypot(b, c), np.minimum(*ends))
    least = np.where(np.isnan(intervals.start), np.inf, least).min(axis=(-1, -2))
    found: FloatArray = np.sqrt(np.maximum(least, 0.0))
    return found
