"""Tables and sentences of a plan for the terminal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.schedule import WORK_ENDS
from dualarm_cli.model.verification import exceptions
from dualarm_cli.notes import Note, of_arm
from dualarm_cli.report.printable import numbers

if TYPE_CHECKING:
    from rich.table import Table

NOTHING = "–"
"""Text of empty cells."""
SHOWN = 0.0005
"""Display resolution of times [s] and of fractions."""
SHOWN_DISTANCE = 5e-5
"""Display resolution of distances [m]."""
SHOWN_WAIT = 0.005
"""Display resolution of waits [s]."""
SHOWN_LIMITS = 3
"""Maximum number of single limits in the sensitivity lines."""
LONG_PLAN, SHOWN_STAGES = 12, 5
"""Length of long plans [stages], and number of their longest stages in the table."""
UNMET = (
    *(("order", key) for key in ("fixed", "ended_early")),
    *(("effort", key) for key in ("only", "interrupted")),
    ("platform", "held"),
    ("rate", "reduced"),
)
"""Notes, by topic and key, on unmet requests of a plan.

They are always shown.
"""


def shown_stages(report: dict[str, Any], every: bool = False) -> list[int]:
    """List the first, the longest and the last stages of a long plan.

    Args:
        report: as built by `build_report`.
        every: whether all are shown.
    """
    lengths = [stage["duration"] for stage in report["stages"]]
    last = len(lengths) - 1
    if every or last < LONG_PLAN:
        return list(range(len(lengths)))
    longest = sorted(range(1, last), key=lambda k: -lengths[k])
    return sorted([0, *longest[:SHOWN_STAGES], last])


def stage_table(report: dict[str, Any], shown: Sequence[int] | None = None) -> Table:
    """Build the table of stages: work, times of the arms, bottleneck.

    A value shared by all rows is in the title, or omitted if it means nothing.

    Args:
        report: as built by `build_report`.
        shown: indices of the shown stages; None for all.
    """
    from rich.markup import escape
    from rich.table import Table

    stages, slides = report["stages"], report["platform_slides"]
    title = f"{report['robot']}: stages"
    methods = [stage["platform_solver"] for stage in stages if stage["tasks"]]
    if len(set(methods)) == 1:
        title += f", method {methods[0]}"
    places = [_place(stage["platform_angle"], slides) for stage in stages]
    if len(set(places)) == 1 and places[0] != NOTHING:
        title += f", platform at {places[0]} {'mm' if slides else '°'}"
    moving = {"platform": [stage["platform_time"] for stage in stages]}
    moving |= {arm: [s["arm_times"].get(arm, 0.0) for s in stages] for arm in report["arms"]}
    moving = {name: times for name, times in moving.items() if max(times, default=0.0) >= SHOWN}
    turning = len(set(places)) > 1
    table = Table(
        *numbers("#"),
        "work",
        *numbers("start s", "length s", *(f"{name} s" for name in moving)),
        "bottleneck",
        *(["method"] if len(set(methods)) > 1 else []),
        *(numbers("place mm" if slides else "angle °") if turning else []),
        title=escape(title),
        title_justify="left",
    )
    for k in range(len(stages)) if shown is None else shown:
        stage = stages[k]
        table.add_row(
            str(k + 1),
            escape(stage_work(stage)),
            f"{stage['start']:.3f}",
            f"{stage['duration']:.3f}",
            *(f"{times[k]:.3f}" for times in moving.values()),
            " ".join(filter(None, [stage["bottleneck"], escape(_in_brackets(stage["care"]))]))
            or NOTHING,
            *([stage["platform_solver"]] if len(set(methods)) > 1 else []),
            *([places[k]] if turning else []),
        )
    return table


def _in_brackets(text: str) -> str:
    return f"({text})" if text else ""


def stage_work(stage: Mapping[str, Any]) -> str:
    """Describe the work of a stage, such as `pick a, place b`.

    Args:
        stage: of the report.
    """
    by_action: dict[str, list[str]] = {}
    for item in stage["work"]:
        # The names of visits to stands include their action.
        action = "" if item["action"].endswith("_tool") else item["action"].replace("_", " ")
        by_action.setdefault(action, []).append(item["task"])
    texts = [
        f"{action} {', '.join(dict.fromkeys(tasks))}".strip() for action, tasks in by_action.items()
    ]
    return ", ".join(texts) or ", ".join(stage["tasks"]) or "(return)"


def _place(position: float | None, slides: bool) -> str:
    """Format a platform position [rad or m] in degrees or millimetres, or NOTHING."""
    if position is None:
        return NOTHING
    shown = 1e3 * position if slides else math.degrees(position)
    digits = 1 if slides else 2
    return f"{round(shown, digits) + 0.0:.{digits}f}"


def result_lines(report: dict[str, Any]) -> list[str]:
    """Compose the result: unmet requests, cycle time, budget, verdict with its assumptions."""
    what = "cycle time (period)" if report["closes"] else "duration"
    cycle = f"{what}: {report['cycle_time']:.3f} s"
    if report["parts_per_hour"] is not None and report["parts"]:
        rate = f"{report['parts_per_hour']:.0f} parts per hour"
        cycle += f", {_count(report['parts'], 'part')}, {rate}"
    lines = [f"note: {note}" for note in report["notes"] if _key(note) in UNMET]
    varying = [report["varying"]["text"]] if report["varying"] else []
    lines += [cycle, *varying, *(f"budget: {line['text']}" for line in report["budget"])]
    verification = report["verification"]
    if verification is None:
        return lines
    checks = verification["checks"]
    passed = sum(check["verdict"] == "passed" for check in checks)
    failed = [f"{c['name']}: {c['detail']}" for c in checks if c["verdict"] == "failed"]
    verdict = f"passed ({passed} checks){exceptions(verification['caveats'])}"
    if not verification["passed"]:
        verdict = f"FAILED: {'; '.join(failed)}"
    assumed = f"; assumed: {', '.join(texts)}" if (texts := report["assumed"]) else ""
    return [*lines, f"verification: {verdict}{assumed}"]


def _key(note: str) -> tuple[str, str] | None:
    return (note.topic, note.key) if isinstance(note, Note) else None


def detail_notes(report: dict[str, Any]) -> list[str]:
    """List the notes that the result leaves out."""
    return [note for note in report["notes"] if _key(note) not in UNMET]


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"


def summary_lines(report: dict[str, Any]) -> list[str]:
    """Compose all sentences below the table; the result comes last."""
    lines = []
    for name, use in report["arms"].items():
        lines.append(
            f"{of_arm(name, 'arm', len(report['arms']))}: busy {use['utilisation']:.0%}: "
            f"transfers {use['transfer']:.2f} s, lines {use['approach'] + use['retract']:.2f} s, "
            f"dwells {use['dwell']:.2f} s{_shares(use['dwell_shares'])}, "
            + "".join(f"{kind}s {use[kind]:.2f} s, " for kind in WORK_ENDS if use[kind] > 0)
            + (f"return {use['return']:.2f} s, " if use["return"] > 0 else "")
            + f"waits {use['waiting']:.2f} s"
        )
    lines += _kind_lines("arms", report)
    lines += wait_lines(report)
    lines += _kind_lines("waits", report)
    lines += _kind_lines("work", report)
    if report["bottlenecks"]:
        worst = ", ".join(f"{j} in {n}" for j, n in list(report["bottlenecks"].items())[:4])
        lines.append(f"bottleneck stages: {worst}")
    lines += blending_lines(report)
    lines.append(bound_line(report))
    lines += [report["bodies"]["text"], f"collisions: {report['collisions']}"]
    lines += [f"torque: {text}" for text in _torques(report)]
    lines += _energy(report)
    if report["skew"] is not None:
        lines.append(f"skew: {report['skew']}")
    if report["without_jerk_limit"]:
        lines.append(
            f"no jerk limit, as the robot file says: {', '.join(report['without_jerk_limit'])}"
        )
    lines += report["assumptions"]
    lines += sensitivity_lines(report)
    lines += _effort_lines(report)
    lines += [f"note: {note}" for note in detail_notes(report)]
    return [*lines, *result_lines(report)]


def _torques(report: dict[str, Any]) -> list[str]:
    """Describe the largest torque, or why there is none, if the plan was verified."""
    checks = (report["verification"] or {"checks": []})["checks"]
    return [
        f"not limited: {check['detail']}"
        if check["verdict"] == "not checked"
        else f"{check['measured']:.0%} of a joint's effort at most, {check['detail']}"
        for check in checks
        if check["name"] == "torque"
    ]


def _are_limited(report: dict[str, Any]) -> bool:
    """Check whether the plan had to stay within torques."""
    checks = (report["verification"] or {"checks": []})["checks"]
    return any(c["name"] == "torque" and c["verdict"] != "not checked" for c in checks)


def _energy(report: dict[str, Any]) -> list[str]:
    """Describe the mechanical work of the motion, or nothing without torques."""
    if report["torques"] is None:
        return []
    parts = [
        f"{name} {row['work']:.1f} J work, {row['braking']:.1f} J braking, "
        f"{round(row['net'], 1) + 0.0:.1f} J net"
        for name, row in report["torques"]["energy"].items()
    ]
    return [f"energy at the joints, without losses of motors and gears: {'; '.join(parts)}"]


def _effort_lines(report: dict[str, Any]) -> list[str]:
    """Compose the lines on what efforts permit, and on the effect of lower ones."""
    torques, cycle = report["torques"], report["cycle_time"]
    if torques is None or torques["lower_effort"] is None or cycle <= 0.0:
        return []
    lower = torques["lower_effort"]
    if lower["cycle_time"] is None:
        text = f"{lower['joint']} could not hold still"
    else:
        text = _with_change(lower["cycle_time"], cycle)
        if lower["cycle_time"] - cycle >= SHOWN:
            text += (
                f" with the same motion, slowed for {lower['joint']}; new transfers may be faster"
            )
    lines = [f"efforts {lower['share']:.0%} lower: {text}"]
    factors = {
        name: joint["acceleration_factor"]
        for name, joint in torques["joints"].items()
        if joint["acceleration_factor"] is not None
    }
    if factors and report["assumed_limits"]:
        least = min(factors, key=lambda name: factors[name])
        lines.append(
            f"efforts permit {factors[least]:.2g} times the accelerations of this motion, until {least} reaches its own"
        )
    return lines


def _kind_lines(section: str, report: dict[str, Any]) -> list[str]:
    """Collect the lines of the kinds of work in a section of the report."""
    kinds = [kind for kind in of_kinds("measures") if kind.report_section == section]
    return [line for kind in kinds for line in kind.lines(report)]


def blending_lines(report: dict[str, Any]) -> list[str]:
    """Compose the sentence on the time saved by blending."""
    blending = report["blending"]
    if blending is None:
        return []
    corners = blending["corners"]
    if not corners:
        none = "no faster collision-free plan without these stops was found"
        return [f"blending: tools stop at both ends of all lines; {none}"]
    joints = Counter(f"{corner['joint']} ({corner['limit']})" for corner in corners)
    frequent = ", ".join(f"{name} in {count}" for name, count in joints.most_common(3))
    ends = sum(1 for corner in corners if corner["line"])
    targets = len(corners) - ends
    counts = ((ends, "end", "ends"), (targets, "target of a move", "targets of moves"))
    passed = " and ".join(
        f"{n} {singular if n == 1 else plural}" for n, singular, plural in counts if n
    )
    line = (
        f"blending: {blending['gain']:.3f} s ({blending['share']:.1%}) shorter than with stops at the outer ends of "
        f"lines; {passed} {'is' if len(corners) == 1 else 'are'} passed in motion, limited by {frequent}"
    )
    if blending["largest_deviation"] > 0.0:
        off = 1e3 * blending["largest_deviation"]
        line += f"; beyond their straight parts tools deviate from the lines by up to {off:.1f} mm"
    distance = max((corner["beside"] for corner in corners if not corner["line"]), default=0.0)
    if distance > SHOWN_DISTANCE:
        line += f"; they pass targets of moves at a distance of at most {1e3 * distance:.1f} mm"
    return [line]


def bound_line(report: dict[str, Any]) -> str:
    """Compose the sentence on the lower bound and the grid's optimality gap."""
    if report["lower_bound"] is None:
        line = "lower bound: none computed"
    elif report["lower_bound"] <= 0.0 < report["cycle_time"]:
        line = (
            "lower bound: 0 s, as the grid is too coarse for moves this short; try effort thorough"
        )
    else:
        what = "tasks, in any order," if report["open"] else "stages"
        if (
            report["open"]
            and report["order"] == "given"
            and (report.get("paths") or report.get("seams"))
        ):
            what = "tasks"  # paths and seams divide them in the file's order
        plan = "rest-to-rest plan" if report["blending"] is None else "plan"
        line = f"proven: no {plan} of these {what} is faster than {report['lower_bound']:.3f} s"
        if _are_limited(report):
            line += "; torque limits keep it valid, as they only make plans slower"
    if report["lower_bound"] is not None and (
        report["tool_speed_cap"] is not None or any(stage["care"] for stage in report["stages"])
    ):
        limit = (
            "the limit of the tools' speed"
            if report["tool_speed_cap"]
            else "limits of tasks and parts"
        )
        line += f"; the bound ignores {limit}"
    elif report["grid_gap"] is not None:
        before = "refinement" if report["blending"] is None else "refinement and blending"
        line += (
            f"; before {before} {report['grid_gap']:.1%} above the bound of the search's own grid"
        )
    if report["order_grid_gap"] is not None:
        # Plans leave the grid by different amounts, so this proves nothing about them.
        more = f"more than {gap} " if (gap := f"{report['order_grid_gap']:.1%}") != "0.0%" else ""
        line += f"; on the grid of the search (not among plans) no other order is {more}quicker"
    effort = report["settings"].get("effort")
    return f"{line}; effort: {effort}" if effort else line


