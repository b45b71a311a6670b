"""The transfers of dualarm's plans by other planners: time per move and motion time, all in one run.

python -m benchmarks.quality.peers [--stages 24] [--seeds 1 2 3] [--repeats 2]
    [--peers ruckig toppra ompl drake roboplan tesseract] [--efforts quick normal]

The moves are the transfers of random SDA10F sequences of `long_sequences.py`, planned with stops at the outer ends of
lines (`--blend none`), normal effort, and verified with their clearance. Start and goal of all 15 joints are given to
the peers: dualarm has chosen them, together with platform angles and lines, so theirs is the easier question. All have
the same limits and bodies as far as they take them.

Everything runs in one process on one core, with one thread of BLAS. Times are processor times. Preparation (imports,
models, files) is not counted. The time of a move is counted from start and goal to the timed motion. Printed are
medians over all solved moves of all repeats: of the time, with its quartiles; of the motion time divided by that of
dualarm's transfer, with its extremes; of the length of the path divided by that of the straight line. "Free" is how
many of the motions have no collision at 100 instants, of the bodies that dualarm must keep apart. dualarm's own motions
are proven.

Limits are v (velocity), a (acceleration) and j (jerk). Bodies are looked at nowhere, at so many points of the path, or
at such distances along it.

ruckig and toppra come with dualarm. The others are no dependencies of it:

    pip install ompl drake roboplan tesseract-robotics

A peer that is not installed, or that cannot be loaded, is named and left out.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.jobs.long_sequences import write_sequence
from dualarm_cli.collision.solids import cell_solids, geometry_model, pairs_that_must_keep_apart
from dualarm_cli.exporting.cell_urdf import cell_urdf
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
GRID = 100
"""Intervals of toppra's grid."""
STEP = 0.05
"""Distance of neighbouring collision checks of sampling planners, in the norm of all joints [rad]."""
PATIENCE = 5.0
"""How long a sampling planner may look for a path [s]."""
SAMPLES = 100
"""Instants at which a motion is checked for collisions."""
DISTANCES = 40
"""Points of a path at which Drake keeps bodies apart."""


@dataclass(frozen=True)
class Move:
    """One transfer of a plan of dualarm, from rest to rest."""

    start: FloatArray
    """All joints [rad], shape (n,)."""
    goal: FloatArray
    """All joints at the end of their own arm's transfer [rad], shape (n,)."""
    duration: float
    """How long dualarm's transfer takes [s]."""


@dataclass(frozen=True)
class Answer:
    """One move by a peer."""

    spent: Mapping[str, float]
    """Computing time of each step [s]."""
    duration: float
    """Of the motion [s]."""
    position: FloatArray
    """All joints at instants of the motion [rad], shape (k, n)."""


Solve = Callable[[Move], Answer | None]
"""Returns a peer's answer, None where it has none."""


@dataclass(frozen=True)
class Setting:
    """What all peers are given."""

    cell: Cell
    """Robot, tools and obstacles."""
    limits: JointLimits
    """Of all n joints."""

    @cached_property
    def bodies(self) -> Bodies:
        """The bodies for collision checks."""
        return Bodies(self.cell)


class Bodies:
    """Collision checks by pinocchio and coal, of the solids that dualarm must keep apart."""

    def __init__(self, cell: Cell) -> None:
        """Prepares a cell."""
        self._model = pin.buildModelFromXML(cell.robot.urdf)
        solids = cell_solids(cell, self._model, ())
        pairs = pairs_that_must_keep_apart(self._model, solids, cell)
        numbers = [(pair.first, pair.second) for pair in pairs]
        self._geometry = geometry_model(solids, numbers)
        self._data, self._found = self._model.createData(), self._geometry.createData()
        for request, pair in zip(self._found.collisionRequests, pairs, strict=True):
            request.security_margin = pair.required
        joints = [self._model.getJointId(joint) for joint in cell.robot.joints]
        self._columns = [self._model.joints[joint].idx_q for joint in joints]
        self._position = pin.neutral(self._model)
        self.apart = {frozenset((solids[a].body, solids[b].body)) for a, b in numbers}
        """Names of two bodies each that must keep apart."""

    def is_free(self, position: Sequence[float] | FloatArray) -> bool:
        """Returns whether nothing collides at one configuration (n,)."""
        self._position[self._columns] = position
        hit = pin.computeCollisions(
            self._model, self._data, self._geometry, self._found, self._position, True
        )
        return not hit

    def are_free(self, position: FloatArray) -> bool:
        """Returns whether nothing collides at any of k configurations (k, n)."""
        return all(self.is_free(one) for one in position)


