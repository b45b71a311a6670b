"""The bundled robots as pinocchio and as an XML reader see them, without the loader where they have a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import robots_folder


@pytest.fixture(scope="session")
def urdf_path(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Returns where a bundled robot's URDF is; of one that has tables instead, as it is exported."""
    exported = tmp_path_factory.mktemp("urdf")

    def path(name: str) -> Path:
        shipped = robots_folder() / name / f"{name}.urdf"
        if shipped.exists():
            return shipped
        file = exported / f"{name}.urdf"
        file.write_text(load_robot(name).robot.urdf)
        return file

    return path


@pytest.fixture(scope="session")
def urdf_tree(urdf_path: Callable[[str], Path]) -> Callable[[str], ET.Element]:
    """Returns the root element of a bundled robot's URDF."""
    return lambda name: ET.parse(urdf_path(name)).getroot()


@pytest.fixture(scope="session")
def pin_model(urdf_path: Callable[[str], Path]) -> Callable[[str], pin.Model]:
    """Returns pinocchio's model of a bundled robot's URDF."""
    return lambda name: pin.buildModelFromUrdf(str(urdf_path(name)))


@pytest.fixture(scope="session")
def joint_axes() -> Callable[[pin.Model, tuple[str, ...], np.ndarray], tuple[np.ndarray, ...]]:
    """Returns what gives joints' axes and a point on each in the world, both of shape (n, 3)."""

    def axes(
        model: pin.Model, joints: tuple[str, ...], q: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        data = model.createData()
        pin.computeJointJacobians(model, data, q)
        ids = [model.getJointId(name) for name in joints]
        # A joint's column of the world Jacobian has its axis in the angular rows.
        directions = np.array([data.J[3:, model.idx_vs[i]] for i in ids])
        return directions, np.array([data.oMi[i].translation for i in ids])

    return axes


@pytest.fixture(scope="session")
def common_normals() -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Returns what gives the feet of the common normals of consecutive lines, shape (n - 1, 2, 3).

    The lines must not be parallel.
    """

    def normals(directions: np.ndarray, points: np.ndarray) -> np.ndarray:
        feet = []
        for (u, v), (p, r) in zip(pairwise(directions), pairwise(points), strict=True):
            s, t = np.linalg.lstsq(np.column_stack([u, -v]), r - p, rcond=None)[0]
            feet.append([p + s * u, r + t * v])
        return np.array(feet)

    return normals
