"""Torques of whole motions: a pendulum by hand, robots by MuJoCo, and energy as an invariant."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.model.cell import Cell, Held, Tool
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.schedule import Event
from dualarm_cli.verification.torque_checks import InverseDynamics, Payload, check_torques
from tests.pendulum import ARM, GRAVITY, LENGTH, MASS, ONE, pendulum


def judged(cell: Cell, q: float, v: float = 0.0, a: float = 0.0, *, picks: float | None = None):
    """The checks of a tenth of a second at an angle, a speed and an acceleration."""
    h = 0.1
    rows = np.array([[[q], [v], [a]], [[q + v * h + a * h * h / 2], [v + a * h], [a]]])
    motion = Trajectory(("swing",), np.array([0.0, h]), rows[:, 0], rows[:, 1], rows[:, 2])
    task = SimpleNamespace(id="first", arm=ARM, tool="", is_change=False, part="box")
    events = () if picks is None else (Event(picks, ARM, "first", "pick", "", pin.SE3.Identity()),)
    job = SimpleNamespace(cell=cell, tasks=(task,))
    return check_torques(SimpleNamespace(trajectory=motion, events=events), job)


@pytest.mark.parametrize("q", [0.0, 0.7, -2.0])
def test_a_torque_that_stands_against_gravity_is_measured(q: float) -> None:
    """Its share of the effort m g L cos q, to one and to a little more."""
    torque = MASS * GRAVITY * LENGTH * abs(np.cos(q))
    for share, verdict in ((0.9, "passed"), (1.0005, "passed"), (1.0015, "failed")):
        [check] = judged(pendulum(torque / share), q)
        assert check.measured == pytest.approx(share, rel=1e-9)
        assert check.verdict == verdict
        assert check.detail.startswith("swing at 0.000 s: ")


def test_a_torque_that_moves_the_tool_is_measured() -> None:
    """Upright it swings up at 40 rad/s²: m L² times that, and gravity at the worst of the angles."""
    [check] = judged(pendulum(100.0), np.pi / 2, a=40.0)
    ends = np.pi / 2 + 40.0 * np.linspace(0.0, 0.1, 14) ** 2 / 2
    torque = MASS * LENGTH**2 * 40.0 - MASS * GRAVITY * LENGTH * np.cos(ends)
    assert check.measured == pytest.approx(np.abs(torque).max() / 100.0, rel=1e-9)


def test_gravity_is_that_of_the_base() -> None:
    """On its side by a quarter turn the arm hangs along gravity, or stands on it."""
    base = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.zeros(3))
    assert judged(pendulum(1.0, base), 0.0)[0].measured == pytest.approx(0.0, abs=1e-12)
    torque = MASS * GRAVITY * LENGTH
    assert judged(pendulum(torque, base), np.pi / 2)[0].measured == pytest.approx(1.0, rel=1e-9)


def test_a_part_counts_from_its_pick_on() -> None:
    """3 kg more at the tool from the event on; before it the tool alone."""
    held = (MASS + 3.0) * GRAVITY * LENGTH
    [check] = judged(pendulum(held), 0.0, picks=0.05)
    assert check.measured == pytest.approx(1.0, rel=1e-9)
    assert check.detail.endswith("carrying left box")
    [check] = judged(pendulum(held), 0.0)
    assert check.measured == pytest.approx(MASS / (MASS + 3.0), rel=1e-9)


def test_friction_rotor_and_spring_add_to_the_torque_of_the_links() -> None:
    """Coulomb friction with the velocity, viscous friction by it, the rotor by acceleration, minus the spring."""
    stated = {
        "coulomb": 0.5 * ONE, "viscous": 0.2 * ONE, "rotor": 0.1 * ONE, "spring": 0.7 * ONE, "stiffness": 0.3 * ONE,
    }  # fmt: skip
    cell = pendulum(100.0, **stated)
    q, v, a = (np.array([[x]]) for x in (0.4, -1.5, 2.0))
    # A positive angle about y lowers the end: the motor holds it by a negative torque.
    links = MASS * LENGTH**2 * 2.0 - MASS * GRAVITY * LENGTH * np.cos(0.4)
    expected = links + 0.1 * 2.0 - 0.2 * 1.5 - 0.5 - 0.7 - 0.3 * 0.4
    assert InverseDynamics(cell).torques(q, v, a).item() == pytest.approx(expected, rel=1e-12)
    still = InverseDynamics(cell).torques(q, 0 * v, 0 * a).item()
    resting = -MASS * GRAVITY * LENGTH * np.cos(0.4)
    assert still == pytest.approx(resting - 0.7 - 0.3 * 0.4 - 0.5, rel=1e-12)


def test_effective_torques_are_compared_with_rated_ones() -> None:
    """Standing still the effective torque is the torque."""
    cell = pendulum(100.0, rated=MASS * GRAVITY * LENGTH / 1.01 * ONE)
    torque, rated = judged(cell, 0.0)
    assert torque.verdict == "passed"
    assert (rated.name, rated.verdict) == ("rated_torque", "failed")
    assert rated.measured == pytest.approx(1.01, rel=1e-9)


@pytest.mark.parametrize(
    ("cell", "reason"),
    [
        (pendulum(0.0), "no effort is known of swing"),
        (replace(pendulum(1e-9), torque="ignored"), "ignores torques"),
        (replace(pendulum(1e-3), torque="checked"), "swing at 0.000 s: 9.81 of 0.001 Nm"),
    ],
)
def test_torques_that_are_no_limit_are_not_judged(cell: Cell, reason: str) -> None:
    """Without data, or as the cell file says; the largest is named where it is known."""
    [check] = judged(cell, 0.0)
    assert check.verdict == "not checked"
    assert reason in check.detail


def test_a_robot_that_cannot_hold_itself_has_an_incomplete_model() -> None:
    """A link of 1 kg at 1 m needs 9.81 N m: with an effort of 9 it cannot be true."""
    cell = pendulum(9.0)
    heavy = '<origin xyz="1 0 0"/><mass value="1"/>'
    urdf = cell.robot.urdf.replace('<mass value="1e-12"/>', heavy)
    [check] = judged(replace(cell, robot=replace(cell.robot, urdf=urdf)), np.pi / 2)
    assert check.verdict == "not checked"
    assert "model is incomplete: swing needs 109% of its effort" in check.detail


def test_without_a_job_no_torque_is_known() -> None:
    """No failure either."""
    [check] = check_torques(SimpleNamespace(), None)
    assert check.verdict == "not checked"


def by_mujoco(urdf: str) -> tuple[mujoco.MjModel, mujoco.MjData, list[str]]:
    """MuJoCo's model of a URDF, its data and its joints."""
    bare = re.sub(r"<(collision|visual).*?</\1>", "", urdf, flags=re.S)
    options = '<mujoco><compiler fusestatic="true" balanceinertia="false" boundmass="0"/></mujoco>'
    start = bare.index(">", bare.index("<robot")) + 1
    model = mujoco.MjModel.from_xml_string(bare[:start] + options + bare[start:])
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    joint = mujoco.mjtObj.mjOBJ_JOINT
    return (
        model,
        mujoco.MjData(model),
        [mujoco.mj_id2name(model, joint, k) for k in range(model.nv)],
    )


