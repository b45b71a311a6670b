# ruff: noqa: E501 (sentences of a table, one a line)
"""Refusals of seams: sentences, remedies and the explanation of their code."""

from __future__ import annotations

from dualarm_cli.explanations import Explanation, KindRefusals

REFUSALS = KindRefusals(
    "E670",
    Explanation(
        "A seam cannot be worked",
        (
            "Both arms hold one chain: the tool of one stays on the part in the other. Reach, joint limits, speed or a collision ends it.",
        ),
        (
            "Lower the speed, or write `slower: allowed`.",
            "Let the tool spin or lean (`free: spin`, `tilt`), or let the part move (`hold: free`).",
            "Divide the curve into two tasks, or move it on the part.",
        ),
        "error[E670]: task 'weld' (right on the part in left): too fast: 200 mm/s asked for, at best 91.2 mm/s …",
        "how-to/seams.md",
    ),
    {
        "seam_not_worked": "task '{task}' ({arm}{carrier:*}): {cause}",
        "part_in": " on the part in {arm}",
        "seam_has_no_joints": "{cause}",
        "seam_fails_at": "fails {mm:.1f} mm along the seam of {length_mm:.1f} mm: {cause}",
        "seam_jumps": "each place of it is reached, but no motion was found from one end to the other",
        "seam_goes_on": "no motion along it was found that ends where the next seam can begin",
        "seam_all_touch": "every motion found along it collides or lacks clearance{least:*}",
        "seam_touches_least": "; of the one that does least {cause}, {mm:.1f} mm along the seam",
        "seam_apart": "no configuration brings tool and part together there: the best one misses by {mm:.1f} mm (a "
        "radian counted as {turn:g} m)",
        "seam_not_reached": "the {arm} arm does not reach it{downhand:*}, or is stretched or singular there",
        "seam_upwards": " with its surface within {degrees:g} deg of upwards",
        "seam_joint_limit": "joint {joint} reaches its limit of {degrees:.1f} deg",
        "seam_touches": "{where}, after {time:.3f} s, {cause}; let the tool lean ('tilt') or increase the room around it",
        "seam_comes_apart": "the joint positions found for it do not keep tool and part together between knots; divide "
        "the curve into two tasks, or let the tool spin or lean ('free: spin', 'tilt')",
        "seam_line": "{line}: {cause}; make it shorter",
        "seam_line_out_of_reach": "the {arm} arm does not reach farther than {mm:.1f} mm from the seam",
        "seam_line_at_limit": "joint {joint} reaches its limit {mm:.1f} mm from the seam",
        "seam_line_left": "its line is left by {mm:.3f} mm (or mrad)",
        "seam_exceeds_limits": "no motion along it keeps all limits",
        "seam_exceeds_between": "between its knots a joint exceeds a limit {measured:.4f} times",
        "seam_opens": "the closed chain has an error of {um:.2f} um (or urad) between its knots",
        "seam_uneven": "its speed is uneven by {measured:.2%} between its knots",
        "seam_rushes": "its acceleration is {measured:.2%} above the file's limit between its knots",
        "seam_ramps": "no ramps are gentle enough for the joints' limits; raise the seam's acceleration or the job's speed",
        "seam_ramp_long": "too fast: reaching {asked} takes {measured:.3g} s, but a ramp may take at most {allowed:.3g} "
        "s",
        "seam_capped": "too fast: {asked} required, at best {speed:.4g} mm/s ({duration:.3f} s); the limit of the tools' "
        "speed in the world decides",
        "seam_too_short": "too fast: the curve is too short to reach {asked} and "
        "stop again within the joints' limits; at best "
        "{speed:.4g} mm/s, {duration:.3f} s",
        "seam_too_fast": "too fast: {asked} required, at best {speed:.4g} mm/s ({duration:.3f} s); {kind} of joint "
        "{joint} decides {mm:.1f} mm along the seam",
        "no_way_to_seam": "task '{task}': no motion to the start of its approach (`entry: {{approach: …}}` moves that "
        "start farther away): {cause}",
        "entry_too_short": "task '{task}': the motion to its start takes {measured:.3f} s, more than the "
        "{allowed:g} s that entry gives it; raise or remove its duration",
    },
    {
        "less_speed": "lower its speed",
        "raise_cap": "raise it",
        "slower": "say 'slower: allowed'",
        "divide": "divide the curve into two tasks",
        "shorten": "shorten the curve or divide it",
        "move_curve": "move it on the part ('part', 'curve')",
        "hold_free": "let the part move ('hold: free')",
        "spin": "let the tool spin ('free: spin')",
        "lean": "let it lean ('tilt')",
    },
)
