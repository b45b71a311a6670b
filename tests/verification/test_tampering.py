"""Schedules that somebody has tampered with: what is not sound never passes, whatever the file calls it.

Every case is a plan of some kind with its job. Half of them are spoilt: the job has a small ball at the middle of a
solid that moves, away from all lines. Such a plan is unsound, however its segments, stages and figures are rewritten.
Of the others motion and events are tampered with; what then passes has to be the same motion with events that an
oracle of its own (pinocchio, sums over instants, no part of the verifier) finds right.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import cell_solids
from dualarm_cli.errors import InputError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Obstacle
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

KINDS = ("transfer", "approach", "dwell", "retract", "wait", "return", "path", "seam")
REASONS = ("", "platform", "partner", "shared_zone", "after", "window", "buffer", "conveyor", "end")
PATH = """\
dualarm: tasks/1
cell: cell.yaml
start: home
tasks:
  - id: trace
    path:
      arm: left
      redundancy: arm_angle
      speed: 100 mm/s
      through:
        - {xyz: [0.52, 0.36, 0.98], rpy: [180 deg, 0, 0]}
        - {xyz: [0.57, 0.36, 0.98]}
"""
SEAM = """\
dualarm: tasks/1
cell: cell.yaml
start: home
tasks:
  - id: weld
    coordinate:
      master: left
      slave: right
      curve: {kind: line, start: [-30 mm, 0, 0], end: [30 mm, 0, 0]}
      part: {xyz: [0, 0, 200 mm]}
      tool: {free: spin, tilt: 10 deg}
      speed: 100 mm/s
      slower: allowed
      entry: {approach: 20 mm, dwell: 0.3 s}
      exit: {dwell: 0.3 s, retract: 20 mm}
"""
CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 100 mm]}, shapes: [{capsule: {radius: 20 mm, length: 40 mm}, xyz: [0, 0, 40 mm]}]}
  right: {tcp: {xyz: [0, 0, 200 mm]}, shapes: [{capsule: {radius: 20 mm, length: 120 mm}, xyz: [0, 0, 90 mm]}]}
"""
EXAMPLES = {
    "paired": ("04_packing", ("left[1,1]", "right[1,1]"), {}),
    "free": ("12_chute", ("load-1", "unload-1"), {}),
    "handover": ("13_hand_over", ("flip-1",), {}),
    "tools": ("14_two_grippers", ("plate-1", "screw-3"), {"order": "given"}),
    "conveyor": ("15_conveyor", ("part-1", "part-2"), {}),
}
"""Folder, tasks and changes of jobs out of the shipped ones."""
QUICK = PlanSettings(effort="quick")


def _written(folder, tasks):
    """The job of a task file in a new folder."""
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(tasks)
    return load_job(folder / "tasks.yaml")


@pytest.fixture(scope="module")
def cases(tasks_folder, tmp_path_factory):
    """Jobs and plans by their kind, each planned once."""
    found: dict[str, SimpleNamespace] = {}

    def case(kind):
        if kind not in found:
            if kind in EXAMPLES:
                name, ids, changes = EXAMPLES[kind]
                job = load_job(tasks_folder / name / "tasks.yaml")
                tasks = tuple(t for t in job.tasks if t.id in ids)
                job = replace(job, tasks=tasks, **changes)
            else:
                text = {"path": PATH, "seam": SEAM}[kind]
                job = _written(tmp_path_factory.mktemp(kind), text)
            schedule = plan_without_bound(job, QUICK)
            found[kind] = SimpleNamespace(job=job, schedule=schedule)
        return found[kind]

    return case


# What is true of a motion, by other means than the verifier's.


class Oracle:
    """Where the solids and the tools of a job's robot are."""

    def __init__(self, job, joints):
        """Takes robot, base and tools from the job alone."""
        self.job, self.model = job, pin.buildModelFromXML(job.cell.robot.urdf)
        self.data = self.model.createData()
        self.order = [joints.index(name) for name in self.model.names[1:]]
        self.solids = cell_solids(job.cell, self.model, job.carried())

    def tool(self, arm, q):
        """The tool centre point of an arm in the world."""
        flange = next(a.flange for a in self.job.cell.robot.arms if a.name == arm)
        pin.framesForwardKinematics(self.model, self.data, q[self.order])
        pose = self.data.oMf[self.model.getFrameId(flange, pin.FrameType.BODY)]
        return self.job.cell.base * pose * self.job.cell.tools[arm].tcp

    def centre(self, solid, q):
        """The middle of a solid in the world [m]."""
        pin.forwardKinematics(self.model, self.data, q[self.order])
        solid.geometry.computeLocalAABB()
        middle = solid.pose.act(np.asarray(solid.geometry.aabb_center).ravel())
        return self.job.cell.base.act(self.data.oMi[solid.joint].act(middle))

    def depth(self, solid, q, ball):
        """How far a solid reaches into a ball in the world [m]."""
        pin.forwardKinematics(self.model, self.data, q[self.order])
        pose = self.job.cell.base * self.data.oMi[solid.joint] * solid.pose
        ask, answer = coal.DistanceRequest(), coal.DistanceResult()
        centre, radius = ball
        one = coal.Transform3s(pose.rotation, pose.translation)
        other = coal.Transform3s(np.eye(3), centre)
        coal.distance(solid.geometry, one, coal.Sphere(radius), other, ask, answer)
        return -answer.min_distance