class Stopwatch:
    """Time of the steps of an answer."""

    def __init__(self) -> None:
        """Starts it."""
        self.spent: dict[str, float] = {}
        self._begin = time.process_time()

    def lap(self, step: str) -> None:
        """Counts the time since the last lap to a step."""
        now = time.process_time()
        self.spent[step], self._begin = now - self._begin, now


def by_ruckig(setting: Setting) -> Solve:
    """Returns ruckig from state to state: all limits, no bodies."""
    import ruckig

    limits, n = setting.limits, len(setting.limits.joints)
    otg, asked, found = ruckig.Ruckig(n), ruckig.InputParameter(n), ruckig.Trajectory(n)
    asked.max_velocity, asked.max_acceleration = limits.velocity, limits.acceleration
    asked.max_jerk = limits.jerk

    def solve(move: Move) -> Answer | None:
        watch = Stopwatch()
        asked.current_position, asked.target_position = move.start, move.goal
        result = otg.calculate(asked, found)
        watch.lap("timing")
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            return None
        instants = np.linspace(0.0, found.duration, SAMPLES)
        position = np.array([found.at_time(instant)[0] for instant in instants])
        return Answer(watch.spent, found.duration, position)

    return solve


def toppra_timing(limits: JointLimits) -> Callable[[FloatArray], Any]:
    """Returns what times waypoints (k, n) with toppra under velocity and acceleration limits."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    import toppra
    import toppra.algorithm
    import toppra.constraint

    rates = [np.column_stack([-rate, rate]) for rate in (limits.velocity, limits.acceleration)]
    constraints = [
        toppra.constraint.JointVelocityConstraint(rates[0]),
        toppra.constraint.JointAccelerationConstraint(rates[1]),
    ]

    def timed(waypoints: FloatArray) -> Any:
        # toppra is at its best where the path parameter has the joints' size.
        length = np.linalg.norm(np.diff(waypoints, axis=0), axis=1).cumsum()
        path = toppra.SplineInterpolator(np.append(0.0, length), waypoints)
        solver = toppra.algorithm.TOPPRA(
            constraints,
            path,
            gridpoints=np.linspace(0.0, length[-1], GRID + 1),
            solver_wrapper="seidel",
            parametrizer="ParametrizeConstAccel",
        )
        return solver.compute_trajectory(0, 0)

    return timed


def by_toppra(setting: Setting) -> Solve:
    """Returns toppra on the straight line between start and goal: no jerk limits, no bodies."""
    timed = toppra_timing(setting.limits)

    def solve(move: Move) -> Answer | None:
        watch = Stopwatch()
        motion = timed(np.array([move.start, move.goal]))
        watch.lap("timing")
        return None if motion is None else sampled(watch, motion, motion.duration)

    return solve


def sampled(watch: Stopwatch, motion: Callable[[FloatArray], FloatArray], end: float) -> Answer:
    """Returns the answer of a motion that is a function of time [s]."""
    return Answer(watch.spent, float(end), np.asarray(motion(np.linspace(0.0, end, SAMPLES))))


def by_ompl(setting: Setting) -> Solve:
    """Returns OMPL's RRTConnect, its path simplification, and toppra: no jerk limits, bodies sampled."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_ERROR)
    util.RNG.setSeed(1)
    timed, limits, bodies = toppra_timing(setting.limits), setting.limits, setting.bodies
    n = len(limits.joints)
    bounds = base.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(limits.lower[joint]))
        bounds.setHigh(joint, float(limits.upper[joint]))

    def solve(move: Move) -> Answer | None:
        watch = Stopwatch()
        space = base.RealVectorStateSpace(n)
        space.setBounds(bounds)
        setup = geometric.SimpleSetup(space)
        setup.setStateValidityChecker(lambda state: bodies.is_free([state[k] for k in range(n)]))
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(STEP / space.getMaximumExtent())
        setup.setPlanner(geometric.RRTConnect(information))
        ends = [space.allocState(), space.allocState()]
        for state, position in zip(ends, (move.start, move.goal), strict=True):
            for joint in range(n):
                state[joint] = float(position[joint])
        setup.setStartAndGoalStates(*ends)
        setup.solve(PATIENCE)
        watch.lap("path")
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        geometric.PathSimplifier(information).simplifyMax(path)
        watch.lap("simplification")
        states = [path.getState(k) for k in range(path.getStateCount())]
        motion = timed(np.array([[state[joint] for joint in range(n)] for state in states]))
        watch.lap("toppra")
        return None if motion is None else sampled(watch, motion, motion.duration)

    return solve


