"""URDF, checked for everything that could mislead a parser or a planner."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from dualarm_cli.errors import did_you_mean
from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.urdf_tree import Element, UrdfFindings, parse_xml
from dualarm_cli.files.source.text_source import TextSource, quote, suggest
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass

_SIZES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}


def check_link(link: Element, findings: UrdfFindings) -> None:
    """Note impossible values of a link's inertia and shapes.

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
    for attribute in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
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
    """Iterate over the <mesh> elements of a <visual> or <collision>."""
    return (mesh for geometry in solid.all("geometry") for mesh in geometry.all("mesh"))


CONTINUOUS_LIMIT = 1000.0
"""Position limit of continuous joints [rad]."""
SOFT_LIMITS = ("soft_lower_limit", "soft_upper_limit")
"""Attributes of `<safety_controller>`: position limits of the controller."""
UNLIMITED = (-math.inf, math.inf)
"""Positions of a joint without limits [rad or m]."""
MAX_JOINTS = 1000
"""Maximum number of joints in one URDF.

Libraries traverse them by recursion, and some 5,000 in a row end the process.
"""
MOVING_TYPES = ("revolute", "continuous", "prismatic")
"""Joint types that may move."""
_OTHER_FORMATS = {"mujoco": "MuJoCo (MJCF)", "sdf": "Gazebo (SDF)"}
"""Names of other formats of robot descriptions, by their root elements."""
_TYPES = (*MOVING_TYPES, "fixed", "floating", "planar")


@dataclass(frozen=True)
class UrdfJoint:
    """A moving joint."""

    name: str
    """Name."""
    slides: bool
    """Whether it is prismatic."""
    lower: float
    """Lowest position [rad or m]."""
    upper: float
    """Highest position [rad or m]."""
    velocity: float
    """Largest speed [rad/s or m/s]."""
    acceleration: float | None = None
    """Largest acceleration [rad/s² or m/s²], or None (URDF 1.2)."""
    jerk: float | None = None
    """Largest jerk [rad/s³ or m/s³], or None (URDF 1.2)."""
    narrowed: tuple[str, ...] = ()
    """Causes in words that narrow the positions below those of `<limit>`."""
    slowed: float = 0.0
    """Distance to a soft limit below which its controller limits the speed [rad or m]."""


@dataclass(frozen=True)
class Urdf:
    """A checked robot description."""

    source: TextSource
    """The file."""
    root: Element
    """Root element."""
    root_link: str
    """Link without a parent."""
    links: dict[str, Element]
    """Links by name."""
    joints: dict[str, Element]
    """Joints by name, in document order."""

    def chain(self, link: str) -> list[str]:
        """List the moving joints from the root to a link."""
        return [joint.name for joint in self.path(link) if joint.get("type") != "fixed"]

    def path(self, link: str) -> list[Element]:
        """List all joints from the root to a link."""
        parent_of = {joint.child_name("child", "link"): joint for joint in self.joints.values()}
        joints = []
        while link != self.root_link:
            joints.append(parent_of[link])
            link = joints[-1].child_name("parent", "link")
        return joints[::-1]


def read_urdf(source: TextSource) -> Urdf:
    """Parse and check a URDF.

    Args:
        source: the text of the file.

    Raises:
        InputError: not XML or not a URDF, not one tree, or a link or joint with impossible values.
    """
    root = parse_xml(source)
    findings = UrdfFindings(source)
    if root.tag != "robot":
        message = f"root element must be <robot>, not <{root.tag}>"
        if root.tag in _OTHER_FORMATS:
            message = f"{_OTHER_FORMATS[root.tag]} is not read; give the maker's URDF or xacro file"
        findings.add(root, message)
        findings.raise_if_any()
    xacro = next((child for child in root.children if child.tag.startswith("xacro:")), None)
    if xacro is not None:
        findings.add(
            xacro, f"<{xacro.tag}>: this is a xacro file; `dualarm robot import` expands it"
        )
        findings.raise_if_any()
    links = _by_name(root, "link", findings)
    joints = _by_name(root, "joint", findings)
    if not links:
        findings.add(root, "there is no <link>")
    if len(joints) > MAX_JOINTS:
        message = (
            f"{len(joints)} joints; at most {MAX_JOINTS} are read; remove those that do not move"
        )
        findings.add(list(joints.values())[MAX_JOINTS], message)
        findings.raise_if_any()
    for link in links.values():
        check_link(link, findings)
    for joint in joints.values():
        _check_joint(joint, links, findings)
    findings.raise_if_any()
    root_link = _check_tree(root, links, joints, findings)
    findings.raise_if_any()
    return Urdf(source, root, root_link, links, joints)


