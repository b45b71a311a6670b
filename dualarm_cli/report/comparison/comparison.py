"""Document of `dualarm compare solvers`: rows by cycle time, winner and reasons."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.blending import STOPPING
from dualarm_cli.model.job import Job
from dualarm_cli.orders.model.tool_changes import with_changes
from dualarm_cli.report.measures import (
    DWELLS,
    LINES,
    WORK,
    Bottlenecks,
    bottlenecks,
    elbow_imbalance,
    platform_travel,
)
from dualarm_cli.report.report import (
    count_parts,
    relative_gap,
    smallest_clearance,
    throughput,
)
from dualarm_cli.report.stage_parts import PLATFORM

if TYPE_CHECKING:
    from dualarm_cli.planning.comparison import Outcome

SOLVERS = ("method", "redundancy", "timing", "blend")
"""Fields that identify a row."""
ORDER = ("verified", "failed", "infeasible", "not served")
"""Order of rows by status; rows of one status by cycle time."""
LEAST_SAVING = 0.01
"""Least saving that is reported [s]."""
SAME = 1e-6
"""Tolerance of equal cycle times in the ranking [s]."""
SHOWN = 0.0005
"""Display resolution of cycle times [s]."""


def job_comparison(
    name: str,
    job: Job,
    outcomes: Iterable[Outcome],
    bound: float | None,
    assumptions: Sequence[str],
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Build one task file's part of the document, and its wall-clock times.

    Args:
        name: name of the task file in messages.
        job: the planned job.
        outcomes: of all cases; schedules are measured one by one and released.
        bound: lower bound of the job [s], or None.
        assumptions: assumptions of the bound.
    """
    rows, clock = [], []
    for outcome in outcomes:
        row = _row(outcome, job)
        rows.append(row)
        clock.append(
            {
                "tasks": name,
                **{key: row[key] for key in SOLVERS},
                "planning_time": outcome.planning_time,
            }
        )
    times = [row["cycle_time"] for row in rows if row["status"] == "verified"]
    best = min(times, default=0.0)
    order = sorted(range(len(rows)), key=lambda k: _rank(rows[k], best))
    rows, clock = [rows[k] for k in order], [clock[k] for k in order]
    good = [row for row in rows if row["status"] == "verified"]
    section = {
        "tasks": name,
        "robot": job.cell.robot.name,
        "stages": len(with_changes(job).stages()) + job.returns if job.is_decided else None,
        "open": not job.is_decided,
        "parts": count_parts(job),
        "closes": job.returns,
        "lower_bound": bound,
        "lower_bound_assumptions": list(assumptions),
        "rows": rows,
        "winner": {key: good[0][key] for key in SOLVERS} if good else None,
        "sentence": winner_sentence(rows),
    }
    return section, clock


def comparison_document(
    sections: list[dict[str, Any]], clock: list[dict[str, Any]], settings: dict[str, Any]
) -> dict[str, Any]:
    """Build the whole document; wall-clock times are only in its last member.

    Args:
        sections: of the task files.
        clock: planning times of all rows.
        settings: requested settings.
    """
    return {
        "format": "dualarm.comparison/1",
        "settings": settings,
        "comparisons": sections,
        "wall_clock": clock,
    }


def _rank(row: dict[str, Any], best: float) -> tuple[int, float]:
    # Cycle times that print the same are tied: the order of the registry decides.
    time = row["cycle_time"]
    if time is None or abs(time - best) <= SHOWN:
        return ORDER.index(row["status"]), 0.0
    return ORDER.index(row["status"]), round(time / SAME)


def _row(outcome: Outcome, job: Job) -> dict[str, Any]:
    """Build a case's row, in s, rad, and m for sliding platforms.

    The metres are the platform's travel.
    """
    case, schedule = outcome.case, outcome.schedule
    compared = {key: rows for kind in of_kinds("measures") for key, rows in kind.compared.items()}
    row: dict[str, Any] = {
        "method": case.method,
        "redundancy": case.redundancy,
        "timing": case.timing,
        "blend": case.blend,
        "status": outcome.status,
        "reason": outcome.reason,
        **dict.fromkeys(
            ("cycle_time", "parts_per_hour", "gap", "grid_gap", "elbow_imbalance"), None
        ),
        **dict.fromkeys(
            ("clearance", "clearance_cost", "platform_travel", "deciding_stages", "deciding_time"),
            None,
        ),
        "platform_slides": False,
        "caveats": [],
        **{key: [] for key in compared},
    }
    if schedule is None:
        return row
    shares, clearance = bottlenecks(schedule), smallest_clearance(schedule)
    return row | {
        "cycle_time": schedule.duration,
        "parts_per_hour": throughput(schedule, job),
        "gap": relative_gap(schedule),
        "grid_gap": schedule.grid_gap,
        "clearance": None if clearance is None else clearance["clearance"],
        "clearance_cost": schedule.clearance_cost,
        "elbow_imbalance": elbow_imbalance(schedule),
        "platform_travel": platform_travel(schedule),
        "platform_slides": schedule.robot.platform_slides,
        "deciding_stages": shares.stages,
        "deciding_time": shares.time,
        "caveats": [] if schedule.verification is None else list(schedule.verification.caveats),
        **{key: rows(schedule, job) for key, rows in compared.items()},
    }


