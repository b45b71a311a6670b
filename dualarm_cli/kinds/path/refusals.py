# ruff: noqa: E501 (sentences of a table, one a line)
"""Refusals of paths: sentences, remedies and the explanation of their code."""

from __future__ import annotations

from dualarm_cli.explanations import Explanation, KindRefusals

REFUSALS = KindRefusals(
    "E660",
    Explanation(
        "A path cannot be followed",
        (
            "The start is out of reach, a joint limit or a collision ends the path, or the speed is more than the joints allow.",
        ),
        (
            "Allow it to be slower: `slower: allowed`.",
            "Begin near another posture (`posture:`), move the path, or turn the tool.",
        ),
        "error[E660]: task 'wipe' (left): min_norm cannot follow it from any of its 12 starts; …",
        "how-to/paths.md",
    ),
    {
        "path_out_of_reach": "task '{task}' ({arm}): no configuration within the joints' limits{near:*} puts the tools "
        "at the start of the path: at best they are {mm:.1f} mm and {degrees:.1f} deg away{at_limit:*}; move the path, or "
        "turn the tool, or name another posture",
        "near_posture": " near posture '{posture}'",
        "joints_at_limit": ", {joints:*, } at a limit",
        "path_not_followed": "task '{task}' ({arm}): {method} cannot follow it from any of {causes:its|#} starts; {cause}",
        "path_fails_at": "after {time:.3f} s, {places:* and }: {cause}",
        "tool_on_path": "{arm} tool {mm:.1f} mm along its path at ({x:.4f}, {y:.4f}, {z:.4f}) m",
        "path_left": "{method} leaves the path by {measured_mm:.3f} mm (turns by {turn:g} m/rad), tolerance "
        "{allowed_mm:g} mm",
        "path_not_joined": "its joint positions cannot be joined by a curve within the tolerance",
        "path_touches": "after {time:.3f} s {body_a} and {body_b} lack {measured:mm} of clearance",
        "no_closed_forms": "its arms have no closed form",
        "wrist_misses": "the {arm} arm cannot reach: its wrist misses by {mm:.1f} mm at most",
        "joint_limit": "joint {joint} reaches its limit of {bound:g} {unit}",
        "platform_stands": "{cause} while the platform stands",
        "no_branch": "no branch and arm angles of the {arm} arm follow the whole path within the joints' limits while "
        "the platform stands",
        "limit_between": "a joint reaches its position limit between instants",
        "tools_stop": "the tools cannot be followed{also:*}",
        "joints_stop": "the joints cannot follow{also:*}",
        "accelerations_stop": "no accelerations within the joints' limits follow the path{also:*}",
        "joint_exceeds": "joint {joint} would need {measured:.4g} {unit}, allowed {allowed:.4g}",
        "tool_exceeds": "the {arm} tool would move at {measured:.4g} m/s, allowed {allowed:.4g}",
        "path_exceeds": "{cause}{also:*}",
        "singular": "; the posture is nearly singular there (smallest singular value {measured:.2g})",
        "perhaps_beyond_reach": "; is the path out of reach there?",
        "posture_not_held": "; to hold the posture alone joint {joint} needs {measured:.4g} N m, allowed {allowed:.4g}",
        "near_junction": " near where two pieces meet with different curvature ({mm:.1f} mm along; a larger tolerance "
        "rounds the path more)",
        "no_way_to_path": "no motion to its start: {cause}",
    },
    {
        "allow_slower": "allow it to be slower (slower: allowed)",
        "lower_speed": "lower its speed, acceleration or jerk",
        "move_path": "move the path or turn the tool",
        "move_path_or_obstacle": "move the path or the obstacle",
        "other_posture": "begin near another posture (posture:)",
        "tolerance": "raise its tolerance",
        "method": "choose another method (redundancy)",
    },
)
