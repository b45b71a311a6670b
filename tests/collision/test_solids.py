"""Links as solids: a cylinder between two balls is one capsule, which contains them."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import _with_capsules, link_solids
from dualarm_cli.model.robot import Arm, JointLimits, Robot

ROD = (
    '<collision><origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/>'
    '<geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>'
)
BALL = '<collision><origin xyz="{0} 0 0"/><geometry><sphere radius="{1}"/></geometry></collision>'


def kinds(*balls: tuple[float, float]) -> list[str]:
    """Kinds of the solids of a link with a rod along x from -0.1 to 0.3 m and balls at some x with some radius."""
    shapes = ROD + "".join(BALL.format(*ball) for ball in balls)
    urdf = (
        f'<robot name="r"><link name="base"/><link name="arm">{shapes}</link>'
        '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    one = np.ones(1)
    limits = JointLimits(("j",), -one, one, one, one, one, ("assumed",))
    robot = Robot("r", urdf, (), (Arm("left", ("j",), "arm", "general"),), limits)
    solids = link_solids(pin.buildModelFromXML(urdf), robot)
    for solid in solids:
        if isinstance(solid.geometry, coal.Capsule):
            assert solid.geometry.radius == pytest.approx(0.05, abs=1e-4)
            assert 2.0 * solid.geometry.halfLength == pytest.approx(0.4)
            # The farthest point is the far ball's: 0.3 + 0.05 m from the joint, and no farther than its box tells.
            assert 0.35 <= solid.extent <= 0.1 + np.linalg.norm([0.25, 0.05, 0.05]) + 1e-3
    return sorted(type(solid.geometry).__name__ for solid in solids)


def test_a_rod_between_two_balls_of_its_radius_is_a_capsule() -> None:
    """At both ends and of the same radius, whichever comes first; other balls stay what they are."""
    assert kinds((-0.1, 0.05), (0.3, 0.05)) == ["Capsule"]
    assert kinds((0.3, 0.05), (-0.1, 0.05), (0.1, 0.07)) == ["Capsule", "Sphere"]


def test_a_rod_without_both_balls_is_a_cylinder() -> None:
    """One ball missing, of another radius, elsewhere, or both at one end."""
    assert kinds() == ["Cylinder"]
    assert kinds((0.3, 0.05)) == ["Cylinder", "Sphere"]
    assert kinds((-0.1, 0.05), (0.3, 0.06)) == ["Cylinder", "Sphere", "Sphere"]
    assert kinds((-0.1, 0.05), (0.2, 0.05)) == ["Cylinder", "Sphere", "Sphere"]
    assert kinds((0.3, 0.05), (0.3, 0.05)) == ["Cylinder", "Sphere", "Sphere"]


@pytest.mark.parametrize(("share", "count"), [(0.9, 1), (1.1, 3)])
@pytest.mark.parametrize("what", ["place", "radius"])
def test_balls_off_the_ends_of_a_rod_by_less_than_a_micrometre_make_a_capsule(share, count, what):
    """It is wider by a micrometre, so that the balls are within it."""
    off = share * 1e-6
    radius = 0.05 + (off if what == "radius" else 0.0)
    aside = np.array([off if what == "place" else 0.0, 0.0, 0.0])
    shapes = [("rod", coal.Cylinder(0.05, 0.4), np.zeros(3))]
    shapes += [
        (f"ball {z}", coal.Sphere(radius), aside + np.array([0.0, 0.0, z])) for z in (0.2, -0.2)
    ]
    entries = [
        pin.GeometryObject(name, 0, 0, pin.SE3(np.eye(3), place), form)
        for name, form, place in shapes
    ]
    found = _with_capsules(entries)
    assert len(found) == count
    if count == 1:
        assert found[0].geometry.radius == pytest.approx(0.05 + 1e-6, abs=1e-12)
        assert found[0].geometry.halfLength == pytest.approx(0.2)
