"""`dualarm robot`: the bundled robots, their properties, their URDF, and import from a URDF."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.completion import complete_robot
from dualarm_cli.cli.parts.help import HelpCommand, HelpGroup
from dualarm_cli.cli.parts.options import (
    ConvexPartsOption,
    JointLimitsOption,
    LeftTipOption,
    PackageDirOption,
    PlatformJointOption,
    RightTipOption,
    SeedOption,
    SrdfOption,
    XacroArgOption,
)
from dualarm_cli.cli.parts.output import (
    STDOUT,
    DetailsOption,
    JsonOption,
    print_json,
    print_message,
    stdout_console,
    write_out,
)
from dualarm_cli.cli.robot_reach import reach_command
from dualarm_cli.errors import UsageError
from dualarm_cli.notes import of_arm
from dualarm_cli.report.printable import numbers, print_lines

if TYPE_CHECKING:
    from dualarm_cli.geometry.joint_axes import SrsGeometry
    from dualarm_cli.kinematics.cell_model import MeasuredRobot
    from dualarm_cli.kinematics.general_arm import GeneralArm
    from dualarm_cli.model.robot import Arm, ArmKind, Robot

robot_app = typer.Typer(
    name="robot",
    help="List, show, export and import robots, and see what they reach.",
    no_args_is_help=True,
    rich_markup_mode=None,
    cls=HelpGroup,
)
FAMILIES = {
    "elbow": "axes 2 and 3 are parallel",
    "two_steps": "axes 1 and 2 meet or are parallel",
    "quartic": "its first three axes have no special arrangement",
}
"""Descriptions of the closed forms of an arm with a spherical wrist."""
RobotName = Annotated[
    str,
    typer.Argument(
        help="A bundled robot's name, a robot's folder, or a robot file.",
        autocompletion=complete_robot,
    ),
]


@robot_app.command("list", cls=HelpCommand)
def list_command(json_output: JsonOption = False) -> None:
    """List the bundled robots."""
    from dualarm_cli.files.robots.robots import load_robot
    from dualarm_cli.files.source.bundled import bundled_robots

    rows = []
    for name in bundled_robots():
        robot = load_robot(name).robot
        rows.append(
            {
                "robot": name,
                "name": robot.name,
                "platform_joints": len(robot.platform),
                "arms": {arm.name: f"{len(arm.joints)} axes, {arm.kind}" for arm in robot.arms},
            }
        )
    if json_output:
        print_json({"format": "dualarm.robots/1", "robots": rows})
        return
    from rich.table import Table

    table = Table("robot", "name", "platform joints", "arms")
    for row in rows:
        arms: Any = row["arms"]
        text = "; ".join(f"{arm}: {what}" for arm, what in arms.items())
        table.add_row(str(row["robot"]), str(row["name"]), str(row["platform_joints"]), text)
    stdout_console().print(table)


@robot_app.command("show", cls=HelpCommand)
def show_command(
    robot: RobotName, json_output: JsonOption = False, details: DetailsOption = False
) -> None:
    """Show joints, limits with their source, flanges, and the measured geometry of arms.

    -v prints the joint values of postures, and how far axes deviate from the arm's kind.
    """
    from dualarm_cli.files.robots.robots import load_robot

    loaded = load_robot(robot)
    document = describe_robot(loaded.robot) | {"notes": list(loaded.notes)}
    if json_output:
        print_json(document)
        return
    console = stdout_console()
    console.print(_limits_table(loaded.robot))
    for name, arm in document["arms"].items():
        summary = arm["summary"]
        if arm.get("is_srs") and not details:
            summary = summary.replace(f" measured deviation: {arm['deviation']};", "")
        count = len(document["arms"])
        lead, flange = of_arm(name, "arm", count), of_arm(name, "flange", count)
        print_lines(console, f"{lead}: {summary}", f"{flange}: link {arm['flange']}")
    if details:
        print_lines(console, *(_posture_line(loaded.robot, name) for name in document["postures"]))
    else:
        print_lines(
            console, f"postures: {', '.join(document['postures']) or 'none'}: -v has values"
        )
    print_lines(console, *(f"note: {note}" for note in document["notes"]))


@robot_app.command("export", cls=HelpCommand)
def export_command(
    robot: RobotName,
    out: Annotated[Path, typer.Option("--out", help="URDF file to write; - prints it on stdout.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
) -> None:
    """Write the complete URDF that any other tool loads."""
    from dualarm_cli.files.robots.robots import load_robot

    write_out(out, [load_robot(robot).robot.urdf.encode()], force)
    if str(out) != STDOUT:
        print_message(f"written: {out}")


@robot_app.command("import", cls=HelpCommand)
def import_command(
    urdf: Annotated[Path | None, typer.Argument(help="URDF or xacro file.")] = None,
    left: Annotated[
        Path | None,
        typer.Option(
            "--left", help="URDF of a robot of one arm that becomes the left arm of a cell of two."
        ),
    ] = None,
    right: Annotated[
        Path | None,
        typer.Option(
            "--right", help="URDF of the robot that is the right arm.", show_default=False
        ),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(
            "--out", help="Folder to write; default ./<robot's name>.", show_default=False
        ),
    ] = None,
    srdf: SrdfOption = None,
    joint_limits: JointLimitsOption = None,
    left_tip: LeftTipOption = "",
    right_tip: RightTipOption = "",
    platform: PlatformJointOption = None,
    package_dir: PackageDirOption = None,
    xacro_arg: XacroArgOption = None,
    divided: ConvexPartsOption = None,
    seed: SeedOption = 0,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the files.")] = False,
    json_output: JsonOption = False,
) -> None:
    """Write a robot file from a URDF: arms, platform, limits, contacts, start posture, reasons."""
    from dualarm_cli.cli.parts.result_files import refuse_folder, write_folder
    from dualarm_cli.robot_import.expanded_text import parse_arguments
    from dualarm_cli.robot_import.importing import Imported, ImportRequest, import_robot
    from dualarm_cli.robot_import.importing_pair import ImportedPair, import_pair
    from dualarm_cli.robot_import.structure import OpenChoiceError

    tips = {side: tip for side, tip in (("left", left_tip), ("right", right_tip)) if tip}
    packages, parts = tuple(package_dir or ()), tuple(divided or ())
    imported: Imported | ImportedPair
    if urdf is not None and left is None and right is None:
        carriers = tuple(platform) if platform is not None else None
        arguments = parse_arguments(xacro_arg or ())
        request = ImportRequest(
            urdf, srdf, joint_limits, tips, carriers, packages, seed, parts, arguments
        )
        try:
            imported = import_robot(request)
        except OpenChoiceError as choice:
            if not (sys.stdin.isatty() and sys.stderr.isatty()):
                raise
            imported = import_robot(replace(request, tips=_asked_for_tips(choice.tips)))
        main = "robot.yaml"
    elif urdf is None and left is not None and right is not None:
        alone = {"--srdf": srdf, "--platform": platform, "--convex-parts": divided}
        for option, value in alone.items():
            if value is not None:
                raise UsageError(f"{option}: is of one robot; import that robot by itself")
        left_request, right_request = (
            ImportRequest(
                *(file, None, joint_limits, tips, None, packages, seed),
                arguments=parse_arguments(xacro_arg or (), side),
            )
            for side, file in (("left", left), ("right", right))
        )
        imported, main = import_pair(left_request, right_request), "cell.yaml"
    else:
        raise UsageError("give one URDF, or --left URDF and --right URDF for two robots in a cell")
    folder = out if out is not None else imported.folder
    refuse_folder(folder, tuple(imported.files), force)
    write_folder(folder, dict(imported.files))
    file = Path(folder) / main
    if json_output:
        written = {main.removesuffix(".yaml"): str(file), "decisions": list(imported.reasons)}
        print_json({"format": "dualarm.imported_robot/1", **written})
        return
    for reason in imported.reasons:
        print_message(reason)
    uses = f"task files next to it use it: `cell: {main}`"
    if main == "robot.yaml":
        uses = f"a cell file next to that folder uses it: `robot: {Path(folder).name}/robot.yaml`"
    print_message(f"written: {file}; {uses}; first project: dualarm init DIR --robot {folder}")


def _asked_for_tips(tips: Sequence[str]) -> dict[str, str]:
    """Prompt for the last links of the arms, by side."""
    from dualarm_cli.robot_import.structure import NO_TIP

    print_message(f"The tree has {len(tips)} rows of joints that may be arms: {', '.join(tips)}.")
    left = typer.prompt("Link that the left arm ends in", value_proc=_one_of(tips), err=True)
    others = [*(tip for tip in tips if tip != left), NO_TIP]
    right = typer.prompt(
        f"Link that the right arm ends in ({', '.join(others)})",
        value_proc=_one_of(others),
        err=True,
    )
    return {"left": left, "right": right}


def _one_of(names: Sequence[str]) -> Callable[[str], str]:
    """Create a prompt parser that accepts only the given names."""

    def named(answer: str) -> str:
        if answer not in names:
            raise typer.BadParameter(f"'{answer}' is not one of {', '.join(names)}")
        return answer

    return named


robot_app.command("reach", cls=HelpCommand)(reach_command)


def describe_robot(robot: Robot) -> dict[str, Any]:
    """Describe a robot as a JSON-ready document; angles in rad, lengths in m.

    Args:
        robot: of the data model.
    """
    import pinocchio as pin

    from dualarm_cli.geometry.joint_axes import SRS_TOLERANCE
    from dualarm_cli.kinematics.cell_model import MeasuredRobot

    measured = MeasuredRobot.of(robot, pin.SE3.Identity())
    arms = {}
    for arm in robot.arms:
        arms[arm.name] = {"kind": arm.kind, "joints": list(arm.joints), "flange": arm.flange}
        if arm.kind == "srs":
            geometry = measured.srs(arm)
            arms[arm.name] |= _describe_srs(geometry, geometry.is_srs(SRS_TOLERANCE))
        else:
            arms[arm.name] |= _describe_general(measured, arm)
    limits = robot.limits
    return {
        "format": "dualarm.robot_description/1",
        "name": robot.name,
        "platform": list(robot.platform),
        "arms": arms,
        "joints": {
            name: {
                "lower": _finite(limits.lower[k]),
                "upper": _finite(limits.upper[k]),
                "velocity": float(limits.velocity[k]),
                "acceleration": float(limits.acceleration[k]),
                "jerk": _finite(limits.jerk[k]),
                "source": limits.source[k],
                "slides": name in robot.sliding,
            }
            for k, name in enumerate(robot.joints)
        },
        "postures": sorted(robot.postures),
        "posture_values": {
            name: dict(zip(robot.joints, map(float, robot.postures[name]), strict=True))
            for name in sorted(robot.postures)
        },
    }


def _describe_srs(geometry: SrsGeometry, exact: bool) -> dict[str, Any]:
    """Describe the measured geometry of an arm of kind srs."""
    x, y, z = (float(v) for v in geometry.shoulder)
    radius, azimuth = math.hypot(x, y), math.atan2(y, x)
    summary = (
        f"spherical-revolute-spherical{'' if exact else ' claimed, but NOT'}; "
        f"measured deviation: {geometry.deviation}; "
        f"links {geometry.upper * 1000:.1f} and {geometry.fore * 1000:.1f} mm; shoulder "
        f"{radius * 1000:.2f} mm from the platform axis at {math.degrees(azimuth):.3f} deg, "
        f"height {z * 1000:.1f} mm; inverse kinematics: {'closed form (arm_angle)' if exact else 'none'}"
    )
    return {
        "upper": geometry.upper,
        "fore": geometry.fore,
        "shoulder_radius": radius,
        "shoulder_azimuth": azimuth,
        "shoulder_height": z,
        "is_srs": exact,
        "deviation": str(geometry.deviation),
        "inverse_kinematics": "arm_angle" if exact else None,
        "summary": summary,
    }


def _describe_general(measured: MeasuredRobot, arm: Arm) -> dict[str, Any]:
    """Describe the inverse kinematics of an arm of another kind, and its deviations."""
    from dualarm_cli.errors import UnsupportedError
    from dualarm_cli.geometry.joint_axes import SRS_TOLERANCE
    from dualarm_cli.kinematics.serial_chain import LEAST_JOINTS

    n = len(arm.joints)
    try:
        general = measured.general(arm)
    except UnsupportedError as error:
        summary = f"kind {arm.kind}, {n} axes; not planned: {error}"
        return {"inverse_kinematics": None, "summary": summary}
    facts: dict[str, Any] = {"inverse_kinematics": "numeric", "wrist_gap": general.wrist_gap}
    if general.slides:
        what = f"joint {arm.joints[general.slides[0]]} slides"
    elif n == 7:
        geometry = measured.srs(arm)
        facts["is_srs"] = geometry.is_srs(SRS_TOLERANCE)
        facts["deviation"] = str(geometry.deviation)
        what = f"not spherical-revolute-spherical: {geometry.deviation}"
        if facts["is_srs"]:
            what = "spherical-revolute-spherical by measurement: kind srs has closed forms for it"
    elif general.wrist_gap <= SRS_TOLERANCE:
        what = "its last three axes meet in a point"
        return facts | _describe_closed(general, arm.kind, "spherical_wrist", what)
    elif n == LEAST_JOINTS and general.parallel_deviation <= SRS_TOLERANCE:
        facts["parallel_deviation"] = general.parallel_deviation
        what = "its axes 2, 3 and 4 are parallel"
        return facts | _describe_closed(general, arm.kind, "parallel_axes", what)
    else:
        what = f"its last three axes miss a common point by {general.wrist_gap * 1000:.3g} mm"
        if n == LEAST_JOINTS:
            facts["parallel_deviation"] = general.parallel_deviation
            what += (
                f", its axes 2, 3 and 4 are not parallel by {general.parallel_deviation:.3g} rad"
            )
    summary = f"kind {arm.kind}, {n} axes; {what}; inverse kinematics: numeric (many starts)"
    return facts | {"summary": summary}


def _describe_closed(
    general: GeneralArm, kind: str, measured: ArmKind, what: str
) -> dict[str, Any]:
    """Describe the closed forms of an arm of six axes, by its measured kind."""
    from dualarm_cli.kinematics.cell_model import CLOSED_ARMS
    from dualarm_cli.kinematics.closed_arm import with_closed_forms

    closed = with_closed_forms(CLOSED_ARMS[measured], general)
    numeric = "inverse kinematics: numeric (many starts)"
    if not closed.facts:
        summary = (
            f"kind {kind}, 6 axes; {what}, but no closed form is known for its axes; {numeric}"
        )
        return {"summary": summary}
    if kind != measured:
        advice = f"kind {measured} has closed forms for it"
        return {"summary": f"kind {kind}, 6 axes; {what}: {advice}; {numeric}"}
    if shoulder := closed.facts.get("shoulder"):
        what += f", {FAMILIES[shoulder]}"
    summary = f"kind {kind}, 6 axes; {what}; inverse kinematics: closed form (eight branches)"
    return {**closed.facts, "summary": summary}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _posture_line(robot: Robot, name: str) -> str:
    """Format the non-zero joints of a posture, in degrees or mm."""
    values = [
        f"{joint} {1e3 * q:.4g} mm" if joint in robot.sliding else f"{joint} {math.degrees(q):.4g}°"
        for joint, q in zip(robot.joints, robot.postures[name], strict=True)
        if q != 0.0
    ]
    return f"posture {name}: {', '.join([*values, 'all others 0']) if values else 'all joints 0'}"


def _limits_table(robot: Robot) -> Any:
    """Build the table of joint limits in degrees, or mm for prismatic joints."""
    from rich.table import Table

    figures = numbers("lower °", "upper °", "velocity °/s", "acceleration °/s²", "jerk °/s³")
    table = Table("joint", "group", *figures, "source", title=robot.name, title_justify="left")
    groups = dict.fromkeys(robot.platform, "platform")
    groups |= {joint: arm.name for arm in robot.arms for joint in arm.joints}
    limits = robot.limits
    for k, joint in enumerate(robot.joints):
        slides = joint in robot.sliding
        shown = (limits.lower[k], limits.upper[k], limits.velocity[k])
        rates = (limits.acceleration[k], limits.jerk[k])
        if slides:
            units = ("mm", "mm", "mm/s", "mm/s²", "mm/s³")
            cells = [f"{1e3 * v:g} {u}" for v, u in zip((*shown, *rates), units, strict=True)]
        else:
            cells = [f"{math.degrees(v):.1f}" for v in (*shown, *rates)]
        if not math.isfinite(limits.jerk[k]):
            cells[-1] = "none"
        table.add_row(joint, groups[joint], *cells, limits.source[k])
    return table
