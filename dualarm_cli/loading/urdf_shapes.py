"""Checks of a URDF link: masses, inertias, shapes, and where mesh files may be."""

from __future__ import annotations

from collections.abc import Iterator

from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.urdf_tree import Element, UrdfFindings

_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_SIZES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
}


def check_link(link: Element, findings: UrdfFindings) -> None:
    """Notes what is impossible about a link's inertia and shapes.

    Args:
        link: the element.
        findings: where errors are noted.
    """
    what = f"link {quote(link.name)}"
    inertial = link.find("inertial")
    if inertial is not None:
        _check_inertial(inertial, what, findings)
    for tag in ("visual", "collision"):
        for solid in link.all(tag):
            _check_origin(solid, what, findings)
            _check_geometry(solid, what, findings)


def _check_origin(holder: Element, what: str, findings: UrdfFindings) -> None:
    origin = holder.find("origin")
    for attribute in ("xyz", "rpy"):
        if origin is not None and attribute in origin.attributes:
            findings.numbers(origin, attribute, 3, what)


def _check_inertial(inertial: Element, what: str, findings: UrdfFindings) -> None:
    _check_origin(inertial, what, findings)
    mass = inertial.find("mass")
    if mass is None:
        findings.add(inertial, f"{what}: <inertial> has no <mass>")
    else:
        value = findings.numbers(mass, "value", 1, what)
        if value is not None and value[0] < 0.0:
            findings.add(mass, f"{what}: mass must not be negative, not {value[0]:g} kg")
    inertia = inertial.find("inertia")
    if inertia is None:
        findings.add(inertial, f"{what}: <inertial> has no <inertia>")
        return
    for attribute in _INERTIA:
        value = findings.numbers(inertia, attribute, 1, what)
        if value is not None and attribute in ("ixx", "iyy", "izz") and value[0] < 0.0:
            findings.add(inertia, f"{what}: {attribute} must not be negative, not {value[0]:g}")


def _check_geometry(solid: Element, what: str, findings: UrdfFindings) -> None:
    geometry = solid.find("geometry")
    shapes = geometry.children if geometry is not None else []
    if len(shapes) != 1:
        findings.add(geometry or solid, f"{what}: <{solid.tag}> needs one shape in its <geometry>")
        return
    shape = shapes[0]
    if shape.tag == "mesh":
        _check_mesh(shape, what, findings)
        return
    if shape.tag not in _SIZES:
        allowed = ", ".join([*_SIZES, "mesh"])
        findings.add(shape, f"{what}: shape <{shape.tag}> is not known; allowed: {allowed}")
        return
    for attribute, count in _SIZES[shape.tag]:
        values = findings.numbers(shape, attribute, count, what)
        if values is not None and min(values) <= 0.0:
            findings.add(
                shape, f"{what}: {shape.tag} {attribute} must be above 0, not {min(values):g}"
            )


def _check_mesh(mesh: Element, what: str, findings: UrdfFindings) -> None:
    if not mesh.get("filename"):
        findings.add(mesh, f"{what}: <mesh> has no filename")
    if "scale" in mesh.attributes:
        values = findings.numbers(mesh, "scale", 3, what)
        if values is not None and 0.0 in values:
            findings.add(mesh, f"{what}: mesh scale must not be 0")


def mesh_elements(solid: Element) -> Iterator[Element]:
    """Iterates over the <mesh> elements of a <visual> or <collision>."""
    return (mesh for geometry in solid.all("geometry") for mesh in geometry.all("mesh"))