def holds(job, schedule, solid, time):
    """Whether a solid is there at a time, away from the lines of its carrier: by events, half a second off each."""
    near = [e for e in schedule.events if e.arm in (solid.carrier, "") or not solid.carrier]
    if any(abs(time - e.time) < 0.5 + e.dwell for e in near):
        return False
    if not solid.carrier:
        return True
    own = sorted((e for e in schedule.events if e.arm == solid.carrier), key=lambda e: e.time)
    held = job.held_at_start(solid.carrier)
    tasks = {task.id: task for task in job.tasks if task.arm in (solid.carrier, "any")}
    for event in own:
        if event.time > time:
            break
        if event.action in ("take_tool", "leave_tool"):
            return False  # which one it is needs more than this
        held = tasks[event.task].held_after(event.action)
    names = job.cell.all_held(solid.carrier)
    return solid.is_held(names[held])


def spoilt(case, rng):
    """The job with a ball at the middle of a solid that is there at some instant away from lines, and the depth."""
    job, schedule = case.job, case.schedule
    oracle = Oracle(job, schedule.trajectory.joints)
    moving = [s for s in oracle.solids if s.joint != 0 and "base" not in s.body]
    carried = [s for s in moving if s.carrier or s.body.endswith("_tool")]
    for _ in range(2000):
        time = float(rng.uniform(0.0, schedule.duration))
        some = carried if carried and rng.random() < 0.7 else moving
        solid = some[rng.integers(len(some))]
        if not holds(job, schedule, solid, time):
            continue
        [q] = schedule.trajectory.at(np.array([time]))[0]
        centre = oracle.centre(solid, q)
        depth = oracle.depth(solid, q, (centre, 0.004))
        if depth < 2e-3:
            continue
        shape = Shape("sphere", (0.004,), pin.SE3(np.eye(3), centre))
        cell = replace(job.cell, obstacles=(*job.cell.obstacles, Obstacle("ball", shape)))
        return replace(job, cell=cell)
    raise AssertionError("no instant at which a ball obstructs an arm")


def same_motion(one, other):
    """Whether two trajectories are the same motion of the same joints, at 50 instants in each interval."""
    if sorted(one.joints) != sorted(other.joints):
        return False
    if abs(one.duration - other.duration) > 1e-8:
        return False
    times = np.linspace(0.0, one.duration, 50 * len(one.time))
    return all(
        np.abs(a - b).max() < 1e-6
        for a, b in zip(one.at(times)[:2], other.select(one.joints).at(times)[:2], strict=True)
    )


