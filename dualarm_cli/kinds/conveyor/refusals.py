# ruff: noqa: E501 (sentences of a table, one a line)
"""Refusals of parts on conveyors: sentences, remedies and the explanation of their code."""

from __future__ import annotations

from dualarm_cli.explanations import Explanation, KindRefusals

REFUSALS = KindRefusals(
    "E650",
    Explanation(
        "A part on a conveyor is not met in time",
        (
            "The part leaves the window before an arm can be there, or an arm cannot follow it within its joints' limits.",
        ),
        (
            "Give a later `passes`, a longer `within`, or a slower conveyor.",
            "Let another arm do it (`arm: any`), or less before it (`order: optimise`).",
        ),
        "error[E650]: task 'a': the left arm cannot be at the pick before 3.210 s, when it is 45.0 mm beyond …",
        "how-to/conveyor.md",
    ),
    {
        "window": "conveyor '{conveyor}' ({speed:g} m/s) passes at {passes:g} "
        "s and is {within:g} m farther at {last:.3f} s",
        "delayed": " ({measured:.3f} s of it to avoid collisions, or for torques)",
        "part_gone": "task '{task}': the {arm} arm cannot be at the {action} before {time:.3f} s{delay:*}, when it is "
        "{measured:mm} beyond what 'within' allows: {window}; give a later 'passes', a longer 'within', a slower "
        "conveyor, another arm or order (arm: any, order: optimise), or less work before it",
        "part_not_followed": "task '{task}': no motion was found for the {arm} arm to follow the {action} from {time:.3f} "
        "s on: {cause}; {window}; give a 'passes' pose and 'within' that leave room before and after it, a "
        "slower conveyor, a shorter approach, retract or dwell, another arm",
        "parts_not_met": "no times were found at which the arms meet the parts of {stops:* and }: {windows:*; }; "
        "slow the conveyor down, or let the parts come at different times for both arms",
        "stop_of": "'{task}' ({action})",
        "parts_missed": "no collision-free plan was found in which the arms meet the parts on conveyors in time; "
        "leave more room between the arms, pair other targets in one stage (order: optimise), or slow the "
        "conveyor down",
        "conveyor_above_cap": "the conveyor moves at {measured:g} m/s, the tool's speed is capped at {allowed:g} m/s "
        "(limits: tool_speed); raise the limit, or slow the conveyor down",
        "part_left": "the tool cannot follow the part on the conveyor within {micrometres:g} um; the arm passes too "
        "close to a singularity",
        "conveyor_too_fast": "it cannot keep up with the conveyor at {speed:g} m/s there: its joints would exceed a "
        "limit by a factor of {measured:.3g} with any start",
        "conveyor_overload": "{joint} cannot hold still there within its effort",
        "conveyor_leaves_reach": "a joint limit, the arm's reach or a singularity ends its motion before the stop is over",
    },
)