def by_drake(points: int, jerk: bool, distances: int) -> Callable[[Setting], Solve]:
    """Returns Drake's KinematicTrajectoryOptimization with SNOPT, from a straight line as the first guess.

    Args:
        points: control points of the cubic B-spline.
        jerk: whether jerk is limited, and acceleration zero at both ends.
        distances: at how many points of the path bodies are kept apart.
    """

    def prepared(setting: Setting) -> Solve:
        from pydrake.math import BsplineBasis
        from pydrake.planning import KinematicTrajectoryOptimization
        from pydrake.solvers import SnoptSolver
        from pydrake.trajectories import BsplineTrajectory

        limits = setting.limits
        rest: FloatArray = np.zeros(len(limits.joints))
        distance = DrakeDistance(setting) if distances else None

        def solve(move: Move) -> Answer | None:
            watch = Stopwatch()
            line = [point[:, None] for point in np.linspace(move.start, move.goal, points)]
            problem = KinematicTrajectoryOptimization(
                BsplineTrajectory(BsplineBasis(4, points), line)
            )
            problem.AddDurationCost(1.0)
            problem.AddDurationConstraint(0.01, 60.0)
            problem.AddPositionBounds(limits.lower, limits.upper)
            problem.AddVelocityBounds(-limits.velocity, limits.velocity)
            problem.AddAccelerationBounds(-limits.acceleration, limits.acceleration)
            if jerk:
                problem.AddJerkBounds(-limits.jerk, limits.jerk)
            for s, position in ((0.0, move.start), (1.0, move.goal)):
                problem.AddPathPositionConstraint(position, position, s)
                problem.AddPathVelocityConstraint(rest, rest, s)
                if jerk:
                    problem.AddPathAccelerationConstraint(rest, rest, s)
            if distance is not None:
                for s in np.linspace(0.0, 1.0, distances + 2)[1:-1]:
                    problem.AddPathPositionConstraint(distance.constraint, s)
            result = SnoptSolver().Solve(problem.prog())
            watch.lap("optimisation")
            if not result.is_success():
                return None
            motion = problem.ReconstructTrajectory(result)
            return sampled(watch, lambda time: motion.vector_values(time).T, motion.end_time())

        return solve

    return prepared


class DrakeDistance:
    """Drake's constraint that bodies keep apart, with the cell that it is evaluated on."""

    def __init__(self, setting: Setting) -> None:
        """Reads the cell, and leaves out the pairs that need not keep apart."""
        from pydrake.geometry import CollisionFilterDeclaration, GeometrySet
        from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
        from pydrake.systems.framework import DiagramBuilder

        builder = DiagramBuilder()
        plant, scene = AddMultibodyPlantSceneGraph(builder, 0.0)
        (model,) = Parser(plant).AddModelsFromString(cell_urdf(setting.cell).text, "urdf")
        bodies = [plant.get_body(index) for index in plant.GetBodyIndices(model)]
        plant.WeldFrames(plant.world_frame(), bodies[0].body_frame())
        plant.Finalize()
        starts = [plant.GetJointByName(joint).position_start() for joint in setting.limits.joints]
        if starts != list(range(plant.num_positions())):
            raise PeerError("Drake orders the joints in another way")
        shapes = {body.name(): plant.GetCollisionGeometriesForBody(body) for body in bodies}
        sets = {name: GeometrySet(found) for name, found in shapes.items() if found}
        filters = CollisionFilterDeclaration()
        for own in sets.values():
            filters.ExcludeWithin(own)
        for one, other in combinations(sets, 2):
            apart = frozenset((one, other)) in setting.bodies.apart
            change = filters.AllowBetween if apart else filters.ExcludeBetween
            change(sets[one], sets[other])
        scene.collision_filter_manager().Apply(filters)
        # The constraint refers to these.
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self.constraint = MinimumDistanceLowerBoundConstraint(
            plant, setting.cell.clearance, plant.GetMyMutableContextFromRoot(self._context)
        )
        """Of the joints at one point of a path."""