def winner_sentence(rows: Sequence[dict[str, Any]]) -> str:
    """Compose one or two sentences on the fastest plan, its lead and its bottlenecks.

    Args:
        rows: of one task file, best first.
    """
    good = [row for row in rows if row["status"] == "verified"]
    if not good:
        return "no method finds a plan that passes verification"
    winner, time = good[0], min(row["cycle_time"] for row in good)
    called = row_namer(rows)
    equal = [called(row) for row in good if row["cycle_time"] - time <= SHOWN]
    slower = [row for row in good if row["cycle_time"] - time > SHOWN]
    text = f"{_listed(equal)} {'are equally fast' if len(equal) > 1 else 'is the fastest'} with {time:.3f} s"
    text += ", not fully checked" if winner["caveats"] else ""
    reference = _reference(winner, good)
    against = [row for row in (slower[0] if slower else None, reference) if row is not None]
    against = [row for k, row in enumerate(against) if row not in against[:k]]
    against = [row for row in against if row in slower]
    reasons = [_deciders(winner)]
    if against:
        text += ": " + " and ".join(
            f"{share_text(1.0 - time / row['cycle_time'])} less than {called(row)}"
            for row in against
        )
        reasons.insert(0, _why_faster(winner, against[-1], called(against[-1])))
    because = "; ".join(filter(None, reasons))
    return f"{text}. {because[0].upper()}{because[1:]}" if because else text


def _reference(winner: dict[str, Any], good: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Find the best row of `fixed`, preferably with the winner's timing."""
    fixed = [row for row in good if row["method"] == "fixed"]
    alike = [row for row in fixed if row["timing"] == winner["timing"]]
    return next(iter(alike or fixed), None)


def section_title(section: dict[str, Any], name: str) -> str:
    """Compose the title of a task file's table or panel.

    Args:
        section: one member of the document's `comparisons`.
        name: name of the task file there.
    """
    if section["stages"] is None:
        return f"{name}: {section['robot']}, each method with its own order"
    word = "stage" if section["stages"] == 1 else "stages"
    return f"{name}: {section['robot']}, {section['stages']} {word}"


def share_text(value: float) -> str:
    """Format a fraction in percent, with a second digit if it would be 0.0."""
    return f"{value:.1%}" if value >= 0.001 else f"{value:.2%}"


def _why_faster(winner: dict[str, Any], reference: dict[str, Any], name: str) -> str:
    """Compose the kind of time with the largest saving."""
    mine, theirs = (Bottlenecks({}, row["deciding_time"]) for row in (winner, reference))
    pairs = [("transfers", mine.transfers, theirs.transfers)]
    pairs += [
        (what, mine.time.get(what, 0.0), theirs.time.get(what, 0.0))
        for what in (LINES, DWELLS, *WORK.values())
    ]
    saved = [pair for pair in pairs if pair[2] - pair[1] > LEAST_SAVING]
    if not saved:
        return ""
    what, a, b = min(saved, key=lambda pair: pair[1] - pair[2])
    return f"{what} take {a:.2f} s ({name}: {b:.2f} s)"


def _deciders(row: dict[str, Any]) -> str:
    """Compose the joint group that decides most transfers of a plan."""
    counts = row["deciding_stages"]
    total = sum(counts.values())
    if sum(row["deciding_time"].values()) <= 0.0 or not total:
        return ""
    group, count = max(counts.items(), key=lambda item: item[1])
    which = "its only transfer" if total == 1 else f"{count} of {total} transfers"
    return f"the {group_name(group)} decides {which}"


def group_name(group: str) -> str:
    """Name a joint group for people."""
    return group if group == PLATFORM else f"{group} arm"


def varied_solvers(rows: Sequence[dict[str, Any]]) -> list[str]:
    """List the solvers besides the method that differ between the rows."""
    return [key for key in SOLVERS[1:] if len({row[key] for row in rows}) > 1]


def row_namer(rows: Sequence[dict[str, Any]]) -> Any:
    """Create a function that names rows by method and varied solvers."""
    varied = varied_solvers(rows)

    def called(row: dict[str, Any]) -> str:
        words = [row[key] for key in varied if key != "blend"]
        rest = ", ".join(
            [*words, *([f"blend {STOPPING.name}"] if row["blend"] == STOPPING.name else [])]
        )
        return f"{row['method']} ({rest})" if rest else str(row["method"])

    return called


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + f" and {words[-1]}"