def is_sound_motion(case, schedule):
    """Whether a motion that is another one than the plan's is as good, as far as sums over positions tell.

    Rates by differences; tools on lines, in dwells and while they work, and arms that wait, where the plan has them;
    elsewhere no farther from the plan than its least clearance leaves room for.
    """
    old, new = case.schedule.trajectory, schedule.trajectory
    if sorted(old.joints) != sorted(new.joints) or abs(old.duration - new.duration) > 1e-8:
        return False
    new, step = new.select(old.joints), 1e-3
    times = np.arange(0.0, old.duration, step)
    before, after = old.at(times)[0], new.at(times)[0]
    limits = case.job.cell.robot.limits.scaled(case.job.speed).select(old.joints)
    rates = [limits.velocity, limits.acceleration, limits.jerk]
    for order, limit in enumerate(rates, start=1):
        rate = np.abs(np.diff(after, n=order, axis=0)).max(axis=0) / step**order
        if (rate > limit * 1.02).any():
            return False
    oracle = Oracle(case.job, old.joints)
    for s in case.schedule.segments:
        inside = np.flatnonzero((times >= s.start) & (times <= s.end))
        if s.kind in ("transfer", "return") or not len(inside):
            continue
        allowed = 1.1e-4 if s.kind in ("approach", "retract") else 2e-6
        if s.kind == "path":
            allowed = max(t.path.tolerance for t in case.job.tasks if t.path is not None)
        for k in inside[:: max(1, len(inside) // 60)]:
            one, other = (oracle.tool(s.arm, q[k]) for q in (before, after))
            if s.kind == "wait":
                own = [old.joints.index(name) for name in schedule.robot.arms[s.arm].joints]
                apart = np.abs(before[k] - after[k])[own].max()
            else:
                apart = np.abs(pin.log6(one.actInv(other)).vector).max()
            if apart > allowed:
                return False
    margin = min(
        stage.margin for stage in verify(case.schedule, case.job, clearance=True).clearances
    )
    # No point of a robot is farther than two metres from any of its joints' axes.
    return bool(2.0 * np.abs(after - before).sum(axis=1).max() <= margin)


def events_are_right(case, schedule):
    """Whether the events of a schedule are those of the plan it was made of, and true of its motion."""

    def named(events):
        return sorted((e.arm, e.task, e.action) for e in events)

    if named(schedule.events) != named(case.schedule.events):
        return False
    oracle = Oracle(case.job, case.schedule.trajectory.joints)
    was = {(e.arm, e.task, e.action): e for e in case.schedule.events}
    motion = schedule.trajectory.select(case.schedule.trajectory.joints)
    for event in schedule.events:
        key = (event.arm, event.task, event.action)
        stop = case.job.stops_by_key().get(key)
        least = was[key].dwell if stop is None else stop.dwell.total
        if event.dwell < least - 1e-8:
            return False
        off = was[key].pose.actInv(event.pose)
        # The same motion is at the same places: commanded where the plan has it, which is a target of the job.
        if not event.moves and np.linalg.norm(pin.log6(off).vector) > 3e-6:
            return False
        velocity = np.array(event.velocity)
        for t in np.linspace(event.time, event.time + event.dwell, 40):
            tool = oracle.tool(event.arm, motion.at(np.array([t]))[0][0])
            due = event.pose.translation + (t - event.time) * velocity
            turned = np.linalg.norm(pin.log3(event.pose.rotation.T @ tool.rotation))
            if np.linalg.norm(tool.translation - due) > 3e-6 or turned > 3e-6:
                return False
    order = [
        [e.task for e in sorted(s.events, key=lambda e: e.time)] for s in (schedule, case.schedule)
    ]
    return order[0] == order[1] or case.job.mode == "free"


# Ways to tamper.


def _at(rows, k, **changes):
    return (*rows[:k], replace(rows[k], **changes), *rows[k + 1 :])


def _segments(case, rng, schedule):
    """A change of the list of segments."""
    rows = schedule.segments
    if not rows:
        return schedule
    k, way = int(rng.integers(len(rows))), int(rng.integers(9))
    if way == 0:
        rows = _at(rows, k, kind=KINDS[rng.integers(len(KINDS))])
    elif way == 1:
        shift = float(rng.choice([-0.3, -1e-3, 1e-3, 0.3]))
        rows = _at(rows, k, **{("start", "end")[rng.integers(2)]: max(0.0, rows[k].start + shift)})
    elif way == 2:
        rows = (*rows[:k], *rows[k + 1 :])
    elif way == 3:
        rows = (*rows, replace(rows[k], kind=KINDS[rng.integers(len(KINDS))]))
    elif way == 4:
        n = int(rng.integers(len(rows)))
        one, other = rows[k], rows[n]
        rows = _at(
            rows, k, kind=other.kind, task=other.task, action=other.action, dwell=other.dwell
        )
        rows = _at(rows, n, kind=one.kind, task=one.task, action=one.action, dwell=one.dwell)
    elif way == 5:
        other = rows[rng.integers(len(rows))]
        rows = _at(rows, k, task=other.task, action=other.action)
    elif way == 6:
        rows = _at(rows, k, reason=REASONS[rng.integers(len(REASONS))], dwell=Dwell(0.1))
    elif way == 7:
        # Neighbours with their border elsewhere, the names of a line on what comes before it.
        after = [
            n for n, s in enumerate(rows) if s.arm == rows[k].arm and s.start >= rows[k].end - 1e-9
        ]
        if after:
            n = min(after, key=lambda n: rows[n].start)
            border = float(rng.uniform(rows[k].start, rows[n].end))
            rows = _at(rows, k, end=border)
            rows = _at(rows, n, start=border)
    else:
        # All that moves to one stop is called the same.
        own = (rows[k].arm, rows[k].task, rows[k].action)
        kind = KINDS[rng.integers(len(KINDS))]
        rows = tuple(replace(s, kind=kind) if (s.arm, s.task, s.action) == own else s for s in rows)
    return replace(schedule, segments=rows)


def _records(case, rng, schedule):
    """A change of stages, figures, or of what is stated of the robot."""
    way = int(rng.integers(8))
    robot, stages = schedule.robot, schedule.stages
    if way < 3 and stages:
        k = int(rng.integers(len(stages)))
        other = stages[rng.integers(len(stages))]
        changes = [
            {"start": other.start, "end": other.end},
            {"tasks": other.tasks, "arm": other.arm},
            {"end": float(rng.uniform(stages[k].start, schedule.duration)), "bottleneck": "none"},
        ][way]
        return replace(schedule, stages=_at(stages, k, **changes))
    if way == 3:
        return replace(schedule, lower_bound=0.0, grid_gap=0.0, clearance_cost=0.0)
    if way == 4:
        n = len(robot.limits.joints)
        wide = JointLimits(
            robot.limits.joints, *(np.full(n, x) for x in (-9.0, 9.0, 99.0, 999.0, 9e4)), ("x",) * n
        )
        return replace(schedule, robot=replace(robot, limits=wide, tool_speed=None))
    if way == 5:
        return replace(schedule, robot=replace(robot, base=pin.SE3.Identity(), platform=()))
    if way == 6:
        arms = {
            name: replace(arm, tcp=pin.SE3.Identity(), joints=())
            for name, arm in robot.arms.items()
        }
        return replace(schedule, robot=replace(robot, arms=arms))
    names = rng.permutation(len(schedule.trajectory.joints)).tolist()
    joints = [schedule.trajectory.joints[k] for k in names]
    return replace(schedule, motion=JointMotion.of(schedule.trajectory.select(joints)))


def _events(case, rng, schedule):
    """A change of the events."""
    rows = schedule.events
    k, way = int(rng.integers(len(rows))), int(rng.integers(9))
    event, other = rows[k], rows[rng.integers(len(rows))]
    if way == 0:
        shift = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-5, 0))
        return replace(schedule, events=_at(rows, k, time=max(0.0, event.time + shift)))
    if way == 1:
        return replace(schedule, events=(*rows[:k], *rows[k + 1 :]))
    if way == 2:
        return replace(schedule, events=(*rows, event))
    if way == 3:
        rows = _at(rows, k, time=other.time, pose=other.pose, dwell=other.dwell)
        return replace(schedule, events=rows)
    if way == 4:
        rows = _at(rows, k, task=other.task, action=other.action)
        return replace(schedule, events=rows)
    if way == 5:
        by = rng.normal(size=3) * 10.0 ** rng.uniform(-5, -1)
        pose = pin.SE3(event.pose.rotation, event.pose.translation + by)
        return replace(schedule, events=_at(rows, k, pose=pose))
    if way == 6:
        turn = pin.exp3(rng.normal(size=3) * 10.0 ** rng.uniform(-4, -1))
        pose = pin.SE3(event.pose.rotation @ turn, event.pose.translation)
        return replace(schedule, events=_at(rows, k, pose=pose))
    if way == 7:
        factor = float(rng.choice([0.0, 0.5, 0.99, 1.01, 2.0, -1.0]))
        return replace(schedule, events=_at(rows, k, dwell=event.dwell * factor))
    return replace(schedule, events=rows[::-1])