def by_roboplan(setting: Setting) -> Solve:
    """Returns roboplan's RRT-Connect, its shortcuts, and toppra: no jerk limits, bodies sampled."""
    from roboplan import core, rrt, toppra

    joints, limits = list(setting.limits.joints), setting.limits
    urdf = cell_urdf(setting.cell).text
    scene = core.Scene("cell", core.loadUrdfSceneDescriptionFromXml(urdf))
    links = [link.attrib["name"] for link in ET.fromstring(urdf).iter("link")]
    with_shapes = [link for link in links if scene.getCollisionGeometryIDs(link)]
    pairs = list(combinations(with_shapes, 2))
    together = [pair for pair in pairs if frozenset(pair) not in setting.bodies.apart]
    scene.setCollisions(together, False)
    rates = zip(joints, limits.velocity.tolist(), limits.acceleration.tolist(), strict=True)
    rows = {joint: {"max_velocity": [v], "max_acceleration": [a]} for joint, v, a in rates}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "limits.yaml"
        path.write_text(json.dumps({"joint_limits": rows}), encoding="utf-8")
        scene.importJointLimitsFromConfig(core.loadJointLimitsConfig(path))
    scene.addGroup("all", joints)
    scene.setRngSeed(1)
    if list(scene.getJointGroupInfo("all").joint_names) != joints:
        raise PeerError("roboplan orders the joints in another way")
    asked = rrt.RRTOptions(
        group_name="all",
        rrt_connect=True,
        collision_check_step_size=STEP,
        max_nodes=100_000,
        max_planning_time=PATIENCE,
    )
    search = rrt.RRT(scene, asked)
    shorter = core.PathShortcutter(scene, core.PathShortcuttingOptions("all", STEP))
    timing = toppra.PathParameterizerTOPPRA(scene, "all")

    def solve(move: Move) -> Answer | None:
        watch = Stopwatch()
        ends = (core.JointConfiguration(joints, q) for q in (move.start, move.goal))
        try:
            path = search.plan(*ends)
        except RuntimeError:
            return None
        watch.lap("path")
        path = shorter.shortcut(path)
        watch.lap("shortcuts")
        motion = timing.generate(path)
        watch.lap("toppra")
        return Answer(watch.spent, float(motion.times[-1]), between(np.array(motion.positions)))

    return solve


def by_tesseract(searched: bool) -> Callable[[Setting], Solve]:
    """Returns Tesseract: a path, TrajOpt, and time-optimal trajectory generation; no jerk limits, bodies sampled.

    Args:
        searched: whether the path is RRTConnect's; else it is the straight line.
    """

    def prepared(setting: Setting) -> Solve:
        return Tesseract(setting, searched).solve

    return prepared


