"""Refusals of buffers: sentences, help and the explanation of their code."""

from __future__ import annotations

from dualarm_cli.explanations import Explanation, KindRefusals

REFUSALS = KindRefusals(
    "E605",
    Explanation(
        "A buffer is full or empty when an arm needs it",
        ("In the given order, a part is taken from an empty buffer or put into a full one.",),
        (
            "Let the planner order the tasks: `order: optimise`.",
            "Let arms wait for each other: `mode: free`.",
            "Change `capacity` or `initial`.",
        ),
        "error[E605]: buffer 'tray' holds 0 of at most 2 parts before stage 1, …",
        "how-to/orders.md",
    ),
    {
        "buffer_in_stage": "buffer '{buffer}' holds {measured} of at most {allowed} parts before stage {stage}, in "
        "which {causes:* while }{either:*}",
        "puts": "{names:and} {names:puts|put} {names:#|#} in",
        "takes": "{names:and} {names:takes|take} {names:#|#} out",
        "either_first": ", and either arm may be the first there",
        "arms_wait_forever": "in the given order the arms wait forever, whichever goes first: "
        "{causes:* and }",
        "waits_for_tasks": "'{task}' waits for tasks that come later ({action})",
        "waits_for_arm": "'{task}' waits for the other arm ({action})",
        "waits_for_room": "'{task}' waits for room in buffer '{buffer}' ({measured} of at most {allowed}) ({action})",
        "waits_for_part": "'{task}' waits for a part in buffer '{buffer}' ({measured} of at most {allowed}) ({action})",
        "buffer_at_border": "buffer '{buffer}' holds {measured} parts after '{task}', where it has to hold 0 to "
        "{allowed}: tasks before a path or coordinate task end before it begins; change the order of the tasks, or "
        "capacity and initial",
    },
    helps={
        "buffer_in_stage": "try order: optimise, mode: free (there arms wait for parts and room), a larger "
        "capacity, another number of parts at the start (initial), or another order in the file",
        "arms_wait_forever": "try order: optimise, a larger capacity, more or fewer parts at the start "
        "(initial), or another order in the file",
    },
)
