"""The bundled robots as pinocchio and as an XML reader see them, without the loader."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pinocchio as pin
import pytest

from dualarm_cli.loading.bundled import robots_folder


@pytest.fixture(scope="session")
def urdf_path() -> Callable[[str], Path]:
    """Returns where a bundled robot's URDF is."""
    return lambda name: robots_folder() / name / f"{name}.urdf"


@pytest.fixture(scope="session")
def urdf_tree(urdf_path: Callable[[str], Path]) -> Callable[[str], ET.Element]:
    """Returns the root element of a bundled robot's URDF."""
    return lambda name: ET.parse(urdf_path(name)).getroot()


@pytest.fixture(scope="session")
def pin_model(urdf_path: Callable[[str], Path]) -> Callable[[str], pin.Model]:
    """Returns pinocchio's model of a bundled robot's URDF."""
    return lambda name: pin.buildModelFromUrdf(str(urdf_path(name)))