def weighed(inertia: pin.Inertia) -> str:
    """The URDF element of an inertia."""
    xyz, moments = " ".join(map(repr, map(float, inertia.lever))), inertia.inertia
    names = {
        "ixx": (0, 0),
        "iyy": (1, 1),
        "izz": (2, 2),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyz": (1, 2),
    }
    words = " ".join(f'{name}="{float(moments[at])!r}"' for name, at in names.items())
    return f'<inertial><origin xyz="{xyz}"/><mass value="{inertia.mass!r}"/><inertia {words}/></inertial>'


def with_random_inertias(robot: Robot, random: np.random.Generator) -> Robot:
    """A robot whose links have random masses, centres and moments, as not all bundled ones have any."""
    bare = re.sub(r"<inertial>.*?</inertial>", "", robot.urdf, flags=re.S)
    root = ElementTree.fromstring(bare)
    for link in root.iter("link"):
        points = random.normal(scale=0.1, size=(20, 3))
        moments = np.sum([p @ p * np.eye(3) - np.outer(p, p) for p in points], axis=0)
        inertia = pin.Inertia(random.uniform(0.3, 6.0), points[0], moments / 20)
        link.append(ElementTree.fromstring(weighed(inertia)))
    return replace(robot, urdf=ElementTree.tostring(root, encoding="unicode"))


