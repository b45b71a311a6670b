# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot

Messages = Callable[..., list[str]]

TABLE = """\
dualarm: robot/1
name: Table
dh:
  left:
    - {joint: a, a: 350 mm, alpha: -90 deg, d: 335 mm, lower: -3, upper: 3, velocity: 2}
    - {joint: b, a: 1.2, theta: 30 deg, lower: -2, upper: 2, velocity: 100 deg/s, effort: 7 kNm, radius: 80 mm}
arms:
  left: {kind: general}
limits:
  a: {acceleration: 5, source: assumed}
  b: {acceleration: 5, source: assumed}
"""


def turn(axis: int, angle: float) -> np.ndarray:
    """Returns the 4 x 4 matrix of a turn about x (0) or z (2)."""
    T = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = math.cos(angle), math.sin(angle)
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    return T


def shift(axis: int, length: float) -> np.ndarray:
    """Returns the 4 x 4 matrix of a shift along x (0) or z (2)."""
    T = np.eye(4)
    T[axis, 3] = length
    return T


def product(rows: np.ndarray, q: np.ndarray, convention: str) -> np.ndarray:
    """Returns the plain product of the matrices of rows (a, alpha, d, theta) at joint positions q."""
    T = np.eye(4)
    for (a, alpha, d, theta), position in zip(rows, q, strict=True):
        own = turn(2, theta + position) @ shift(2, d)
        link = shift(0, a) @ turn(0, alpha)
        T = T @ own @ link if convention == "standard" else T @ link @ own
    return T


def text(tables: dict[str, np.ndarray], convention: str, bases: str = "") -> str:
    """Returns a robot file of random tables."""
    lines = ["dualarm: robot/1", "name: Random", "dh:", f"  convention: {convention}", bases]
    names = []
    for side, rows in tables.items():
        lines.append(f"  {side}:")
        for k, (a, alpha, d, theta) in enumerate(rows.tolist()):
            names.append(f"{side}_{k}")
            lines.append(
                f"    - {{joint: {names[-1]}, a: {a}, alpha: {alpha}, d: {d}, theta: {theta}, lower: -3, upper: 3, velocity: 1}}"
            )
    arms = ", ".join(f"{side}: {{kind: general}}" for side in tables)
    limits = ", ".join(f"{name}: {{acceleration: 1, source: assumed}}" for name in names)
    return "\n".join([*lines, f"arms: {{{arms}}}", f"limits: {{{limits}}}"]) + "\n"


