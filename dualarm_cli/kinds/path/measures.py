"""Measurements of followed paths, and their lines, tables and curves in reports.

They include the least elbow distance from a point at a fixed tool pose, in closed form.
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
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.tool_model import ToolModel


def path_lines(report: dict[str, Any]) -> list[str]:
    """Write a sentence for every path of a report.

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
            f"joints travel {travel_words(path)}, "
            f"{path['limit_joint']} comes within {room_words(path)} of its limit, "
            f"{path['speed_joint']} uses {path['speed_share']:.0%} of its speed"
        )
    return lines


def _rounded(left_by: list[float]) -> str:
    """Describe rounded corners, from the tool's distance to each [m]."""
    if not left_by:
        return ""
    single = len(left_by) == 1
    many, them = ("one corner is", "it") if single else (f"{len(left_by)} corners are", "them")
    return f"{many} rounded, the tool leaves {them} by at most {_small(max(left_by))}; "


def _small(length: float) -> str:
    """Format a small length in a suitable unit.

    Below a nanometre it means nothing.
    """
    if length >= 1e-4:
        return f"{length * 1e3:.2f} mm"
    if length >= 1e-7:
        return f"{length * 1e6:.1f} um"
    return f"{length * 1e9:.0f} nm" if length >= 1e-9 else "< 1 nm"


def paths_table(section: dict[str, Any]) -> Any:
    """Build the table of each method's paths; None without paths.

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
"""Number of instants of compared curves."""
SPACING = 0.005
"""Time between measured instants [s]."""


@dataclass(frozen=True)
class PathSamples:
    """Samples of one followed path, at k instants of m arms that follow."""

    task: str
    """Id of the task."""
    method: str
    """Path follower."""
    work: PathWork
    """Path as requested."""
    arms: tuple[str, ...]
    """Arms that follow."""
    time: FloatArray
    """Instants since the path began [s], shape (k,)."""
    position: FloatArray
    """All joints [rad or m], shape (k, n)."""
    velocity: FloatArray
    """Velocities of all joints [rad/s or m/s], shape (k, n)."""
    acceleration: FloatArray
    """Accelerations of all joints [rad/s² or m/s²], shape (k, n)."""
    tool: FloatArray
    """Tool centre points [m], shape (k, m, 3)."""
    elbow: FloatArray
    """Elbows [m], shape (k, m, 3)."""
    critical: FloatArray
    """Critical points [m], shape (k, m, 3)."""
    least: FloatArray | None
    """Least possible elbow distances from the critical points [m], shape (k, m), or None.

    The minimum is over all postures within limits with tool and platform fixed. None for arms without closed form.
    """
    arm_manipulability: FloatArray
    """Manipulability of each arm by its own joints, shape (k, m)."""
    joint_manipulability: FloatArray
    """Manipulability of all tools by all joints that move them, shape (k,)."""

    @property
    def distance(self) -> FloatArray:
        """Distances of the elbows from their critical points [m], shape (k, m)."""
        distances: FloatArray = norm(self.elbow - self.critical, axis=-1)
        return distances

    @property
    def force(self) -> FloatArray:
        """Contraction forces of the virtual springs, shape (k, m) ([Choi2020] Eq. 9-10).

        They are K times the elbow distances.
        """
        return self.work.stiffness * self.distance


def path_samples(schedule: Schedule, job: Job) -> list[PathSamples]:
    """Sample the paths of a planned job, in their order.

    Args:
        schedule: the plan.
        job: its job.
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
    """Return the start and end of a section's path [s], or None without one."""
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
    assert span is not None  # the caller checks it
    body, trajectory = context.body, schedule.trajectory.select(context.body.joints)
    count = max(2, int(np.ceil((span[1] - span[0]) / SPACING)) + 1)
    time = np.linspace(*span, count)
    q, qd, qdd = trajectory.clamped(time)
    which = [a for a, arm in enumerate(body.arms) if arm in work.paths]
    points = context.critical_points(work.critical_points)
    arm_columns = body.moves & ~body.moves_carried
    rows: list[tuple[FloatArray, ...]] = []
    follows = np.repeat(np.isin(np.arange(len(body.arms)), which), 6)
    free = body.moves[which].any(axis=0)
    for configuration in q:
        state = body.at(configuration)
        alone = [manipulability(state.J[6 * a : 6 * a + 6][:, arm_columns[a]]) for a in which]
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
    return replace(samples, least=_least_distances(context, samples, rotation))