def _knots(case, rng, schedule):
    """A change of the motion."""
    motion = schedule.trajectory
    t, q, v, a = (
        np.array(x) for x in (motion.time, motion.position, motion.velocity, motion.acceleration)
    )
    k, j, way = int(rng.integers(len(t))), int(rng.integers(q.shape[1])), int(rng.integers(9))
    off = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-4, 0))
    joints = motion.joints
    if way == 0:
        q[k, j] += off
    elif way == 1:
        v[k, j] += off
    elif way == 2:
        a[k, j] += 100.0 * off
    elif way == 3:
        q[:, j] += off
    elif way == 4:
        t, v, a = t * 0.9, v / 0.9, a / 0.81
    elif way == 5:
        joints = tuple(reversed(joints))
    elif way == 6 and 0 < k < len(t) - 1:
        t, q, v, a = (np.delete(x, k, axis=0) for x in (t, q, v, a))
    elif way == 7:
        q, v, a = q[::-1].copy(), -v[::-1], a[::-1].copy()
        t = t[-1] - t[::-1]
    else:
        # Knots that follow one another apart by a smooth swing of one joint, all rates with it.
        b = float(rng.uniform(0.0, t[-1] - 0.2))
        t = np.unique(np.concatenate([t, np.linspace(b, b + 0.2, 401)]))
        q, v, a = (np.array(x) for x in motion.at(t))
        x = np.clip((t - b) / 0.2, 0.0, 1.0)
        height = 10.0 ** rng.uniform(-5, -2)
        q[:, j] += height * (1 - np.cos(2 * np.pi * x)) ** 2
        s, c = np.sin(2 * np.pi * x), np.cos(2 * np.pi * x)
        w = 2 * np.pi / 0.2
        v[:, j] += 2 * height * w * (1 - c) * s
        a[:, j] += 2 * height * w**2 * (s * s + (1 - c) * c)
    return replace(schedule, motion=JointMotion.of(Trajectory(joints, t, q, v, a)))