def quarters(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Returns 0, a quarter turn or minus a quarter turn, or lengths of these numbers."""
    return random.choice([0.0, math.pi / 2, -math.pi / 2], shape)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_forward_kinematics_is_the_product_of_the_matrices(convention: str, project: Path) -> None:
    """20 random tables of 1 to 7 rows, quarter turns among them, each at 5 random positions: 1e-13."""
    random = np.random.default_rng(1)
    for _ in range(20):
        rows = random.uniform(-1.5, 1.5, (random.integers(1, 8), 4))
        quarter = random.random(rows.shape) < 0.5
        rows = np.where(quarter, quarters(random, rows.shape), rows)
        (project / "r.yaml").write_text(text({"left": rows}, convention))
        robot = load_robot(project / "r.yaml").robot
        model = pin.buildModelFromXML(robot.urdf)
        data = model.createData()
        for q in random.uniform(-3, 3, (5, len(rows))):
            pin.framesForwardKinematics(model, data, q)
            found = data.oMf[model.getFrameId("flange")].homogeneous
            np.testing.assert_allclose(found, product(rows, q, convention), atol=1e-13)


def test_two_arms_stand_on_bases_of_their_own(project: Path) -> None:
    """The left table begins at (0, 0.3, 1), turned by 90 deg about z; the right one in the root link."""
    random = np.random.default_rng(2)
    tables = {"left": random.uniform(-1, 1, (3, 4)), "right": random.uniform(-1, 1, (2, 4))}
    bases = "  bases: {left: {xyz: [0, 0.3, 1], rpy: [0, 0, 90 deg]}}"
    (project / "r.yaml").write_text(text(tables, "standard", bases))
    robot = load_robot(project / "r.yaml").robot
    assert [(arm.name, arm.flange, len(arm.joints)) for arm in robot.arms] == [
        ("left", "left_flange", 3),
        ("right", "right_flange", 2),
    ]
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = random.uniform(-3, 3, 5)
    pin.framesForwardKinematics(model, data, q)
    base = turn(2, math.pi / 2)
    base[:3, 3] = 0, 0.3, 1
    left = base @ product(tables["left"], q[:3], "standard")
    np.testing.assert_allclose(data.oMf[model.getFrameId("left_flange")], left, atol=1e-13)
    right = product(tables["right"], q[3:], "standard")
    np.testing.assert_allclose(data.oMf[model.getFrameId("right_flange")], right, atol=1e-13)


def test_rows_carry_limits_and_shapes(project: Path) -> None:
    """Ranges, speed and torque in SI; a capsule of 80 mm from joint b to the flange, 1.2 m along x."""
    (project / "r.yaml").write_text(TABLE)
    loaded = load_robot(project / "r.yaml")
    robot = loaded.robot
    assert set(loaded.inputs) == {"r.yaml"}
    assert robot.joints == ("a", "b")
    assert robot.limits.lower.tolist() == [-3, -2]
    assert robot.limits.velocity == pytest.approx([2, math.radians(100)])
    model = pin.buildModelFromXML(robot.urdf)
    assert model.effortLimit.tolist() == [0.0, 7000.0]
    shapes = pin.buildGeomFromUrdfString(model, robot.urdf, pin.GeometryType.COLLISION)
    placed = {shape.name: shape.placement for shape in shapes.geometryObjects}
    assert len(placed) == 3
    ends = sorted(placement.translation[0] for placement in placed.values())
    # Joint b's frame is turned by theta together with the link, so the link lies along its own x.
    assert ends == pytest.approx([0.0, 0.6, 1.2])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("joint: b", "joint: a", ["6:15: E102 joint 'a' is also at left row 1; rename it"]),
        ("joint: b", "joint: base_link", ["6:15: E102 joint 'base_link' is also the root link; rename it"]),
        ("joint: b", "joint: a_link", ["6:15: E102 joint 'a_link' is also at left row 1; rename it"]),
        ("lower: -3", "lower: 4", ["5:56: E200 lower limit 4 rad is above upper limit 3 rad"]),
        ("velocity: 2", "velocity: 0", ["5:87: E200 0: angular velocity must be positive"]),
        ("velocity: 2", "velocity: 2 m/s", ["5:87: E200 unit 'm/s' in '2 m/s' is not one of angular velocity; allowed: rad/s, deg/s"]),
        ("d: 335 mm, ", "d: 335 deg, ", ["5:48: E200 unit 'deg' in '335 deg' is not one of length; allowed: m, mm, cm, um, in"]),
        ("alpha: -90 deg, ", "alhpa: -90 deg, ", ["5:29: E201 unknown key 'alhpa', did you mean 'alpha'? Allowed: joint, a, alpha, d, theta, lower, upper, velocity, effort, radius"]),
        (", velocity: 2}", "}", ["5:7: E202 'velocity' is missing"]),
        ("dh:\n", "urdf: tiny.urdf\ndh:\n", ["4:1: E200 urdf and dh both describe the robot; keep one"]),
        ("dh:\n", "dh:\n  convention: craig\n", ["4:15: E200 'craig' is not allowed; allowed: standard, modified"]),
        ("  left: {kind: general}", "  left: {kind: general}\n  right: {kind: general}", ["9:3: E300 dh has no right table for it"]),
        ("  left: {kind: general}", "  right: {kind: general}", ["4:3: E300 arms has no left arm for it", "8:3: E300 dh has no right table for it"]),
        ("{kind: general}", "{kind: general, flange: a_link}", ["8:33: E300 flange 'a_link' is also at left row 1; rename it"]),
        ("{kind: general}", "{kind: general, joints: [b, a]}", ["8:33: E300 the robot of the DH parameters moves flange 'flange' by [a, b], platform and arm name [b, a]"]),
        ("{kind: general}", "{kind: spherical_wrist}", ["8:9: E300 kind spherical_wrist needs 6 joints, found 2"]),
        ("arms:", "platform: [a]\narms:", ["7:12: E300 'a': DH parameters describe arms only; a robot with a platform needs a URDF"]),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    old: str, new: str, expected: list[str], project: Path, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    assert old in TABLE
    (project / "r.yaml").write_text(TABLE.replace(old, new, 1))
    found = messages(lambda: load_robot(Path("r.yaml")))
    assert found == [f"r.yaml:{line}" for line in expected]


def test_a_file_with_neither_urdf_nor_tables_is_told_along_with_everything_else(
    project: Path, messages: Messages
) -> None:
    """What is missing does not hide what is wrong elsewhere."""
    words = TABLE[: TABLE.index("dh:")] + TABLE[TABLE.index("arms:") :]
    (project / "r.yaml").write_text(
        words.replace("name: Table", "name: 5").replace(
            "{kind: general}", "{kind: general, joints: [a, b], flange: f}"
        )
    )
    assert messages(lambda: load_robot(Path("r.yaml"))) == [
        "r.yaml:1:1: E202 'urdf' is missing; give the path of a URDF, or DH parameters: `dh: …`",
        "r.yaml:2:7: E200 must be text (in quotes, if it looks like a number), not 5",
    ]