def _least_distances(context: PathContext, samples: PathSamples, R: FloatArray) -> FloatArray:
    """Compute the least elbow distances from critical points [m], shape (k, m).

    Args:
        context: the job.
        samples: the followed path, with elbows on the axes of the arms' fourth joints, where springs pull.
        R: rotations of the tools, shape (k, m, 3, 3).
    """
    model, q, distances = context.model, samples.position, []
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
        distances.append(
            least_elbow_distance(arm.closed_form, product(turned, T.rotation), flange, point, along)
        )
    return np.stack(distances, axis=1)


def path_curves(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Compute curves of every path for a comparison of methods, JSON-ready, at CURVE instants.

    Contraction forces where the file gives critical points, manipulability of each arm and of all tools together.

    Args:
        schedule: the plan.
        job: its job.
    """
    curves = []
    for path in path_samples(schedule, job):
        rows = np.linspace(0, len(path.time) - 1, CURVE).round().astype(int)
        forces = path.force if path.work.critical_points else np.empty((len(path.time), 0))
        curves.append(
            {
                "task": path.task,
                "time": path.time[rows].tolist(),
                "force": {
                    arm: f[rows].tolist() for arm, f in zip(path.arms, forces.T, strict=False)
                },
                "manipulability": {
                    arm: values[rows].tolist()
                    for arm, values in zip(path.arms, path.arm_manipulability.T, strict=True)
                },
                "manipulability_together": path.joint_manipulability[rows].tolist(),
            }
        )
    return curves


def path_measures(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Measure every path, JSON-ready [m, rad, s].

    Args:
        schedule: the plan, with its verification if there is one.
        job: its job.
    """
    samples = path_samples(schedule, job)
    if not samples:
        return []
    model = ToolModel(schedule)
    robot = job.cell.robot
    measures = []
    for path in samples:
        segments = [s for s in schedule.segments if s.kind == "path" and s.task == path.task]
        along = [along_path(schedule, model, s, path.work.paths[s.arm]) for s in segments]
        idle = {j for arm in robot.arms if arm.name not in path.arms for j in arm.joints}
        counted = [k for k, joint in enumerate(robot.joints) if joint not in idle]
        numbers = [k for k, stage in enumerate(schedule.stages) if path.task in stage.tasks]
        measures.append(
            {
                "task": path.task,
                "method": path.method,
                "arms": list(path.arms),
                "duration": float(path.time[-1]),
                "length": path.work.length,
                "tool_error": max(float(motion.distance.max()) for motion in along),
                "tool_angle_error": max(float(motion.angle.max()) for motion in along),
                "rounded_corners": [
                    piece.left_by
                    for curve in path.work.paths.values()
                    for piece in curve.pieces
                    if isinstance(piece, RoundedCorner)
                ],
                "elbow_distance": dict(
                    zip(path.arms, path.distance.mean(axis=0).tolist(), strict=True)
                ),
                "least_elbow_distance": None
                if path.least is None
                else dict(zip(path.arms, path.least.mean(axis=0).tolist(), strict=True)),
                "manipulability": dict(
                    zip(path.arms, path.arm_manipulability.mean(axis=0).tolist(), strict=True)
                ),
                "manipulability_together": float(path.joint_manipulability.mean()),
                "least_manipulability_together": float(path.joint_manipulability.min()),
                **joint_use(job, path.position, path.velocity, counted),
                "clearance": least_clearance(schedule, numbers),
            }
        )
    return measures


MEASURES = KindMeasures(
    "work",
    {"paths": path_measures},
    path_lines,
    {"paths": path_measures, "path_curves": path_curves},
    paths_table,
)


THIRDS = np.arange(3) * (TURN / 3.0)
"""Arm angles that determine a sinusoid of the arm angle [rad]."""


def least_elbow_distance(
    arm: SrsArm, R: FloatArray, p: FloatArray, point: FloatArray, along: float = 0.0
) -> FloatArray:
    """Compute the least elbow distance from a point within joint limits [m], shape (k,).

    The elbow is on a circle about the line from shoulder to wrist, so that its squared distance from a point is
    a + b cos psi + c sin psi: its minimum is that of the sinusoid, or at an end of the arm angle interval within joint
    limits. Infinite where that is empty.

    Args:
        arm: the arm and its limits.
        R: flange rotations in the base frame, shape (k, 3, 3).
        p: flange positions in the base frame [m], shape (k, 3).
        point: in the base frame [m], shape (k, 3).
        along: offset of the elbow point along the axis of joint 4 [m].
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
    distances: FloatArray = np.sqrt(np.maximum(least, 0.0))
    return distances