def verdict(schedule, job, *, clearance=True):
    """Whether it passes; that nothing can be measured is no pass."""
    try:
        return verify(schedule, job, clearance=clearance).passed
    except InputError:
        return False


def relabelled(schedule):
    """The schedule with each segment called every other thing, one at a time.

    An arm that stands may well wait, and while the other one works a way to no task may be a return or a transfer.
    """
    for k, segment in enumerate(schedule.segments):
        joints = schedule.robot.arms[segment.arm].joints
        within = schedule.trajectory.select(joints).at(np.linspace(segment.start, segment.end, 50))[
            0
        ]
        stands = np.abs(within - within[0]).max() < 1e-6
        alike = {"wait", "transfer"} if stands else {"return", "transfer"}
        for kind in KINDS:
            if kind != segment.kind and {kind, segment.kind} != alike:
                yield replace(schedule, segments=_at(schedule.segments, k, kind=kind))


ALL = (*EXAMPLES, "path", "seam")


def _try_labels(case, seed, count):
    """Tampers with the labels of a spoilt plan; returns how many variants were refused, and what passed."""
    rng = np.random.default_rng(seed)
    job = spoilt(case, rng)
    assert not verdict(case.schedule, job)
    passed = []
    for n in range(count):
        schedule = case.schedule
        for _ in range(int(rng.integers(1, 5))):
            schedule = (_segments if rng.random() < 0.8 else _records)(case, rng, schedule)
        if verdict(schedule, job):
            passed.append(n)
    return passed


def _try_motion(case, seed, count):
    """Tampers with events and motion of a plan; returns which variants pass though the oracle does not agree."""
    rng = np.random.default_rng(seed)
    wrong, sound = [], 0
    for n in range(count):
        way = rng.random()
        schedule = (_events if way < 0.6 else _knots)(case, rng, case.schedule)
        if way > 0.9:
            schedule = _segments(case, rng, _events(case, rng, schedule))
        if verdict(schedule, case.job):
            sound += 1
            same = same_motion(case.schedule.trajectory, schedule.trajectory)
            if not (same or is_sound_motion(case, schedule)) or not events_are_right(
                case, schedule
            ):
                wrong.append((n, same))
    return wrong, sound


@pytest.mark.parametrize("kind", ["paired", "handover"])
def test_no_relabelling_of_a_spoilt_plan_passes(cases, kind):
    """A few random ones."""
    assert _try_labels(cases(kind), 1, 12) == []


@pytest.mark.parametrize("kind", ["paired", "handover"])
def test_events_and_motion_that_pass_are_true(cases, kind):
    """A few random ones; the plan itself passes."""
    case = cases(kind)
    assert verdict(case.schedule, case.job)
    assert _try_motion(case, 2, 25)[0] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL)
def test_every_single_relabelling_is_found(cases, kind):
    """Every segment called every other thing: the name itself is a finding, of a sound plan too."""
    case = cases(kind)
    passing = [
        n
        for n, schedule in enumerate(relabelled(case.schedule))
        if verdict(schedule, case.job, clearance=False)
    ]
    assert passing == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 8))
@pytest.mark.parametrize("kind", ALL)
def test_no_relabelling_of_a_spoilt_plan_passes_ever(cases, kind, seed):
    """25 random ones of each kind with each of five seeds."""
    assert _try_labels(cases(kind), seed, 25) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8, 13))
@pytest.mark.parametrize("kind", ALL)
def test_events_and_motion_that_pass_are_always_true(cases, kind, seed):
    """25 random ones of each kind with each of five seeds."""
    case = cases(kind)
    assert verdict(case.schedule, case.job)
    assert _try_motion(case, seed, 25)[0] == []