class Tesseract:
    """A cell in Tesseract, with its default profiles but for the distances of collision checks."""

    def __init__(self, setting: Setting, searched: bool) -> None:
        """Writes the cell's files and reads them."""
        os.environ.setdefault("TRAJOPT_LOG_THRESH", "FATAL")
        with silence():
            import tesseract_robotics.tesseract_command_language as language
            import tesseract_robotics.tesseract_common as common
            import tesseract_robotics.tesseract_environment as environment
            import tesseract_robotics.tesseract_motion_planners as planners
            import tesseract_robotics.tesseract_motion_planners_ompl as ompl
            import tesseract_robotics.tesseract_motion_planners_simple as simple
            import tesseract_robotics.tesseract_motion_planners_trajopt as trajopt
            import tesseract_robotics.tesseract_time_parameterization as timing

        common.setLogLevel(common.CONSOLE_BRIDGE_LOG_NONE)
        self._language, self._planners, self._simple = language, planners, simple
        self._ompl, self._trajopt, self._timing = ompl, trajopt, timing
        self._searched, self._joints = searched, list(setting.limits.joints)
        limits = setting.limits
        self._rates = [
            np.column_stack([-rate, rate])
            for rate in (limits.velocity, limits.acceleration, limits.jerk)
        ]
        self._environment = environment.Environment()
        with tempfile.TemporaryDirectory() as name, silence():
            urdf, srdf = write_tesseract(setting, Path(name), Path(common.__file__).parents[2])
            paths = [common.FilesystemPath(str(path)) for path in (urdf, srdf)]
            if not self._environment.init(*paths, common.GeneralResourceLocator()):
                raise PeerError("Tesseract does not read the cell")
        self._whole = common.ManipulatorInfo()
        self._whole.manipulator, self._whole.tcp_frame = "all", "left_tcp"
        self._whole.working_frame = self._environment.getRootLinkName()
        path = ompl.OMPLRealVectorPlanProfile()
        path.collision_check_config.longest_valid_segment_length = STEP
        composite = trajopt.TrajOptDefaultCompositeProfile()
        composite.collision_constraint_config.safety_margin = setting.cell.clearance
        composite.longest_valid_segment_length = STEP
        self._profiles = default_profiles(language, {"OMPLMotionPlannerTask": [path]})
        self._shapes = default_profiles(
            language,
            {"TrajOptMotionPlannerTask": [trajopt.TrajOptDefaultPlanProfile(), composite]},
        )

    def solve(self, move: Move) -> Answer | None:
        """Returns the answer to one move."""
        with silence():
            return self._solve(move)

    def _solve(self, move: Move) -> Answer | None:
        watch = Stopwatch()
        self._environment.setState(self._joints, move.start)
        program = self._program(move)
        if self._searched:
            planner = self._ompl.OMPLMotionPlanner("OMPLMotionPlannerTask")
            path = planner.solve(self._request(program, self._profiles))
            watch.lap("path")
            if not path.successful:
                return None
            program = path.results
        seed = self._simple.generateInterpolatedProgram(
            program, self._environment, np.pi, 1.0, np.pi, 10
        )
        planner = self._trajopt.TrajOptMotionPlanner("TrajOptMotionPlannerTask")
        shaped = planner.solve(self._request(seed, self._shapes))
        watch.lap("TrajOpt")
        if not shaped.successful:
            return None
        motion = self._timing.InstructionsTrajectory(shaped.results)
        timed = self._timing.TimeOptimalTrajectoryGeneration().compute(motion, *self._rates)
        watch.lap("timing")
        if not timed:
            return None
        duration = float(motion.getTimeFromStart(motion.size() - 1))
        return Answer(watch.spent, duration, between(self._waypoints(shaped.results)))

    def _program(self, move: Move) -> Any:
        """Returns the program of a move between two configurations."""
        language = self._language
        program = language.CompositeInstruction("DEFAULT")
        program.setManipulatorInfo(self._whole)
        for position in (move.start, move.goal):
            point = language.JointWaypoint(self._joints, position)
            instruction = language.MoveInstruction(
                language.JointWaypointPoly_wrap_JointWaypoint(point),
                language.MoveInstructionType_FREESPACE,
                "DEFAULT",
            )
            program.appendMoveInstruction(
                language.MoveInstructionPoly_wrap_MoveInstruction(instruction)
            )
        return program

    def _request(self, program: Any, profiles: Any) -> Any:
        """Returns the request of a program."""
        request = self._planners.PlannerRequest()
        request.instructions, request.env, request.profiles = program, self._environment, profiles
        return request

    def _waypoints(self, program: Any) -> FloatArray:
        """Returns the configurations of a timed program, shape (k, n)."""
        language, found = self._language, []
        for k in range(len(program)):
            # Each of these refers to the one before, which must not be freed.
            instruction = program[k]
            move = language.InstructionPoly_as_MoveInstructionPoly(instruction)
            point = move.getWaypoint()
            state = language.WaypointPoly_as_StateWaypointPoly(point)
            found.append(np.array(state.getPosition()).ravel())
        return np.array(found)


