"""`dualarm init`: a project for a bundled or an imported robot.

It can be planned at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_robot
from dualarm_cli.cli.parts.options import (
    ConvexPartsOption,
    JointLimitsOption,
    LeftTipOption,
    PackageDirOption,
    PlatformJointOption,
    RightTipOption,
    SrdfOption,
    XacroArgOption,
)
from dualarm_cli.cli.parts.output import JsonOption, print_json, print_message

DEFAULT_ROBOT = "sda10f"
"""Bundled robot of a project without `--robot`."""


def init_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write: new, or empty.")],
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="NAME|FOLDER|URDF",
            help="A bundled robot, a folder that `dualarm robot import` wrote, or a URDF.",
            show_default=DEFAULT_ROBOT,
            autocompletion=complete_robot,
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
    json_output: JsonOption = False,
) -> None:
    """Write a first project: cell, six reachable picks, layout study and CI workflow.

    A URDF is imported with the options of `dualarm robot import`.
    """
    from dualarm_cli.robot_import.expanded_text import parse_arguments
    from dualarm_cli.robot_import.importing import ImportRequest
    from dualarm_cli.starting.project import refuse_used_folder, start_project
    from dualarm_cli.starting.robot_source import robot_path, robot_source

    refuse_used_folder(folder)
    request = ImportRequest(
        robot_path(robot or DEFAULT_ROBOT),
        srdf,
        joint_limits,
        {side: tip for side, tip in (("left", left_tip), ("right", right_tip)) if tip},
        None if platform is None else tuple(platform),
        tuple(package_dir or ()),
        divided=tuple(divided or ()),
        arguments=parse_arguments(xacro_arg or ()),
    )
    source = robot_source(request)
    if not json_output:
        # Before the search for a table, so that they also explain its refusal.
        for reason in source.reasons:
            print_message(reason)
    files, tools = start_project(folder, source)
    decisions = list(dict.fromkeys([*source.reasons, *tools]))
    if json_output:
        print_json(
            {
                "format": "dualarm.project/1",
                "folder": str(folder),
                "files": files,
                "decisions": decisions,
            }
        )
        return
    for tool in decisions[len(dict.fromkeys(source.reasons)) :]:
        print_message(tool)
    print_message(f"written: {', '.join(str(folder / name) for name in OWN_FILES)}")
    print_message("next:")
    for command, what in NEXT:
        print_message(f"  {command.format(folder=folder):<{WIDTH + len(str(folder))}}{what}")


OWN_FILES = (
    "cell.yaml",
    "tasks.yaml",
    "study.yaml",
    "requirements.txt",
    ".github/workflows/score.yaml",
)
"""Files that people edit."""
NEXT = (
    ("dualarm plan {folder}/tasks.yaml", "a verified schedule of the six picks"),
    ("dualarm robot reach {folder}/cell.yaml", "where else the tools reach"),
    ("dualarm sweep {folder}/study.yaml", "how high the table should stand"),
)
"""Commands for the next steps, with their purpose."""
WIDTH = 32
"""Width of the column of commands, without the folder's name."""