def wait_lines(report: dict[str, Any]) -> list[str]:
    """Compose the lines on waits, longest first, and on transfers slowed by the platform."""
    waits, drawn = [], []
    for name, use in report["arms"].items():
        total = sum(use["waited"].values())
        if total >= SHOWN_WAIT:
            reasons = sorted(use["waited"].items(), key=lambda item: -item[1])
            shown = [f"{r.replace('_', ' ')} {t:.2f}" for r, t in reasons if t >= SHOWN_WAIT]
            waits.append(f"{name} {total:.2f} s" + (f" ({', '.join(shown)})" if shown else ""))
        if use["drawn_out_for_platform"] >= SHOWN_WAIT:
            drawn.append(f"{name} {use['drawn_out_for_platform']:.2f} s")
    lines = [f"waits: {', '.join(waits)}"] if waits else []
    if drawn:
        lines.append(f"transfers slowed down until the platform arrives: {', '.join(drawn)}")
    return lines


def sensitivity_lines(report: dict[str, Any]) -> list[str]:
    """Compose the sensitivity lines: all assumed limits together, and the three largest."""
    entries, cycle = report["sensitivity"], report["cycle_time"]
    if cycle <= 0.0:
        return []
    if (
        report["mode"] == "free"
        and report["assumed_limits"]
        and not (entries or report["conveyors"])
    ):
        slowed = cycle / math.sqrt(0.9)  # accelerations fall by the square, jerks by the cube
        return [
            "sensitivity: none for asynchronous arms; with all assumed limits 10 % lower the same motion, slowed, "
            f"takes {_with_change(slowed, cycle)}"
        ]
    together = [entry for entry in entries if entry["joint"] is None]
    single = [entry for entry in entries if entry["joint"] is not None]
    lines = []
    telling = [e for e in single if max(abs(e["lower"] - cycle), abs(e["higher"] - cycle)) >= SHOWN]
    for entry in together[-1:] + telling[:SHOWN_LIMITS]:
        name = f"all assumed {entry['limit']}" if entry["joint"] is None else entry["joint"]
        what = "limits" if entry["joint"] is None else entry["limit"]
        lower, higher = entry["lower"], entry["higher"]
        lines.append(
            f"{name} {what} 10 % lower: {_with_change(lower, cycle)}, "
            f"higher: {_with_change(higher, cycle)}"
        )
    if lines:
        lines[0] = f"sensitivity: {lines[0]}; with unchanged postures; a new plan may be faster"
    if len(telling) > SHOWN_LIMITS:
        lines.append(
            f"these {SHOWN_LIMITS} of {len(single)} limits matter most; report.json has all"
        )
    return lines


def _with_change(time: float, cycle: float) -> str:
    """Format a cycle time and its difference."""
    if abs(time - cycle) < SHOWN:
        return f"{time:.3f} s (no change)"
    share = time / cycle - 1.0
    if abs(share) < SHOWN:
        return f"{time:.3f} s ({(time - cycle) * 1e3:+.0f} ms)"
    return f"{time:.3f} s ({share:+.1%})"


def _shares(shares: dict[str, float]) -> str:
    """Format the purposes of dwells, if there are several."""
    parts = [f"{name} {time:.2f}" for name, time in shares.items() if time > 0]
    return f" ({', '.join(parts)})" if len(parts) > 1 else ""
