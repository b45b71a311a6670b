"""Bodies in collision checks, and notes on omissions in cell files.

`plan` and `check` say the same of a job; further kinds of bodies belong into `bodies`.
"""

from __future__ import annotations

from typing import Any

import pinocchio as pin

from dualarm_cli.collision.solids import cell_solids, shaped_hands, tools_without_shape
from dualarm_cli.model.job import TAKES, Job, JointTarget
from dualarm_cli.model.lying import lying_parts
from dualarm_cli.model.part_flow import kind_of_part
from dualarm_cli.notes import Note, NoteTable, listed

_note = NoteTable(
    "cell",
    no_tool="{arm} arm has no tool: targets are for its flange, link {flange}; `tools: {{{arm}: …}}` in the "
    "cell file describes one",
    no_clearance="clearance is 0 mm: bodies may touch; `clearance: 10 mm` in the cell file keeps them apart",
)


def bodies(job: Job) -> dict[str, Any]:
    """List a job's bodies with and without shapes, and describe them.

    Bodies are the links that move, tools, carried parts and obstacles. Parts that no task names have no shape.
    """
    cell = job.cell
    model = pin.buildModelFromXML(cell.robot.urdf)
    solids = cell_solids(cell, model, job.carried())
    carried = {joint: _links_of(model, joint) for joint in range(model.njoints)}
    link_names = {link for links in carried.values() for link in links}
    # A part that is handed over has a second name in the taker's hand.
    names = dict.fromkeys(kind_of_part(solid.body) for solid in solids)
    links = [name for name in names if name in link_names]
    others = [name for name in names if name not in link_names]
    shaped = {solid.joint for solid in solids}
    missing = [links[0] for k, links in carried.items() if k and k not in shaped and links]
    missing += tools_without_shape(cell)
    parts = list(
        dict.fromkeys(
            task.id
            for task in job.tasks
            if not task.part and not task.is_change and TAKES & {s.action for s in task.stops}
        )
    )
    text = f"bodies: {listed([f'{len(links)} links', *others])}"
    lying = lying_parts(job, [(task, stop) for task in job.tasks for stop in task.stops])
    if lying:
        waiting = sum(part.stop.action == "pick" for part in lying)
        text += f", parts where they wait ({waiting}) and lie ({len(lying) - waiting})"
    without = [listed(missing)] if missing else []
    without += [f"the parts of {listed(parts)} (no `part` in their tasks)"] if parts else []
    if without:
        text += f"; without shapes, so not checked for collisions: {', '.join(without)}"
    loose = [
        f"the part of {t.id} where it {'lies' if s.action == 'place' else 'waits'}"
        for t in job.tasks
        for s in t.stops
        if cell.parts.get(t.part)
        and isinstance(s.target, JointTarget)
        and not (t.leaves and s.action == "place")
    ]
    loose += [f"the {arm} arm's tools at their stands" for arm in cell.tool_changes]
    if loose:
        text += f"; no bodies: {listed(list(dict.fromkeys(loose)))}"
    return {"text": text, "checked": list(names), "without_shape": missing, "without_part": parts}


def _links_of(model: pin.Model, joint: int) -> list[str]:
    """List the links that a joint carries, starting with its own."""
    return [f.name for f in model.frames if f.parentJoint == joint and f.type == pin.BODY]


def cell_notes(job: Job) -> list[Note]:
    """List notes on arms without a tool, and on a clearance of 0."""
    notes, hands = [], shaped_hands(job.cell.robot)
    for arm in job.cell.robot.arms:
        tool = job.cell.tools[arm.name]
        bare = not tool.shapes and tool.tcp.isIdentity(1e-9) and arm.name not in hands
        if bare and any(task.allows(arm.name) and not task.tool for task in job.tasks):
            notes.append(_note("no_tool", arm=arm.name, flange=arm.flange))
    if job.cell.clearance == 0.0:
        notes.append(_note("no_clearance"))
    return notes