def default_profiles(language: Any, profiles: Mapping[str, Sequence[Any]]) -> Any:
    """Returns Tesseract's dictionary of default profiles by the names of planners."""
    found = language.ProfileDictionary()
    for planner, own in profiles.items():
        for profile in own:
            found.addProfile(planner, "DEFAULT", profile)
    return found


def between(waypoints: FloatArray) -> FloatArray:
    """Returns about SAMPLES configurations on the straight lines between k waypoints (k, n)."""
    parts = max(SAMPLES // (len(waypoints) - 1), 1)
    steps = np.linspace(0.0, 1.0, parts, endpoint=False)[:, None]
    lines = [one + steps * (other - one) for one, other in pairwise(waypoints)]
    return np.vstack([*lines, waypoints[-1:]])


def write_tesseract(setting: Setting, folder: Path, packages: Path) -> tuple[Path, Path]:
    """Writes a cell as Tesseract reads it and returns the paths of its URDF and its SRDF.

    Args:
        setting: with the cell.
        folder: where.
        packages: the folder that Python packages are installed in.
    """
    libraries = packages / "tesseract_robotics.libs"
    bullet = next(iter(libraries.glob("libtesseract_collision_bullet_factories*")), None)
    if bullet is None:
        raise PeerError("its library for collision checks is not where it was expected")
    plugins: dict[str, Any] = {
        "search_paths": [str(libraries)],
        "search_libraries": [bullet.stem.removeprefix("lib")],
    }
    for kind in ("discrete", "continuous"):
        name = f"Bullet{'Discrete' if kind == 'discrete' else 'Cast'}BVHManager"
        plugins[f"{kind}_plugins"] = {
            "default": name,
            "plugins": {name: {"class": f"{name}Factory"}},
        }
    managers = folder / "plugins.yaml"
    managers.write_text(json.dumps({"contact_manager_plugins": plugins}), encoding="utf-8")
    text = cell_urdf(setting.cell).text
    root = ET.fromstring(text)
    links = [link.attrib["name"] for link in root.iter("link")]
    semantics = ET.Element("robot", {"name": root.attrib["name"]})
    group = ET.SubElement(semantics, "group", {"name": "all"})
    for joint in setting.limits.joints:
        ET.SubElement(group, "joint", {"name": joint})
    ET.SubElement(semantics, "contact_managers_plugin_config", {"filename": managers.as_uri()})
    for one, other in combinations(links, 2):
        if frozenset((one, other)) not in setting.bodies.apart:
            pair = {"link1": one, "link2": other, "reason": "Never"}
            ET.SubElement(semantics, "disable_collisions", pair)
    urdf, srdf = folder / "cell.urdf", folder / "cell.srdf"
    urdf.write_text(text, encoding="utf-8")
    srdf.write_text(ET.tostring(semantics, encoding="unicode"), encoding="utf-8")
    return urdf, srdf


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Discards what compiled libraries print."""
    sys.stdout.flush()
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
    finally:
        for stream, own in zip((1, 2), kept, strict=True):
            os.dup2(own, stream)
        for open_file in (nowhere, *kept):
            os.close(open_file)


class PeerError(Exception):
    """A peer that is installed and cannot be used; its text says why."""


@dataclass(frozen=True)
class Peer:
    """One way of another planner to make the moves."""

    group: str
    """What `--peers` calls it."""
    name: str
    """In the table."""
    package: str
    """What pip installs."""
    limits: str
    """The limits that it keeps: v, a, j."""
    bodies: str
    """How it looks at collisions."""
    prepare: Callable[[Setting], Solve]
    """Prepares it for a cell."""


PEERS = (
    Peer("ruckig", "ruckig, state to state", "ruckig", "v a j", "none", by_ruckig),
    Peer("toppra", "toppra, straight line", "toppra", "v a", "none", by_toppra),
    Peer("ompl", "OMPL RRTConnect, simplified, toppra", "ompl", "v a", "every 0.05 rad", by_ompl),
    Peer("drake", "Drake, 10 control points", "drake", "v a", "none", by_drake(10, False, 0)),
    Peer("drake", "Drake, 10 control points", "drake", "v a j", "none", by_drake(10, True, 0)),
    Peer("drake", "Drake, 15 control points", "drake", "v a j", "none", by_drake(15, True, 0)),
    Peer(
        "drake",
        "Drake, 15 control points",
        "drake",
        "v a j",
        f"{DISTANCES} points",
        by_drake(15, True, DISTANCES),
    ),
    Peer(
        "roboplan",
        "roboplan RRT-Connect, shortcuts, toppra",
        "roboplan",
        "v a",
        "every 0.05 rad",
        by_roboplan,
    ),
    Peer(
        "tesseract",
        "Tesseract TrajOpt from the straight line, TOTG",
        "tesseract-robotics",
        "v a",
        "every 0.05 rad",
        by_tesseract(False),
    ),
    Peer(
        "tesseract",
        "Tesseract RRTConnect, TrajOpt, TOTG",
        "tesseract-robotics",
        "v a",
        "every 0.05 rad",
        by_tesseract(True),
    ),
)


def sequence_job(stages: int, seed: int) -> Job:
    """Returns a random sequence of `long_sequences.py`."""
    with tempfile.TemporaryDirectory() as folder:
        write_sequence("sda10f", stages, seed, Path(folder))
        return load_job(Path(folder) / "tasks.yaml")


def planned(job: Job, effort: str) -> tuple[Schedule, float]:
    """Returns a verified plan and how long planning and verification took [s].

    Raises:
        AssertionError: the verifier does not pass the plan.
    """
    begin = time.process_time()
    schedule = plan_without_bound(job, PlanSettings(blend="none", effort=effort))
    verification = verify(schedule, job, clearance=True)
    spent = time.process_time() - begin
    assert verification.passed, verification.failures
    return schedule, spent


def moves_of(schedule: Schedule, job: Job) -> list[Move]:
    """Returns the transfers of a plan: from both arms' start to the end of the later one.

    An arm that arrives first begins its line while the other one still moves, so each arm's goal is where it is at the
    end of its own transfer. The platform has arrived by then.
    """
    robot, motion, found = job.cell.robot, schedule.trajectory, []
    for stage in schedule.stages:
        own = [
            segment
            for segment in schedule.segments
            if segment.kind == "transfer" and stage.start <= segment.start < stage.end
        ]
        end = max(segment.end for segment in own)
        start, goal = motion.at(np.array([stage.start, end]))[0]
        for segment in own:
            columns = robot.columns(robot.arm(segment.arm).joints)
            goal[columns] = motion.at(np.array([segment.end]))[0][0, columns]
        found.append(Move(start, goal, end - stage.start))
    return found


@dataclass
class Tally:
    """What a peer did with all moves."""

    asked: int = 0
    """How many moves it was given, with repeats."""
    free: int = 0
    """In how many of its motions nothing collides."""
    spent: list[float] = field(default_factory=list)
    """Computing time of each solved move [s]."""
    steps: dict[str, list[float]] = field(default_factory=dict)
    """The same by steps [s]."""
    ratios: list[float] = field(default_factory=list)
    """Motion time of each solved move, divided by that of dualarm's transfer."""
    lengths: list[float] = field(default_factory=list)
    """Length of its path in the norm of all joints, divided by that of the straight line."""

    def add(self, setting: Setting, solve: Solve, moves: Sequence[Move]) -> None:
        """Gives some moves to a peer."""
        for move in moves:
            self.asked += 1
            answer = solve(move)
            if answer is None:
                continue
            self.spent.append(sum(answer.spent.values()))
            for step, spent in answer.spent.items():
                self.steps.setdefault(step, []).append(spent)
            self.ratios.append(answer.duration / move.duration)
            length = np.linalg.norm(np.diff(answer.position, axis=0), axis=1).sum()
            self.lengths.append(float(length / np.linalg.norm(move.goal - move.start)))
            self.free += setting.bodies.are_free(answer.position)


COLUMNS = (
    "peer",
    "limits",
    "bodies",
    "solved",
    "free",
    "processor time per move [ms]",
    "steps [ms]",
    "motion / dualarm",
    "path / straight line",
)
"""Of the table of peers, see the beginning of this file."""


def quartiles(spent: Sequence[float]) -> str:
    """Returns a median with its quartiles [ms]."""
    low, middle, high = 1000.0 * np.quantile(spent, (0.25, 0.5, 0.75))
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def row_of(peer: Peer, tally: Tally) -> str:
    """Returns a peer's row of the table."""
    head = f"| {peer.name} | {peer.limits} | {peer.bodies} | {len(tally.spent)} of {tally.asked} "
    if not tally.spent:
        return f"{head}| | | | | |"
    steps = [f"{step} {1000.0 * np.median(spent):.3g}" for step, spent in tally.steps.items()]
    low, middle, high = min(tally.ratios), np.median(tally.ratios), max(tally.ratios)
    return (
        f"{head}| {tally.free} | {quartiles(tally.spent)} | {', '.join(steps) if len(steps) > 1 else ''} "
        f"| {middle:.3f} ({low:.3f} to {high:.3f}) | {np.median(tally.lengths):.2f} |"
    )


def known_version(package: str) -> str:
    """Returns the version of a package that is installed, and an empty string for one that is not."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def prepared(peer: Peer, setting: Setting) -> Solve | str:
    """Returns what answers a peer's moves, or why it is left out and what to do."""
    installed = known_version(peer.package)
    if not installed:
        return f"{peer.group} is left out: it is not installed (pip install {peer.package})"
    try:
        return peer.prepare(setting)
    except ImportError as error:
        return f"{peer.group} is left out: {peer.package} {installed} cannot be loaded: {error}"
    except PeerError as error:
        return f"{peer.group} is left out: {error}"


def main() -> None:
    """Prints one row for each way to make the moves."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--efforts", nargs="+", default=["quick", "normal"])
    groups = list(dict.fromkeys(peer.group for peer in PEERS))
    parser.add_argument("--peers", choices=groups, nargs="+", default=groups)
    given = parser.parse_args()
    if any(os.environ.get(name) != count for name, count in ONE_THREAD.items()):
        # Libraries read it when they are loaded.
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | ONE_THREAD)
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])

    jobs = [sequence_job(given.stages, seed) for seed in given.seeds]
    planned(jobs[0], "quick")  # loads what is loaded at its first use
    moves: list[list[Move]] = []
    print(
        "| dualarm | whole planning and verification, processor time per stage [ms] |\n| --- | --- |"
    )
    for effort in dict.fromkeys([*given.efforts, "normal"]):
        spent = []
        for job in jobs:
            for repeat in range(given.repeats):
                schedule, taken = planned(job, effort)
                spent.append(taken / given.stages)
                if effort == "normal" and repeat == 0:
                    moves.append(moves_of(schedule, job))
        print(f"| {effort} effort | {quartiles(spent)} |", flush=True)

    cell, limits = jobs[0].cell, jobs[0].cell.robot.limits
    setting = Setting(cell, limits)
    print(f"\n{sum(map(len, moves))} moves, {given.repeats} repeats\n")
    print("| " + " | ".join(COLUMNS) + " |\n" + "| --- " * len(COLUMNS) + "|")
    left_out: dict[str, str] = {}
    for peer in PEERS:
        if peer.group not in given.peers:
            continue
        solve = prepared(peer, setting)
        if isinstance(solve, str):
            left_out[peer.group] = solve
            continue
        tally = Tally()
        for _ in range(given.repeats):
            for own in moves:
                tally.add(setting, solve, own)
        print(row_of(peer, tally), flush=True)
    used = dict.fromkeys(peer.package for peer in PEERS if peer.group in given.peers)
    known = {package: known_version(package) for package in used}
    print("\n" + ", ".join(f"{package} {found}" for package, found in known.items() if found))
    for line in left_out.values():
        print(line)


if __name__ == "__main__":
    main()
