"""`dualarm sweep --perturb` as sentences for the terminal and as CSV."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dualarm_cli.report.comparison.comparison_table import cell_text, csv_bytes
from dualarm_cli.report.comparison.study_table import STATUS_WORDS, one_line_reason


def perturbation_sentences(document: Mapping[str, Any]) -> list[str]:
    """Compose the result: distribution, stated times, stages that react, failures.

    Args:
        document: of `dualarm sweep --perturb`.
    """
    lines = [result_sentence(document)]
    if document["stated"]:
        lines.append(
            f"stated by the report of the nominal plan, of dwells alone: 95 % of the cycles at most "
            f"{document['stated']['95%']:.3f} s, the longest {document['stated']['worst']:.3f} s"
        )
    for stage in document["stages"][:3]:  # files have all
        time, share = stage["time"], stage["share"]
        if share is not None:
            lines.append(
                f"reacts: {stage['work'] or 'return'}: {time['least']:.3f} to {time['worst']:.3f} s, {share:.0%} of "
                "the variance of the cycle time"
            )
    for failure in document["failures"]:
        many = f"{failure['count']} draw{'s' * (failure['count'] > 1)}"
        reason = one_line_reason(failure["example"])
        first = failure["points"][0]
        lines.append(f"{many} {STATUS_WORDS[failure['status']]}; of draw {first}: {reason}")
    return lines


def result_sentence(document: Mapping[str, Any]) -> str:
    """Compose the first sentence: what varies, and the distribution of the cycle time.

    Args:
        document: of `dualarm sweep --perturb`.
    """
    counts, time = document["counts"], document["cycle_time"]
    numbers = [f"{n} {w if n > 1 else w[:-1]}" for w, n in document["varying"].items() if n]
    what = " and ".join(", ".join(numbers).rsplit(", ", 1))
    planned = f"{counts['planned']} of {counts['draws']} draws of {what} have a plan"
    if time is None:
        return f"{document['tasks']}: {planned}"
    nominal = document["nominal"]
    return (
        f"{document['tasks']}: {planned}; cycle time: nominal "
        f"{'none' if nominal is None else f'{nominal:.3f} s'}, median {time['median']:.3f} s, 95 % of them at most "
        f"{time['percentile_95']:.3f} s, worst {time['worst']:.3f} s"
    )


def perturbation_csv(document: Mapping[str, Any]) -> bytes:
    """Write a row for each draw as CSV, in SI units.

    Args:
        document: of `dualarm sweep --perturb`.
    """
    columns = ["draw", "status", "cycle_time", "clearance"]
    table = [[*columns, "reason"]]
    for row in document["rows"]:
        reason = one_line_reason("; ".join(row["reasons"])) or None
        table.append([cell_text(cell) for cell in [*(row[c] for c in columns), reason]])
    return csv_bytes(table)
