"""Refusals: reasons for the absence of a plan as data, and their sentences.

A solver reports the name of the fault, its place and measured values as data. The sentence is looked up and filled in
here, so that no reader has to parse a place or a number from text. Sentences of a kind of work are in its folder
(`KindRefusals`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from textwrap import indent
from typing import Protocol, TypeVar

from dualarm_cli.explanations import kind_refusals
from dualarm_cli.notes import filled
from dualarm_cli.records import dataclass

Row = TypeVar("Row")


class Located(Protocol):
    """Interface of a place in a file; this module does not import the data model."""

    @property
    def file(self) -> str:
        """Name of the file as given by the user; empty for none."""

    @property
    def line(self) -> int:
        """Line, from 1."""

    @property
    def column(self) -> int:
        """Column, from 1."""

    @property
    def order(self) -> tuple[str, int, int]:
        """Sort key: file, line and column."""


@dataclass(frozen=True)
class Refusal:
    """Reason for the absence of a plan, or a cause within it."""

    key: str
    """Name of the fault: a key of `sentences`."""
    place: Located | None = None
    """Place in a file; None for a cause within another refusal, or without a place."""
    task: str = ""
    """Id of the task."""
    arm: str = ""
    """Name of the arm."""
    measured: float | None = None
    """Measured value [SI units]."""
    allowed: float | None = None
    """Allowed value [SI units]."""
    remedy: tuple[str, ...] = ()
    """Names of remedies, keys of `remedies`, if the fault has several."""
    data: Mapping[str, object] = field(default_factory=dict)
    """Further values of the sentence; refusals become their sentences."""

    def __str__(self) -> str:
        """Format the sentence with its place, if any."""
        return f"{self.place}: {self.sentence}" if self.place is not None else self.sentence

    @property
    def sentence(self) -> str:
        """Sentence without its place."""
        text = self.filled(sentences()[self.key])
        if not self.remedy:
            return text
        *others, last = (remedies()[key] for key in self.remedy)
        return f"{text}; {', '.join(others)}, or {last}" if others else f"{text}; {last}"

    @property
    def advised(self) -> str:
        """Sentence without its place, with advice."""
        help_text = helps().get(self.key)
        return self.sentence if help_text is None else f"{self.sentence}; {self.filled(help_text)}"

    @property
    def about(self) -> dict[str, object]:
        """Task, arm, joint, measured and allowed value [SI units], as far as known."""
        values = {
            "task": self.task or None,
            "arm": self.arm or None,
            "joint": self.data.get("joint"),
        }
        values |= {"value": self.measured, "allowed": self.allowed}
        return {name: value for name, value in values.items() if value is not None}

    def filled(self, template: str) -> str:
        """Fill the data into a template."""
        data = {
            "task": self.task,
            "arm": self.arm,
            "measured": self.measured,
            "allowed": self.allowed,
        }
        return filled(template, {**data, **self.data})


def sentences() -> dict[str, str]:
    """Collect the sentences of all faults by name."""
    return {**SENTENCES, **{k: v for kind in kind_refusals() for k, v in kind.sentences.items()}}


def remedies() -> dict[str, str]:
    """Collect all remedies by name."""
    return {**REMEDIES, **{k: v for kind in kind_refusals() for k, v in kind.remedies.items()}}


def helps() -> dict[str, str]:
    """Collect the advice after all refusals of an error, by fault."""
    return {**HELPS, **{k: v for kind in kind_refusals() for k, v in kind.helps.items()}}


def codes() -> dict[str, str]:
    """Collect the stable short codes by fault, for `dualarm explain CODE`."""
    return {**CODES, **{what: kind.code for kind in kind_refusals() for what in kind.sentences}}


def message(refusals: Iterable[Refusal], placed: Refusal | None = None, begin: str = "") -> str:
    """Write the message for refusals, grouped by kind.

    Args:
        refusals: at least one.
        placed: refusal whose place precedes the text.
        begin: beginning of the line of each refusal, or of those with a common head.
    """
    kinds: dict[str, list[Refusal]] = {}
    for refusal in refusals:
        kinds.setdefault(refusal.key, []).append(refusal)
    return "\n".join(_message_of_kind(key, rows, placed, begin) for key, rows in kinds.items())


def few_at_each_place(
    rows: Sequence[Row], places: Sequence[object], most: int = 3
) -> Iterator[tuple[Row, str]]:
    """Select what is shown of the faults of each place, with the number of the others.

    A repeated task has one place for all its tasks, which often fail alike.

    Args:
        rows: faults in order.
        places: their places; None for a fault that is shown in any case.
        most: number of faults that are shown of each place.
    """
    total, seen = Counter(places), Counter[object]()
    for row, place in zip(rows, places, strict=True):
        seen[place] += 1
        if place is None or seen[place] < most or total[place] == most:
            yield row, ""
        elif seen[place] == most:
            yield row, f"\n... and {total[place] - most} more here"


def _message_of_kind(key: str, rows: list[Refusal], placed: Refusal | None, begin: str) -> str:
    """Write the message for refusals of the same fault, a line for each."""
    places = [row.place if row.place is not None and row.place.line else None for row in rows]
    texts = [
        (refusal.sentence if refusal is placed else str(refusal)) + more
        for refusal, more in few_at_each_place(rows, places)
    ]
    text = "\n".join(begin + text for text in texts)
    if key in HEADS:
        text = f"{begin}{rows[0].filled(HEADS[key])}:\n" + indent("\n".join(texts), "  ")
    help_text = helps().get(key)
    return text if help_text is None else f"{text}\n{rows[0].filled(help_text)}"


_MEETING_HELPS = "try another place to meet, or another `grip`"
_MISFIT_HELPS = (
    "try another target or stand, a part or an obstacle of another size, a shorter line, or "
    "`allowed_contacts` for the two"
)
_SAME_ROOM = "parts lack room in any order"
_SAME_ROOM_HELPS = (
    "try other targets; `touches` for parts that lie on or against each other; `leaves: true` for a part that "
    "is taken out of the cell; a clearance of its own (`clearances`) for the two"
)
_CLEAR_HELPS = (
    "try other targets or tasks in that stage (two arms whose targets are that near need an order in "
    "which they take turns), moving the obstacle, or a clearance of its own (`clearances`) for the "
    "pair{standing:*}"
)
_MISFIT = "no posture avoids a collision of the part or tool"
_NOT_CLEAR = "no collision-free plan was found"

_ORDERS = {
    "waits_forever": "in the given order {names:and} {tasks:waits|wait} forever for tasks that come "
    "later; change the order in the file, or write order: optimise",
    "out_of_reach": "no arm does task '{task}': {causes:*; }",
    "stand_out_of_reach": "the {arm} arm cannot reach the stand of tool '{tool}': {cause}",
    "by_arm": "{arm} arm: {cause}",
    "at_stop": "{action}: {cause}",
    "stops_lack_clearance": "its pick and its place are in reach, but every posture found lacks clearance or a line",
    "stop_lacks_clearance": "it is in reach, but every posture found lacks clearance or a line",
    "arms_cannot_meet": "task '{task}': neither arm can give while the other one takes: at no tried platform angle "
    "do both arms reach it without colliding",
    "arm_cannot_give": "task '{task}': the {arm} arm cannot give while the other one takes: at no tried platform angle "
    "do both arms reach it without colliding",
    "no_order_found": "no order was found that keeps all rules (windows, after, sequences, buffers), though none is "
    "proven to be impossible; allow more time (effort thorough), widen the windows, make room in buffers, or let "
    "more tasks be done by any arm",
    "no_order": "no order does all tasks, even without windows, `after`, sequences and buffers",
    "rule_broken": "no plan keeps this rule, whatever else is done: {rules:*; }",
    "rules_contradict": "no order keeps these rules together, whatever else is done (leave out any one of them and "
    "there may be one): {rules:*; }",
    "late": "task '{task}' is done at {measured:.3f} s, {late:.3f} s after its window closes (not_after: "
    "{allowed:g} s)",
}
_POSTURES = {
    "point_not_turned": "no posture within limits was found with the orientation of {point} ({where})",
    "flange_not_there": "no posture within limits brings the flange nearer to {point} than {measured:mm} with the "
    "required orientation ({where})",
    "beyond_reach": "{point} is {measured:mm} beyond the arm's reach ({where})",
    "too_near_shoulder": "{point} is {measured:mm} too near the shoulder for the elbow joint's limits ({where})",
    "beyond_limits": "at {point} no arm angle and branch keeps all joints within their limits",
    "not_from_one_angle": "its target and the ends of its lines are in reach, but not from one platform angle",
    "not_from_one_turn": "its target and the ends of its lines are in reach, but not at one turn of the tool about its "
    "axis; shorten its lines or move the target",
    "not_from_one_place": "its target and the ends of its lines are in reach, but not from one platform position",
    "posture_misses": "no posture reaches {point}: the nearest one within limits misses it by {measured:mm} and "
    "{degrees:.1f} deg ({where})",
    "stop_impossible": "task '{task}': {arm} arm cannot {action}: {cause}",
    "section_begins": "task '{task}' ({arm}): where its work begins: {cause}",
    "section_ends": "task '{task}' ({arm}): where its work ends: {cause}",
    "section_passes": "task '{task}' ({arm}): after {share:.0%} of its path: {cause}",
    "at_platform_angle": "at best, with the platform at {degrees:.1f} deg",
    "at_platform_place": "at best, with the platform at {millimetres:.1f} mm",
    "platform_stands": "with the platform where it is",
    "from_base": "from its base",
    "every_posture_touches": "{where} every posture lacks clearance: at best {body_a} and {body_b} lack "
    "{measured:mm} of clearance{platform:*}",
    "with_platform": ", with the platform at {degrees:.0f} deg",
    "with_platform_place": ", with the platform at {millimetres:.0f} mm",
    "no_posture": "task '{task}': {arm} arm cannot {action}: {cause}",
    "no_posture_at_any_angle": "task '{task}': {arm} arm cannot {action}: {cause}",
    "no_posture_at_angles_tried": "task '{task}': {arm} arm cannot {action}: {cause}",
    "no_posture_at_any_place": "task '{task}': {arm} arm cannot {action}: {cause}",
    "no_posture_at_places_tried": "task '{task}': {arm} arm cannot {action}: {cause}",
    "no_posture_from_start": "task '{task}': {arm} arm cannot {action}: {cause}",
    "no_common_angle": "reached, but at no platform angle that suits both arms; `dualarm robot reach` with the "
    "cell file shows which angles suit which arm",
    "no_common_place": "reached, but at no platform position that suits both arms; `dualarm robot reach` with the "
    "cell file shows which positions suit which arm",
    "no_pair_of_postures": "collision-free postures were found for single places, but none for this stop and the "
    "other arm's together",
    "no_postures_together": "collision-free postures were found for single places, but none for this stop along "
    "its lines together",
    "no_plan_on_grid": "no plan was found on the grid of nodes",
    "target_out_of_reach": "the target is out of the arm's reach",
    "target_missed": "no posture within limits reaches the target; the nearest one found misses it by {mm:.1f} mm and "
    "{degrees:.1f} deg",
    "target_beyond_limits": "no arm angle and branch keeps all joints within their limits",
    "target_touches": "every posture at the target within limits collides or lacks clearance",
    "lines_not_followed": "no posture at the target can follow its approach and retract lines",
    "lines_not_clear": "no posture at the target can follow its approach and retract lines and are collision-free at "
    "their ends",
    "given_lines_not_followed": "no given configuration can follow its approach and retract lines (a straight wrist or "
    "shoulder is singular); give other configurations, or approach: 0 and retract: 0",
    "arms_touch": "its posture and the other arm's lack clearance in every combination tried",
}
_CLEARANCE = {
    "touches": "{body_a} and {body_b} lack {measured:mm} of clearance",
    "start_touches": "start: in posture '{posture}' {pairs:*, }{rest}; start in another posture (`start: free` "
    "leaves it open), move the obstacle, or, if shapes are wider than the real bodies, list the pairs in "
    "`allowed_contacts`",
    "never_clear": "in every sampled posture {pairs:*, }{rest}; in the cell file give them smaller clearances of their "
    "own, `clearances: [{entries:*, }]`, or list them in `allowed_contacts` if their shapes are wider than they are",
    "pair_clearance": "{{between: [{body_a}, {body_b}], clearance: …}}",
    "part_reaches_into": "task '{task}': where {arm} has to {action} it or on the line there, part '{held}' reaches "
    "{measured:mm} into '{into}', at best",
    "tool_reaches_into": "task '{task}': where {arm} has to {action} it or on the line there, tool '{held}' reaches "
    "{measured:mm} into '{into}', at best",
    "tool_too_near": "task '{task}': {arm} arm cannot {action}: at the target or on its lines {held} and {into} lack "
    "{measured:mm} of clearance, at best",
    "line_ends_near": "task '{task}': {arm} arm cannot {action}: where its {where}, '{held}' is {measured:mm} from "
    "'{into}', at best, and {allowed:mm} are required",
    "same_room": "task '{task}': where it has to {action}, '{body}' {how:*} '{part}' of task '{other_task}', which "
    "{verb} there ({there}), in either order",
    "in_the_way": "task '{task}': where it has to {action}, '{body}' {how:*} '{part}' of task '{other_task}', which "
    "{verb} there in the given order ({there})",
    "room_overlap": "reaches {measured:mm} into",
    "room_gap": "is {measured:mm} from, and needs {allowed:mm} ({spare:mm} more than required) to,",
    "grip_touches": "task '{task}': {where} {body_a} and {body_b} lack {measured:mm} of clearance",
    "not_clear": _NOT_CLEAR,
    "stage_touches": "task '{task}'{partner:*}: {body_a} and {body_b} lack {measured:mm} of clearance {when:.2f} s "
    "into stage {stage}",
    "stage_leans": "task '{task}': the part in the {arm} arm leans {degrees:.1f} deg more than its tilt allows "
    "{when:.2f} s into stage {stage}",
    "stage_lacks_skew": "stage {stage}: the arms come too near to each other when one is up to {allowed:g} s late "
    "(`timing: skew`)",
    "return_touches": "return: {body_a} and {body_b} lack {measured:mm} of clearance {when:.2f} s into stage {stage}",
    "tried": " (tried: {repairs:*, })",
    "other_postures": "other postures",
    "other_angles": "other platform angles",
    "other_places": "other platform positions",
    "delays": "delays",
    "detours": "detours",
    "partner": ", {there}: task '{task}'",
    "stands_in_the_way": "; the {arm} arm stands in posture '{posture}' before stage {stage}, its first: a `move` "
    "before its other tasks moves it away{start:*}",
    "starts_there": " (in stage 1 it starts there: `start: free`)",
    "asynchronous_not_clear": "mode: free: no collision-free motion of both arms "
    "was found while the platform stands at "
    "{places} {unit}",
}
_MOTION = {
    "line_left": "task '{task}': the {line} line is left by {mm:.3f} mm and {angle:.2e} rad, more than {most} mm; "
    "the arm passes too close to a singularity",
    "detour_too_fast": "limits: tool_speed: along a detour a tool exceeds {allowed:g} m/s at any speed of its arm",
    "tool_speed_too_low": "limits: tool_speed: {allowed:g} m/s slows the joints below 1/{slowest} of their speed; "
    "raise it",
}
_TORQUES = {
    "cannot_hold": "{joint} needs {measured:.4g} {unit} to hold still at {time:.2f} s{carrying}, {share:.0%} of its "
    "effort{tried:*}; give a lighter part or another target, or springs and the true effort in the robot file "
    "(`torques`)",
    "other_arm_cannot_hold": ", and the {arm} arm cannot hold it, either",
    "rated": "{joint} needs {measured:.4g} {unit} on average (RMS) over the cycle, {share:.0%} of its rated effort, "
    "even if motion is {factor:g} times slower; give a lighter part, or targets with shorter levers",
    "overload": "{joint} needs {measured:.4g} {unit} at {time:.2f} s{carrying}, {share:.0%} of its effort",
    "torque_on_path": "task '{task}': {cause}, at the speed of the file; write 'slower: allowed', or give at most "
    "{most:.0%} of the speed",
    "torque_on_entry": "task '{task}': {cause}, before the seam; give its entry a longer duration",
    "torque_on_belt": "task '{task}': {cause}, while the tool follows a part on a conveyor; give a lighter part, "
    "another place, or a slower conveyor",
    "late_by_torque": "task '{task}': its part on a conveyor would be met {measured:.3f} s late, as joints are slowed "
    "to their efforts; give a later 'passes', lighter parts, or less work before it",
}
_CALIBRATION = {
    "few_points": "{points:#|#} {points:point does|points do} not determine the base of one robot relative to the "
    "other; touch at least {allowed} that are not on a line, better 4 to 8 that are well spread",
    "points_are_one": "all points of the {arm} robot are the same; touch points well apart",
    "sizes_differ": "the points span {left:.6g} m for the left robot and {right:.6g} m for the right one: they "
    "cannot be the same points; check the units (a plain number is m), the tools and the order of the points",
    "points_on_line": "the points of the {arm} robot are on one line{near:*}: none is more than {mm:.3g} mm off the "
    "line through {ends:* and }, so the rotation about it is not determined; touch a point far from that "
    "line",
    "near_line": " to within {factor:g} times the noise",
    "loose_turn": "the points do not determine the rotation between the robots: about one axis the 95 % interval is "
    "±{degrees:.0f} deg, as the points are nearly on one line or do not match (a coordinate of a residual is "
    "{mm:.3g} mm on average); touch more points, well spread in every direction, and check the tools and robot files",
    "tools_unseen": "tools and transform are not determined together: {few:*}not "
    "observable: {unseen:*; }. Touch at least "
    "{least} points, each with another orientation of the tool about all "
    "three axes, or measure the tools instead of fitting them",
    "few_equations": "{points} points give {equations} equations for {unknowns} unknowns; ",
    "points_do_not_match": "{causes:*; }",
}
_STARTING = {
    "no_table": "no table was found for {robot}: at no height do all its arms reach one with tools that point straight "
    "down, collision-free and from its posture home; write the cell by hand, with targets that the tools can reach "
    "otherwise",
    "no_room_for_table": "what {robot} reaches with tools down is within the room that the robot takes itself; "
    "write the cell by hand, or import the robot with narrower shapes (--convex-parts)",
    "no_room_on_table": "no table in front of {robot} has room for two rows of {count} targets {mm:.3g} mm apart for "
    "each arm, all arms clear of each other. Write the cell by hand: `dualarm robot reach` with the folder of "
    "`dualarm robot import` shows what is reached",
    "no_plan": "no plan was found of {count} picks for each arm, {mm:.3g} mm apart, on any table tried in front of "
    "{robot}. Write the cell by hand: `dualarm robot reach` with the folder of `dualarm robot import` shows what is "
    "reached",
}
_GROUPS: Mapping[str, Mapping[str, str]] = {
    "E600": _ORDERS,
    "E610": _POSTURES,
    "E620": _CLEARANCE,
    "E630": _MOTION,
    "E640": _CALIBRATION,
    "E645": _TORQUES,
    "E680": _STARTING,
}
SENTENCES: Mapping[str, str] = {
    what: sentence for group in _GROUPS.values() for what, sentence in group.items()
}
"""Sentences to fill in by fault, without the kinds of work."""
CODES: Mapping[str, str] = {what: code for code, group in _GROUPS.items() for what in group}
"""Stable short codes by fault, without the kinds of work."""

HEADS: Mapping[str, str] = {
    "late": "no plan was found that is in time",
    "no_posture": "no posture reaches the targets of this stage",
    "no_posture_at_any_angle": "no posture at any platform angle makes this stage",
    "no_posture_at_angles_tried": "no posture at the platform angles that this method tries makes this stage",
    "no_posture_at_any_place": "no posture at any platform position makes this stage",
    "no_posture_at_places_tried": "no posture at the platform positions that this method tries makes this stage",
    "no_posture_from_start": "no posture with the platform held where it starts (a platform moves between stages if it "
    "is one joint: freeze the others) makes this stage",
    "part_reaches_into": _MISFIT,
    "tool_reaches_into": _MISFIT,
    "same_room": _SAME_ROOM,
    "in_the_way": "parts lack room in the given order",
    "grip_touches": "no posture avoids that tools and part are too close to each other in a hand-over",
    "stage_touches": _NOT_CLEAR + "{tried:*}",
    "stage_leans": "no motion was found that keeps parts upright{tried:*}",
    "stage_lacks_skew": _NOT_CLEAR + "{tried:*}",
    "return_touches": _NOT_CLEAR + "{tried:*}",
}
"""Heading before all refusals of an error, by fault."""

HELPS: Mapping[str, str] = {
    "arms_cannot_meet": _MEETING_HELPS,
    "arm_cannot_give": _MEETING_HELPS,
    "late": "try later windows, another arm or order (arm: any, order: optimise), or less work before it",
    "part_reaches_into": _MISFIT_HELPS,
    "tool_reaches_into": _MISFIT_HELPS,
    "same_room": _SAME_ROOM_HELPS,
    "in_the_way": _SAME_ROOM_HELPS + "; another order",
    "grip_touches": "try another `grip`, a longer `approach` or `retract`, or a clearance of its own "
    "(`clearances`) for the two",
    "stage_touches": _CLEAR_HELPS,
    "stage_leans": "try a larger tilt, targets nearer to each other, another arm or grasp, or a place that is turned "
    "about the vertical",
    "stage_lacks_skew": "try a smaller skew, mode: free, or targets and an order that keep the arms apart",
    "return_touches": _CLEAR_HELPS,
}
"""Advice after all refusals of an error, by fault, without the kinds of work."""

REMEDIES: Mapping[str, str] = {
    "move_target": "move the target",
    "move_target_or_free_yaw": "move the target or free its yaw",
    "turn_over": "turn the tool over, whose z axis points up (rpy: [180 deg, 0, 0] points it down)",
    "any_arm": "let the other arm do it (arm: any)",
    "check_unit": "check the units (a plain number is m)",
    "allow_contact": "list the two in `allowed_contacts` if they may touch",
    "move_work": "move the work or the base of the robot",
    "longer_approach": "make `approach` longer or give it another `direction`",
    "longer_retract": "make `retract` longer or give it another `direction`",
    "longer_straight": "make `straight` longer",
    "own_clearance": "give the two a clearance of their own (`clearances`)",
}
"""Remedies by name, without those of the kinds of work."""
