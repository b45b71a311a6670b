"""Which bodies a job has, and what its cell file leaves out."""

from __future__ import annotations

import dataclasses

import numpy as np

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Tool
from dualarm_cli.model.job import JointTarget
from dualarm_cli.report.bodies import bodies, cell_notes
from dualarm_cli.verification.clearance_checks import check_shapes


def test_bodies_with_and_without_shapes_are_told(tasks_folder):
    """As the files say: the pipe joint's gripper of the seam has no shape, every other body that is named has one."""
    seam = bodies(load_job(tasks_folder / "10_seam" / "tasks.yaml"))
    assert seam["without_shape"] == ["left_tool"]
    assert seam["without_part"] == []
    assert seam["text"] == (
        "bodies: 16 links, right_tool; without shapes, so not checked for collisions: left_tool"
    )
    handover = bodies(load_job(tasks_folder / "13_hand_over" / "tasks.yaml"))
    assert handover["text"] == (
        "bodies: 16 links, left_tool, right_tool, bracket, table, parts where they wait (2) and lie (2)"
    )
    changed = bodies(load_job(tasks_folder / "14_two_grippers" / "tasks.yaml"))
    assert {"left_fingers", "left_suction", "table", "rack"} <= set(changed["checked"])
    screws = [f"screw-{k}" for k in range(1, 6)]
    assert sorted(changed["without_part"]) == ["plate-1", "plate-2", *screws]
    assert changed["text"].endswith(
        "without shapes, so not checked for collisions: the parts of "
        f"{', '.join(changed['without_part'])} (no `part` in their tasks); no bodies: "
        "the left arm's tools at their stands"
    )


def test_parts_at_joint_positions_are_named_as_no_bodies(tasks_folder):
    """Where the tool is there is not in the job: the part is a body in the arm's hand alone."""
    job = load_job(tasks_folder / "06_shared_bin" / "tasks.yaml")
    first = job.tasks[0]
    target = JointTarget(np.zeros((1, 7)))
    stops = (first.stops[0], dataclasses.replace(first.stops[1], target=target))
    job = dataclasses.replace(job, tasks=(dataclasses.replace(first, stops=stops), *job.tasks[1:]))
    waiting = len(job.tasks)
    assert bodies(job)["text"].endswith(
        f"parts where they wait ({waiting}) and lie ({waiting - 1}); "
        f"no bodies: the part of {first.id} where it lies"
    )


def test_a_changed_tool_without_a_shape_is_named(tasks_folder):
    """By the verifier as well: the plan with it is not fully checked."""
    job = load_job(tasks_folder / "14_two_grippers" / "tasks.yaml")
    left = job.cell.tool_changes["left"]
    bare = dataclasses.replace(left.tools["suction"].tool, shapes=())
    suction = dataclasses.replace(left.tools["suction"], tool=bare)
    changes = {"left": dataclasses.replace(left, tools={**left.tools, "suction": suction})}
    job = _with(job, tool_changes=changes)
    assert bodies(job)["without_shape"] == ["left_suction"]
    assert [check.detail for check in check_shapes(job)] == ["no shapes of left_suction"]


def test_links_without_a_shape_are_named(tasks_folder):
    """The planar robot of [Bottin2021] has bars for links 3 and 4 of each arm only."""
    found = bodies(load_job(tasks_folder / "03_bottin_planar" / "tasks.yaml"))
    bars = {f"{arm}_link_{k}" for arm in ("left", "right") for k in (3, 4)}
    assert bars < set(found["checked"])
    others = [f"{arm}_link_{k}" for arm in ("left", "right") for k in (1, 2, 5, 6, 7)]
    assert found["without_shape"] == others


def test_a_working_arm_without_a_tool_is_told(tasks_folder):
    """Not one that has a shape, a tool centre point or changed tools for all that it does; clearance 0 likewise."""
    job = load_job(tasks_folder / "14_two_grippers" / "tasks.yaml")
    assert cell_notes(job) == []
    bare = {arm: dataclasses.replace(tool, shapes=()) for arm, tool in job.cell.tools.items()}
    assert cell_notes(_with(job, tools=bare)) == []
    none = {arm: Tool(job.cell.tools["left"].tcp.Identity()) for arm in job.cell.tools}
    notes = cell_notes(_with(job, tools=none, clearance=0.0))
    # All that the left arm does, it does with fingers or suction.
    assert notes == [
        "right arm has no tool: targets are for its flange, link right_tool0; `tools: {right: …}` in the cell file "
        "describes one",
        "clearance is 0 mm: bodies may touch; `clearance: 10 mm` in the cell file keeps them apart",
    ]
    idle = dataclasses.replace(
        _with(job, tools=none), tasks=tuple(t for t in job.tasks if t.arm == "left")
    )
    assert cell_notes(idle) == []


def _with(job, **changes):
    return dataclasses.replace(job, cell=dataclasses.replace(job.cell, **changes))