@pytest.mark.parametrize("name", ["openarm", "nextage", "sda10f", "yumi", "iiwa7"])
def test_torques_are_those_of_mujoco(name: str) -> None:
    """200 random states with a part in every tool: within 1e-9 of the largest torque."""
    random = np.random.default_rng(3)
    robot = load_robot(name).robot
    if name != "openarm":
        robot = with_random_inertias(robot, random)
    moments = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, -0.002], [0.0, -0.002, 0.025]])
    tcp = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.1, -0.4), np.array([0.02, 0.01, 0.12]))
    tool = Tool(tcp, pin.Inertia(0.8, np.array([0.01, 0.0, 0.06]), 0.1 * moments))
    part = pin.Inertia(2.5, np.array([0.0, 0.03, 0.04]), moments)
    tools = {arm.name: tool for arm in robot.arms}
    cell = Cell(robot, pin.SE3.Identity(), tools, parts={"box": ()}, part_inertias={"box": part})
    urdf = robot.urdf
    for arm in robot.arms:
        bodies = (("tool", tool.inertia), ("part", tcp.act(part)))
        for body, inertia in bodies:
            link = f"{arm.name}_{body}_of_test"
            urdf = urdf.replace(
                "</robot>",
                f'<link name="{link}">{weighed(inertia)}</link><joint name="{link}_joint" type="fixed">'
                f'<parent link="{arm.flange}"/><child link="{link}"/></joint></robot>',
            )
    model, data, joints = by_mujoco(urdf)
    columns = [robot.joints.index(joint) for joint in joints]
    loads = [Payload(arm.name, Held(part="box")) for arm in robot.arms]
    q = random.uniform(robot.limits.lower, robot.limits.upper, (200, len(columns)))
    v, a = 3.0 * random.normal(size=(2, *q.shape))
    torques = InverseDynamics(cell).torques(q, v, a, loads)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = (x[k, columns] for x in (q, v, a))
        mujoco.mj_inverse(model, data)
        scale = np.abs(data.qfrc_inverse).max()
        np.testing.assert_allclose(torques[k, columns], data.qfrc_inverse, atol=1e-9 * scale)


def test_the_work_of_the_torques_is_the_energy_of_the_motion() -> None:
    """∫ τ·v dt from rest to speed is kinetic energy gained and height won."""
    cell, time = pendulum(100.0), np.linspace(0.0, 0.6, 6001)
    # q = 0.8 - t³: from rest to a speed of 3 t².
    q, v, a = 0.8 - time**3, -3.0 * time**2, -6.0 * time
    torque = InverseDynamics(cell).torques(*(x[:, None] for x in (q, v, a)))[:, 0]
    work = np.trapezoid(torque * v, time)
    rise = LENGTH * (np.sin(0.8) - np.sin(0.8 - 0.6**3))
    energy = 0.5 * MASS * LENGTH**2 * (3.0 * 0.36) ** 2 + MASS * GRAVITY * rise
    assert work == pytest.approx(energy, rel=1e-6)