def _by_name(root: Element, tag: str, findings: UrdfFindings) -> dict[str, Element]:
    """Index the elements of one kind by name; names must be present and unique."""
    elements: dict[str, Element] = {}
    for element in root.all(tag):
        name = element.name
        if not name or not name.isprintable() or name != name.strip():
            findings.add(element, f"<{tag}> needs a printable name, not {quote(name)}")
        elif name in elements:
            findings.add(
                element, f"duplicate {tag} {quote(name)}, first at line {elements[name].line}"
            )
        else:
            elements[name] = element
    return elements


def _check_joint(joint: Element, links: dict[str, Element], findings: UrdfFindings) -> None:
    what = f"joint {quote(joint.name)}"
    kind = joint.get("type")
    if kind not in _TYPES:
        hint = suggest(kind, list(_TYPES))
        findings.add(joint, f"{what}: type {quote(kind)} is not known{hint}")
    for tag in ("parent", "child"):
        child = joint.find(tag)
        if child is None or not child.get("link"):
            findings.add(child or joint, f'{what}: <{tag} link="…"/> is missing')
        elif child.get("link") not in links:
            name = child.get("link")
            hint = did_you_mean(name, list(links))
            findings.add(child, f"{what}: there is no link {quote(name)}{hint}")
    origin = joint.find("origin")
    for attribute in ("xyz", "rpy"):
        if origin is not None and attribute in origin.attributes:
            findings.numbers(origin, attribute, 3, what)
    axis = joint.find("axis")
    if kind in MOVING_TYPES and axis is not None:
        values = findings.numbers(axis, "xyz", 3, what)
        if values is not None and math.hypot(*values) < 1e-6:
            findings.add(axis, f"{what}: axis must not be zero")


def _check_tree(
    root: Element, links: dict[str, Element], joints: dict[str, Element], findings: UrdfFindings
) -> str:
    """Find the root link; note two parents, several roots, cycles."""
    parent_joint: dict[str, Element] = {}
    for joint in joints.values():
        child = joint.child_name("child", "link")
        if child in parent_joint:
            first = parent_joint[child].name
            both = f"{quote(first)} and {quote(joint.name)}"
            message = f"link {quote(child)} is the child of two joints: {both}"
            findings.add(joint, message)
        parent_joint.setdefault(child, joint)
    roots = [name for name in links if name not in parent_joint]
    if len(roots) > 1:
        names = ", ".join(quote(name) for name in roots[:5])
        findings.add(links[roots[1]], f"{len(roots)} root links: {names}; join them by joints")
    reached, todo = set(roots), list(roots)
    children: dict[str, list[str]] = {}
    for child, joint in parent_joint.items():
        children.setdefault(joint.child_name("parent", "link"), []).append(child)
    while todo:
        fresh = [child for child in children.get(todo.pop(), []) if child not in reached]
        reached.update(fresh)
        todo.extend(fresh)
    lost = [name for name in links if name not in reached]
    if lost:
        joint = parent_joint[lost[0]]
        findings.add(joint, f"joints form a cycle through link {quote(lost[0])}")
    return roots[0] if roots else ""


