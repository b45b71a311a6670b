"""Joint torques of the whole motion by inverse dynamics, with tools and carried parts.

The recursive Newton-Euler algorithm of pinocchio over the whole robot, so that a platform and both arms count together
([Featherstone2008] §5.3). Between knots torques are smooth: instants at knots, on both sides of a jump, and every few
milliseconds between them miss less than the tolerance of a peak.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import cos, sin
from dualarm_cli.geometry.products import product
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.notes import listed
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.criteria import NO_TASKS, judge, not_checked
from dualarm_cli.verification.measuring.holding_spans import carrying_spans
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.tool_checks import Worst


@dataclass(frozen=True)
class TorqueSampling:
    """Instants and postures at which torques are computed."""

    step: float = 0.008
    """Largest distance of two instants [s]."""
    at_rest: float = 1e-6
    """Speed below which Coulomb friction may have either sign [rad/s or m/s]."""
    postures: int = 400
    """Number of random postures in which the empty robot has to hold itself."""
    block: int = 20_000
    """Maximum number of instants measured at once, to limit memory."""


SAMPLING = TorqueSampling()
PLACEHOLDERS = 4
"""Least number of links whose equal masses count as placeholders."""


@dataclass(frozen=True)
class Payload:
    """Part or changed tool that an arm carries."""

    carrier: str
    """Arm."""
    held: Held
    """The part in its tool, or the tool without one."""

    @property
    def body(self) -> str:
        """Name of the part; empty for a tool."""
        return self.held.part

    @property
    def tool(self) -> str:
        """Changed tool that it is, or that grips it; empty for none."""
        return self.held.tool

    @property
    def bolted(self) -> bool:
        """Whether it is a changed tool."""
        return not self.held.part


class InverseDynamics:
    """Joint torques of a robot with its tools, by pinocchio.

    Joints are in the robot's order. Sines are the project's own, as those of the machine's C library depend on the
    processor: revolute joints are unbounded ones for pinocchio, which takes their cosine and sine.
    """

    def __init__(self, cell: Cell, *, empty: bool = False) -> None:
        """Build the model; an empty one has no tools.

        Args:
            cell: robot, base and tools.
            empty: flag of a robot without tools.
        """
        robot = cell.robot
        urdf = robot.urdf.replace('type="revolute"', 'type="continuous"')
        self._model: pin.Model = pin.buildModelFromXML(urdf)
        gravity = product(cell.base.rotation.T, self._model.gravity.linear)
        self._model.gravity.linear = gravity
        self._order = [robot.joints.index(name) for name in self._model.names[1:]]
        self._turns = np.array(self._model.nqs)[1:] == 2
        self._first = np.array(self._model.idx_qs)[1:]
        self._cell, self._torques = cell, robot.torques
        if not empty:
            for arm in robot.arms:
                self._add(self._model, arm.name, cell.tools[arm.name].inertia)
        self._models: dict[tuple[Payload, ...], tuple[pin.Model, pin.Data]] = {}

    @property
    def masses(self) -> FloatArray:
        """Mass that each joint moves up to the next joint, in the robot's order [kg], (n,)."""
        masses = np.empty(len(self._order))
        masses[self._order] = [inertia.mass for inertia in self._model.inertias[1:]]
        return masses

    def torques(
        self, q: FloatArray, v: FloatArray, a: FloatArray, loads: Sequence[Payload] = ()
    ) -> FloatArray:
        """Compute torques of joints [N m or N], shape (k, n).

        Args:
            q: positions [rad or m], shape (k, n).
            v: velocities, shape (k, n).
            a: accelerations, shape (k, n).
            loads: what the arms carry.
        """
        model, data = self._loaded(tuple(loads))
        q_own, v_own, a_own = (np.take(x, self._order, axis=1) for x in (q, v, a))
        coordinates = np.empty((len(q), model.nq))
        coordinates[:, self._first] = np.where(self._turns, cos(q_own), q_own)
        coordinates[:, self._first[self._turns] + 1] = sin(q_own[:, self._turns])
        ordered = np.empty(q.shape)
        for row, state in enumerate(zip(coordinates, v_own, a_own, strict=True)):
            ordered[row] = pin.rnea(model, data, *state)
        links = np.empty(q.shape)
        links[:, self._order] = ordered
        joint = self._torques
        links += joint.rotor * a + joint.viscous * v - joint.spring - joint.stiffness * q
        sign = np.where(np.abs(v) > SAMPLING.at_rest, np.sign(v), np.sign(links))
        return links + joint.coulomb * sign

    def _loaded(self, loads: tuple[Payload, ...]) -> tuple[pin.Model, pin.Data]:
        """Build the model with loads, once for each combination."""
        if loads not in self._models:
            model = pin.Model(self._model)
            for load in loads:
                self._add(model, load.carrier, self._cell.load_inertia(load.carrier, load.held))
            self._models[loads] = model, model.createData()
        return self._models[loads]

    def _add(self, model: pin.Model, arm: str, inertia: pin.Inertia) -> None:
        """Add an inertia in the flange frame of an arm."""
        flange = self._cell.robot.arm(arm).flange
        frame = model.frames[model.getFrameId(flange, pin.FrameType.BODY)]
        model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)


