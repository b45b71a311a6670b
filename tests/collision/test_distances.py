"""Vectorised distances against coal's."""

from __future__ import annotations

import ctypes
import functools

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.pair_groups import box_around, is_rough
from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.collision.solids import WORLD, Solid, shape_solid, solid_distance
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.shape import Shape
from dualarm_cli.native import library, numbers, pointer


def compiled(name, *arrays):
    """A compiled distance of segments, given by middles and half vectors, and of boxes, given by half sides."""
    given = [numbers(array) for array in arrays]
    function = getattr(library(), name)
    function.restype = ctypes.c_double
    return function(*map(pointer, given))


segment_distance, box_distance = (
    functools.partial(compiled, name) for name in ("segment_distance", "box_distance")
)


def coal_distance(one, T_one, other, T_other):
    """Distance of two solids by coal."""
    places = [coal.Transform3s(T.rotation, T.translation) for T in (T_one, T_other)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(one, places[0], other, places[1], request, result)


def along_z(T, half):
    """Middle and half vector of a segment along z."""
    return T.translation, T.rotation @ np.array([0.0, 0.0, half])


def test_segments_are_as_far_apart_as_thin_capsules():
    """A thousand random pairs, some of them points, some parallel."""
    pin.seed(0)
    random = np.random.default_rng(0)
    for k in range(1000):
        T, S = pin.SE3.Random(), pin.SE3.Random()
        if k % 5 == 0:
            S = pin.SE3(T.rotation, S.translation)
        halves = random.uniform(0.01, 1.0, 2) * (1.0 if k % 7 else 1e-9)
        expected = coal_distance(
            coal.Capsule(0.01, 2 * halves[0]), T, coal.Capsule(0.01, 2 * halves[1]), S
        )
        found = segment_distance(*along_z(T, halves[0]), *along_z(S, halves[1]))
        if expected > 1e-6:
            assert abs(found - 0.02 - expected) < 1e-6


def test_a_segment_is_as_far_from_a_box_as_a_thin_capsule():
    """A thousand random ones outside, some along a side and some points."""
    pin.seed(1)
    random = np.random.default_rng(1)
    for k in range(1000):
        T, half = pin.SE3.Random(), random.uniform(0.05, 1.0) * (1.0 if k % 7 else 1e-9)
        if k % 5 == 0:
            T = pin.SE3(np.eye(3), T.translation)
        sides = random.uniform(0.05, 0.8, 3)
        expected = coal_distance(
            coal.Capsule(0.001, 2 * half), T, coal.Box(*(2 * sides)), pin.SE3.Identity()
        )
        if expected < 1e-6:
            continue
        found = box_distance(*along_z(T, half), sides) - 0.001
        assert abs(found - expected) < 1e-6


def test_a_segment_through_a_box_is_as_deep_as_the_middle_of_what_is_inside():
    """A box of 2 by 4 by 6 m: along its axes, a point, from an end inside, and a thousand that are moved a little."""
    sides = np.array([1.0, 2.0, 3.0])
    x = np.array([1.0, 0.0, 0.0])
    assert box_distance(np.zeros(3), 5.0 * x, sides) == pytest.approx(-1.0)
    assert box_distance(1.5 * x[::-1], 5.0 * x, sides) == pytest.approx(-1.0)
    assert box_distance(np.array([0.3, 1.5, 0.0]), 0.0 * x, sides) == pytest.approx(-0.5)
    # From 0.5 to the side at 1: the middle is at 0.75.
    assert box_distance(2.0 * x, 1.5 * x, sides) == pytest.approx(-0.25)
    random = np.random.default_rng(2)
    for _ in range(1000):
        middle, half = random.uniform(-1.0, 1.0, 3) * sides, random.normal(size=3)
        moved = box_distance(middle + 1e-9 * random.normal(size=3), half, sides)
        assert moved == pytest.approx(box_distance(middle, half, sides), abs=1e-6)


def test_nothing_is_known_of_what_is_no_number(tasks_folder):
    """A posture of NaN is free of nothing, whichever pairs there are."""
    test = QuickTest(load_job(tasks_folder / "04_packing" / "tasks.yaml").cell)
    position = np.full((1, 15), np.nan)
    for group in (test.cross(), *map(test.arm_pairs, test.arms)):
        assert not (test.margins(group, position) >= 0.0).any()


def test_round_solids_are_exact_with_one_another_and_with_boxes_and_half_spaces():
    """What is as wide as its hull needs no second look by coal; two boxes, cylinders and meshes do."""
    forms = {
        "ball": coal.Sphere(0.1),
        "rod": coal.Capsule(0.1, 0.2),
        "box": coal.Box(0.1, 0.2, 0.3),
        "floor": coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
        "can": coal.Cylinder(0.1, 0.2),
    }
    solids = {k: Solid(k, WORLD, pin.SE3.Identity(), form, 1.0) for k, form in forms.items()}
    rough = {
        (a, b) for a, one in solids.items() for b, other in solids.items() if is_rough(one, other)
    }
    both = {("box", "box"), ("box", "floor"), ("floor", "box"), ("floor", "floor")}
    cans = {pair for k in forms for pair in (("can", k), (k, "can"))}
    assert rough == both | cans


def test_the_box_around_a_solid_is_about_its_own_middle():
    """A triangle from 1 to 3, 2 to 6 and -3 to 5 m beside its frame; a box is about its frame."""
    corners = [np.array(x) for x in ((1.0, 2.0, -3.0), (3.0, 2.0, 5.0), (1.0, 6.0, 3.0))]
    center, half = box_around(coal.TriangleP(*corners))
    np.testing.assert_allclose(center, [2.0, 4.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(half, [1.0, 2.0, 4.0], atol=1e-9)
    center, half = box_around(coal.Box(1.0, 2.0, 4.0))
    assert (center.tolist(), half.tolist()) == ([0.0, 0.0, 0.0], [0.5, 1.0, 2.0])


def test_faces_that_touch_have_a_distance():
    """Of two boxes on each other coal finds none in one order of the bodies, with exactly these rotations."""
    box = Shape("box", (0.06, 0.06, 0.05), pin.SE3.Identity())
    upper = np.array(
        [
            [-1.0, 8.74479537e-08, 1.41190314e-12],
            [8.74479535e-08, 1.0, 2.43256636e-11],
            [-1.41192626e-12, 2.43256545e-11, -1.0],
        ]
    )
    places = [
        coal.Transform3s(upper, np.array([0.61, -0.14, 0.76500078])),
        coal.Transform3s(np.diag([1.0, -1.0, -1.0]), np.array([0.61, -0.14, 0.715])),
    ]
    solid = shape_solid("", 0, pin.SE3.Identity(), box)
    assert -1e-6 < solid_distance(solid, places[0], solid, places[1]) < 1e-6
