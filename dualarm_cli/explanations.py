# ruff: noqa: E501 (sentences of a table, one a line)
"""Explanations of error codes, as `dualarm explain` and the reference print them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from importlib import import_module

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Explanation:
    """Meaning, causes and remedies of an error code."""

    title: str
    """Fault in a few words."""
    causes: tuple[str, ...]
    """Causes, a sentence each."""
    remedies: tuple[str, ...]
    """Remedies, a sentence each."""
    example: str = ""
    """Example of a message with this code."""
    page: str = ""
    """Page of the documentation on the subject, relative to `docs`."""

    def __repr__(self) -> str:
        """Name the fault in a line."""
        return f"<Explanation: {self.title}>"


@dataclass(frozen=True)
class KindRefusals:
    """Refusals of a kind of work: REFUSALS in `kinds/<kind>/refusals.py`."""

    code: str
    """Stable short code of all its refusals, such as E660."""
    explanation: Explanation
    """Causes and remedies behind the code."""
    sentences: Mapping[str, str]
    """Sentences to fill in, by fault."""
    remedies: Mapping[str, str] = field(default_factory=dict)
    """Advice by name."""
    helps: Mapping[str, str] = field(default_factory=dict)
    """Advice after all refusals of an error, by fault."""


def kind_refusals() -> list[KindRefusals]:
    """Collect the refusals of the kinds of work.

    Errors are a layer below the kinds, whose list is therefore imported by name when a message is written.
    """
    refusals: list[KindRefusals] = import_module("dualarm_cli.kinds").of_kinds("refusals")
    return refusals


def explanations() -> dict[str, Explanation]:
    """Collect the explanations of all codes in order, including the kinds of work."""
    kinds = {kind.code: kind.explanation for kind in kind_refusals()}
    return dict(sorted({**EXPLANATIONS, **kinds}.items()))


EXPLANATIONS: Mapping[str, Explanation] = {
    "E100": Explanation(
        "The file is too large or nested too deeply",
        (
            "Readers have limits, so that a damaged or hostile file cannot take all memory.",
            "A script has written the same entry many times.",
        ),
        (
            "Split the file, or correct the program that wrote it.",
            "Leave parts out of a URDF that neither move nor collide.",
        ),
        "tasks.yaml: E100 has 25.1 MB; at most 20 MB are read",
        "limits.md",
    ),
    "E101": Explanation(
        "The file is not text, or not YAML",
        (
            "A bracket, quote or indentation is wrong; the message shows where reading stopped; the mistake is often one line earlier.",
            "The file is not in UTF-8, is empty, or holds merge-conflict markers.",
        ),
        (
            "Put text that contains `:`, `#`, `{` or `[` in quotes.",
            "Save the file as UTF-8.",
        ),
        "tasks.yaml:5:6: E101 not YAML: did not find expected ',' or '}' while parsing a flow mapping (begun at line 4)",
        "reference/tasks.md",
    ),
    "E102": Explanation(
        "A name or key is used twice",
        ("Two tasks, obstacles, joints or keys of one mapping have the same name.",),
        ("Rename one; the message names the line of the first.",),
        "tasks.yaml:20:9: E102 duplicate task id 'tray-1', first at line 8",
        "how-to/cells.md",
    ),
    "E104": Explanation(
        "A number is not finite",
        ("The file holds `.inf`, `.nan` or a number beyond what a computer stores.",),
        (
            "Write the number; where something is not limited, leave the key out or write what its page says.",
        ),
        "robot.yaml:9:33: E104 non-finite number '.inf' is not allowed",
        "reference/index.md",
    ),
    "E105": Explanation(
        "YAML anchors, aliases and tags are not read",
        ("The file uses `&name`, `*name` or `!tag`. They let a small file become a huge one.",),
        (
            "Write the values where they are used; `defaults` of the task file say what all tasks share.",
            "Put text that begins with `*`, `&` or `!` in quotes.",
        ),
        "tasks.yaml:4:7: E105 alias '*x' is not allowed; repeat the value",
        "how-to/cells.md",
    ),
    "E110": Explanation(
        "A schedule or baseline file is damaged",
        (
            "A `schedule.json` or a baseline of scores was edited, cut off, or written by another program, and a member is missing or has another form.",
        ),
        (
            "Plan again, or replace the baseline with `dualarm score --update-baseline --force`.",
            "For schedules of other programs: the reference describes every member.",
        ),
        "schedule.json: E110 trajectory.time: must be numbers, in rows of equal length",
        "reference/schedule.md",
    ),
    "E200": Explanation(
        "A value is not what its key takes",
        (
            "The unit belongs to another quantity, the number is out of range, or the form differs (a list for a number).",
            "A plain number for an angle is in rad: 180 is refused, `180 deg` is meant.",
        ),
        (
            "Write what the message allows; quantities take units: `80 mm`, `30 deg`, `0.2 s`, `80%`.",
        ),
        "cell.yaml:7:14: E200 unit 'mm' in '30 mm' is not one of angle; allowed: rad, mrad, deg",
        "reference/tasks.md",
    ),
    "E201": Explanation(
        "The key is not known here",
        ("It is misspelt, at the wrong level, or of another kind of file.",),
        ("Take one of the allowed keys; the reference lists all of each file.",),
        "tasks.yaml:5:1: E201 unknown key 'ordr', did you mean 'order'?",
        "reference/tasks.md",
    ),
    "E202": Explanation(
        "Something is missing",
        ("A key that has no default is not there.",),
        ("Add it; the reference shows what each file needs at least.",),
        "tasks.yaml:10:5: E202 'arm' is missing",
        "reference/tasks.md",
    ),
    "E300": Explanation(
        "A value does not fit the rest of the files",
        (
            "It names a frame, part, tool, joint, posture or task that does not exist.",
            "It contradicts another value: a joint position outside its limits, an arm that the robot does not have, rules that no order can keep.",
        ),
        (
            "Compare the names; the message lists the existing ones.",
            "Run `dualarm check` on the file: it reports all such places at once, without planning.",
        ),
        "tasks.yaml:12:17: E300 the cell has no frame 'bin.slot_9', did you mean 'bin.slot_3'? It has: bin, bin.slot_3, world",
        "reference/tasks.md",
    ),
    "E301": Explanation(
        "Schedule and task file are for different robots",
        ("`dualarm verify --tasks` was given the tasks of another cell.",),
        ("Give the task file that the schedule was planned from.",),
        "schedule: E301 schedule and tasks are for different robots: left_s",
        "concepts/verification.md",
    ),
    "E310": Explanation(
        "These kinds of work do not go together in this version",
        (
            "Each is planned by itself, and the planner does not know how to join them: tool changes with paths, for example.",
        ),
        (
            "Divide the job into two files, or leave one of the two out; the page on limits lists the combinations.",
        ),
        "tasks.yaml:18:5: E310 hand-overs do not go with tool changes in this version",
        "limits.md",
    ),
    "E400": Explanation(
        "The robot description is not what it must be",
        (
            "The URDF is not one tree, has impossible limits, inertias or shapes, or a mesh is missing.",
            "An arm is not of the `kind` that the robot file calls it: its axes do not meet as closed forms need.",
            "The file is a xacro file that another command than `robot import` or `init` reads, or that lacks a package or an argument.",
        ),
        (
            "Let `dualarm robot import` write the robot's folder: it expands xacro, finds meshes and makes rounded angles exact.",
            "Name missing packages with `--package-dir FOLDER`, and arguments of xacro files with `--xacro-arg NAME:=VALUE`.",
            "Write rounded angles in full: 1.5707963267948966 for 1.5708.",
            "Write `kind: general` for the arm: it is then planned with numeric inverse kinematics.",
        ),
        "arm.urdf:31:12: E400 link 'la': sphere radius must be above 0, not -0.1",
        "how-to/robot-files.md",
    ),
    "E500": Explanation(
        "A file cannot be read",
        (
            "There is no such file, it may not be read, or the path leads out of the project folder.",
        ),
        (
            "Paths are relative to the file that names them, with forward slashes.",
            "The project folder is the nearest one above that holds `dualarm.toml` or `.git`, else the file's parent's parent: put an empty `dualarm.toml` into the folder that holds everything.",
        ),
        "tasks.yaml:3:7: E500 there is no file 'cel.yaml' here",
        "how-to/cells.md",
    ),
    "E600": Explanation(
        "No order of the tasks keeps all rules",
        (
            "Time windows, `after`, `sequences` or the arms that may do a task contradict each other.",
            "A task is out of reach of every arm that may do it.",
        ),
        (
            "Where the message proves it, change one of the rules that it names.",
            "Where no order was found but none is excluded: `effort` thorough, wider windows, `arm: any`.",
        ),
        "error[E600]: no order keeps these rules together, whatever else is done: …",
        "how-to/orders.md",
    ),
    "E610": Explanation(
        "No posture reaches a target",
        (
            "The target is beyond the arm's reach, too near the shoulder, or turned so that a joint would exceed its limit.",
            "Approach and retract lines must be in reach as well.",
            "Both arms reach their targets of a stage, but from no common platform angle.",
            "Every posture there collides.",
        ),
        (
            "Compare the frame: tools point along their z axis, so a tool that points down has `rpy: [180 deg, 0, 0]`.",
            "Let the tool turn: `free: yaw`, or `symmetry`.",
            "Shorten `approach` and `retract`, or move the target by what the message says.",
            "Give the arms other partners: `order: optimise`, or `mode: free`.",
        ),
        "error[E610]: tasks.yaml:9:5: task 'a': left arm cannot pick: the target is 412.0 mm beyond the arm's reach …",
        "how-to/no-plan.md",
    ),
    "E620": Explanation(
        "No collision-free plan was found",
        (
            "A tool or part is inside an obstacle at its target, or the start collides: `dualarm check` reports both.",
            "Two bodies have to be nearer to each other than the clearance allows: at a target, at the start, or on every motion tried.",
            "Collision shapes are larger than the real bodies, and overlap where the machine does not collide.",
        ),
        (
            "The message names the pair and the missing clearance; move the obstacle or the target, or give the pair a clearance of its own (`clearances`).",
            "For links whose shapes overlap by construction, list the pair in the robot file's `allowed_contacts`.",
            "For arms whose targets are near each other: let them take turns (`mode: free`, or `order: optimise`).",
        ),
        "error[E620]: start: in posture 'home' left_link_5 and table lack 12.0 mm of clearance; …",
        "how-to/collision-free.md",
    ),
    "E630": Explanation(
        "A motion cannot be timed",
        (
            "A line passes too close to a singularity.",
            "The cap on the tools' speed is too low for a detour.",
        ),
        ("Move or shorten the line.", "Raise `limits: {tool_speed: …}`."),
        "error[E630]: task 'a': the approach line is left by 0.032 mm …",
        "concepts/minimum-time.md",
    ),
    "E640": Explanation(
        "The points do not determine the calibration",
        (
            "There are too few points, or they lie on a line.",
            "The points of both robots cannot be the same: their spans differ.",
        ),
        (
            "Touch four to eight points, well spread in every direction.",
            "Check the units (a plain number is m), the tools and the order of the points.",
        ),
        "error[E640]: 2 points do not determine the base of one robot relative to the other; …",
        "how-to/calibration.md",
    ),
    "E645": Explanation(
        "A joint cannot bear its load",
        (
            "Tool and part are too heavy for a joint where the arm has to be.",
            "At its given speed a path, a seam or a conveyor requires more than an effort.",
            "The effort in the URDF is too low, or springs and counterweights are missing in it.",
        ),
        (
            "Give a lighter part, a nearer target, or another arm; paths and seams: `slower: allowed`.",
            "State the true effort or the springs in the robot file: `torques: {…}`.",
            "`torque: checked` in the cell file measures torques without a limit.",
        ),
        "error[E645]: left_7 needs 7.77 N m to hold still at 2.31 s, carrying left box, 111% of its effort; …",
        "how-to/torque.md",
    ),
    "E680": Explanation(
        "No first project was found for a robot",
        (
            "The arms cannot point their tools straight down over a table, or only where the robot itself stands.",
            "Shapes of links are so wide that hardly any posture is clear; `dualarm robot reach` shows what is left.",
            "Joints turn so little that a table has no room for two rows of targets for each arm.",
            "The planner found no plan of the six picks on any table that was tried.",
        ),
        (
            "Write the cell by hand, with fewer targets, or with targets that the tools reach in another direction.",
            "Give links narrower shapes (`dualarm robot import --convex-parts`), or list pairs that may touch in `allowed_contacts`.",
        ),
        "error[E680]: no table was found for stacker: at no height do all its arms reach one …",
        "how-to/first-project.md",
    ),
}
"""Explanations by error code, without those of the kinds of work."""