def check_torques(schedule: Schedule, job: Job | None) -> list[Check]:
    """Check torques over the whole motion against efforts, and effective ones against rated.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks, each with the arm that did it; None checks nothing.
    """
    if job is None:
        return [not_checked("torque", NO_TASKS)]
    cell = job.cell
    why = why_unknown(cell)
    if why or cell.torque == "ignored":
        return [not_checked("torque", why or "the cell file ignores torques (torque: ignored)")]
    peaks, effective = measured_torques(schedule, job)
    worst, overload = Worst(), _overload(cell)
    for joint, peak, effort in zip(
        cell.robot.joints, peaks, cell.robot.torques.effort, strict=True
    ):
        worst.add(peak.torque / float(effort), peak.place(joint, float(effort)))
    if overload or cell.torque == "checked":
        reason = overload or "torques are no limit in the cell file (torque: checked)"
        detail = f"{reason}; most is {worst.value:.0%} of the effort, {worst.where}"
        return [replace(not_checked("torque", detail), measured=round(worst.value, 12))]
    checks = [worst.judge("torque", 1.0 + TOL.torque_slack)]
    rated = cell.robot.torques.rated
    if np.isfinite(rated).any():
        column = int(np.argmax(effective / rated))
        where = f"{cell.robot.joints[column]}, {effective[column]:.4g} of {rated[column]:.4g}"
        checks.append(judge("rated_torque", float(effective[column] / rated[column]), 1.0, where))
    return checks


@dataclass(frozen=True)
class Peak:
    """Largest torque of a joint over a motion."""

    torque: float
    """Its magnitude [N m or N]."""
    time: float
    """Time [s]."""
    loads: tuple[Payload, ...]
    """Loads of the arms then."""
    unit: str
    """Unit of the torque."""

    def place(self, joint: str, effort: float) -> str:
        """Describe the peak: joint, time, torque, limit and loads."""
        text = f"{joint} at {self.time:.3f} s: {self.torque:.4g} of {effort:.4g} {self.unit}"
        return f"{text}, carrying {carried(self.loads)}" if self.loads else text


def carried(loads: Sequence[Payload]) -> str:
    """Name loads with their arms; empty without loads."""
    return " and ".join(f"{load.carrier} {load.held.name}" for load in loads)


@dataclass(frozen=True)
class TorqueSamples:
    """Torques of all joints at instants with the same loads."""

    time: FloatArray
    """Times [s], shape (k,)."""
    weight: FloatArray
    """Trapezoidal weights of integrals over time [s], shape (k,)."""
    position: FloatArray
    """Positions [rad or m], shape (k, n)."""
    velocity: FloatArray
    """Velocities, shape (k, n)."""
    torque: FloatArray
    """Torques [N m or N], shape (k, n)."""
    loads: tuple[Payload, ...]
    """Loads of the arms."""


def torque_samples(
    dynamics: InverseDynamics, schedule: Schedule, job: Job
) -> Iterator[TorqueSamples]:
    """Compute torques over a whole motion, in parts with the same loads.

    Args:
        dynamics: of the job's cell.
        schedule: with the events of all arms.
        job: each task with the arm that did it.
    """
    trajectory = schedule.trajectory.select(job.cell.robot.joints)
    loads, spans = _loads(schedule, job)
    intervals = len(trajectory.time) - 1
    for first in range(0, max(intervals, 1), SAMPLING.block):
        part = slice(first, min(first + SAMPLING.block, intervals))
        time, weight, (q, v, a) = _instants(trajectory, part)
        # At the ends of a span the arm is at rest; there the load counts.
        on_arm = np.array(
            [_inside(time, load_spans) for load_spans in spans], dtype=np.bool_
        ).reshape(len(loads), len(time))
        for combination in np.unique(on_arm, axis=1).T:
            rows = np.flatnonzero((on_arm == combination[:, None]).all(axis=0))
            held = tuple(load for load, on in zip(loads, combination, strict=True) if on)
            torques = dynamics.torques(q[rows], v[rows], a[rows], held)
            yield TorqueSamples(time[rows], weight[rows], q[rows], v[rows], torques, held)