def moving_joints(urdf: Urdf, names: Sequence[str]) -> tuple[list[UrdfJoint], list[Note]]:
    """Read the named joints in document order with their limits, and notes on them.

    Args:
        urdf: a checked URDF.
        names: joints of platform and arms; all must be in the URDF.

    Raises:
        InputError: a joint cannot move, mimics another, or has no or impossible limits.
    """
    findings = UrdfFindings(urdf.source)
    joints, notes = list[UrdfJoint](), list[Note]()
    for joint in urdf.joints.values():
        if joint.name not in names:
            continue
        what, kind = f"joint {quote(joint.name)}", joint.get("type")
        if kind not in MOVING_TYPES:
            findings.add(joint, f"{what} is {kind}; the robot file needs one that turns or slides")
            continue
        mimic = joint.find("mimic")
        if mimic is not None:
            findings.add(
                mimic,
                f"{what} mimics {quote(mimic.get('joint'))}; joints that follow others cannot be planned",
            )
            continue
        limits = _limits(joint, kind, what, findings)
        soft = _checked_soft_range(joint, what, findings)
        acceleration = _stated_rate(joint, ("acceleration", "deceleration"), what, findings)
        jerk = _stated_rate(joint, ("jerk",), what, findings)
        if limits is not None and soft is not None:
            *whole, velocity = limits
            lower, upper = max(whole[0], soft[0]), min(whole[1], soft[1])
            if lower > upper:
                message = f"{what}: soft limits {soft[0]:g} to {soft[1]:g} and limits {whole[0]:g} to {whole[1]:g}"
                findings.add(joint, f"{message} have no position in common")
            narrowed = ("soft limits of the URDF",) if [lower, upper] != whole else ()
            ranges = lower, upper, velocity, acceleration, jerk
            slowed = _slowed(joint, soft, velocity)
            joints.append(UrdfJoint(joint.name, kind == "prismatic", *ranges, narrowed, slowed))
            if soft == UNLIMITED and joint.child_name("safety_controller", SOFT_LIMITS[0]):
                notes.append(robot_note("equal_soft_limits", joint=what))
        if kind == "continuous" and soft == UNLIMITED:
            notes.append(robot_note("continuous", joint=what, limit=CONTINUOUS_LIMIT))
    findings.raise_if_any()
    return joints, notes


def _limits(
    joint: Element, kind: str, what: str, findings: UrdfFindings
) -> tuple[float, float, float] | None:
    """Read lower, upper and velocity limits, or None after noting errors."""
    limit = joint.find("limit")
    if limit is None:
        findings.add(joint, f"{what} has no <limit>; give lower, upper and velocity")
        return None
    if "effort" in limit.attributes:
        findings.numbers(limit, "effort", 1, what)
    velocity = findings.numbers(limit, "velocity", 1, what)
    if velocity is not None and velocity[0] <= 0.0:
        findings.add(limit, f"{what}: velocity limit must be above 0, not {velocity[0]:g}")
        velocity = None
    if kind == "continuous":
        return (-CONTINUOUS_LIMIT, CONTINUOUS_LIMIT, velocity[0]) if velocity else None
    lower = findings.numbers(limit, "lower", 1, what)
    upper = findings.numbers(limit, "upper", 1, what)
    if lower is None or upper is None or velocity is None:
        return None
    if lower[0] > upper[0]:
        findings.add(limit, f"{what}: lower limit {lower[0]:g} is above upper limit {upper[0]:g}")
        return None
    return lower[0], upper[0], velocity[0]


def _slowed(joint: Element, soft: tuple[float, float], velocity: float) -> float:
    """Compute the distance to soft limits where k_position times it is below the top speed."""
    try:
        gain = float(joint.child_name("safety_controller", "k_position") or 0.0)
    except ValueError:
        gain = 0.0
    return velocity / gain if gain > 0.0 and soft != UNLIMITED else 0.0


def soft_range(joint: Element) -> tuple[float, float]:
    """Read a joint's soft position limits [rad or m], by default infinite.

    URDF's default of both is 0. Limits that are equal or not numbers count as not set.
    """
    soft = joint.find("safety_controller")
    try:
        lower, upper = (float(soft.get(key, "0")) if soft else 0.0 for key in SOFT_LIMITS)
    except ValueError:
        return UNLIMITED
    return (lower, upper) if lower != upper else UNLIMITED


def _checked_soft_range(
    joint: Element, what: str, findings: UrdfFindings
) -> tuple[float, float] | None:
    """Read a joint's soft position limits, or None after noting faults."""
    soft, (lower, upper) = joint.find("safety_controller"), soft_range(joint)
    if soft is None:
        return UNLIMITED
    stated = [key for key in SOFT_LIMITS if key in soft.attributes]
    if any(findings.numbers(soft, key, 1, what) is None for key in stated):
        return None
    if lower > upper:
        findings.add(soft, f"{what}: soft limit {lower:g} is above soft limit {upper:g}")
        return None
    return lower, upper


def _stated_rate(
    joint: Element, keys: Sequence[str], what: str, findings: UrdfFindings
) -> float | None:
    """Read the smallest of several limits of URDF 1.2, or None."""
    limit = joint.find("limit")
    values: list[float] = []
    for key in keys:
        if limit is None or key not in limit.attributes:
            continue
        value = findings.numbers(limit, key, 1, what)
        if value is not None and value[0] <= 0.0:
            findings.add(limit, f"{what}: {key} limit must be above 0, not {value[0]:g}")
        values += value or []
    return min(values, default=None)