def measured_torques(schedule: Schedule, job: Job) -> tuple[list[Peak], FloatArray]:
    """Measure the peak and the effective (RMS) torque of every joint.

    Args:
        schedule: with the events of all arms.
        job: each task with the arm that did it.

    Returns:
        Peaks by joint, and effective torques over the motion [N m or N], shape (n,).
    """
    robot = job.cell.robot
    units = ["N" if joint in robot.sliding else "Nm" for joint in robot.joints]
    peaks, squares = [Peak(0.0, 0.0, (), unit) for unit in units], np.zeros(len(units))
    for samples in torque_samples(InverseDynamics(job.cell), schedule, job):
        torques = np.abs(samples.torque)
        squares += product(samples.weight, np.square(torques))
        for joint, row in enumerate(torques.argmax(axis=0)):
            if not torques[row, joint] <= peaks[joint].torque:
                value, at = float(torques[row, joint]), float(samples.time[row])
                peaks[joint] = Peak(value, at, samples.loads, units[joint])
    return peaks, np.sqrt(squares / max(schedule.trajectory.duration, 1e-9))


def _instants(
    trajectory: Trajectory, part: slice
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
    """List instants of intervals between knots, both ends of each, with trapezoidal weights.

    Returns:
        Times [s], weights [s], each (k,); positions, velocities and accelerations, each (k, n).
    """
    start = trajectory.time[part]
    length = np.diff(trajectory.time)[part]
    steps = np.maximum(np.ceil(length / SAMPLING.step).astype(np.int64), 1)
    row = np.repeat(np.arange(len(start)), steps + 1)
    place = np.arange(len(row)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
    dt = (length / steps)[row] * place
    weight = (length / steps)[row] * np.where((place == 0) | (place == steps[row]), 0.5, 1.0)
    index, t = row + part.start, dt[:, None]
    q, v, a = (
        x[index] for x in (trajectory.position, trajectory.velocity, trajectory.acceleration)
    )
    jerk = trajectory.jerk[index]
    motion = (
        q + t * (v + t * (a / 2 + t * jerk / 6)),
        v + t * (a + t * jerk / 2),
        a + t * jerk,
    )
    return start[row] + dt, weight, motion


def _loads(schedule: Schedule, job: Job) -> tuple[list[Payload], list[list[tuple[float, float]]]]:
    """List the loads that weigh something, with the spans in which they are carried [s]."""
    loads = [
        Payload(arm.name, held)
        for arm in job.cell.robot.arms
        for held in job.cell.all_held(arm.name).values()
        if held.name and not held.docking
    ]
    # A tool with a part in it is the load of the part, besides that of the tool.
    heavy = [load for load in loads if job.cell.load_inertia(load.carrier, load.held).mass > 0.0]
    return heavy, [carrying_spans(schedule, job, load) for load in heavy]


def _inside(time: FloatArray, spans: Sequence[tuple[float, float]]) -> BoolArray:
    """Check whether instants (k,) [s] are within one of several spans."""
    inside = np.zeros(len(time), dtype=np.bool_)
    for start, end in spans:
        inside |= (time >= start) & (time <= end)
    return inside


def why_unknown(cell: Cell) -> str:
    """Explain why the torques of a robot cannot be computed; empty if they can."""
    robot = cell.robot
    unknown = [
        name
        for name, effort in zip(robot.joints, robot.torques.effort, strict=True)
        if not 0.0 < effort < np.inf
    ]
    if unknown:
        return f"no effort is known of {listed(unknown)}"
    masses = InverseDynamics(cell, empty=True).masses
    light = [name for name, mass in zip(robot.joints, masses, strict=True) if mass <= 0.0]
    if light:
        return f"no mass is known of the links of {listed(light)}"
    if len(masses) >= PLACEHOLDERS and np.ptp(masses) == 0.0:
        return f"the masses are placeholders: every link has {masses[0]:g} kg"
    return ""


def _overload(cell: Cell) -> str:
    """Name the joint that cannot hold the empty robot still; empty if all can.

    The model of such a robot lacks springs, counterweights or true efforts.
    """
    robot, zero = cell.robot, np.zeros((SAMPLING.postures + 1, len(cell.robot.joints)))
    random = np.random.default_rng(0).uniform(size=zero[1:].shape)
    lower, upper = robot.limits.lower, robot.limits.upper
    postures = np.vstack([robot.postures["home"], lower + random * (upper - lower)])
    torques = np.abs(InverseDynamics(cell, empty=True).torques(postures, zero, zero))
    share = (torques / robot.torques.effort).max(axis=0)
    joint = int(np.argmax(share))
    if share[joint] <= 1.0:
        return ""
    return (
        f"the robot's model is incomplete: {robot.joints[joint]} needs {share[joint]:.0%} of its effort to hold the "
        "empty robot still, so springs, counterweights or the true effort are missing"
    )
