"""Levers in the page of a plan, from the document of `dualarm why`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dualarm_cli import __version__
from dualarm_cli.page.page import DATA, page_html

WHY = "why.json"
"""Name of the document of `dualarm why` in the folder of a plan."""
_MEMBERS = ("name", "change", "kind", "estimate", "reason", "status", "gain")


def levers_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Select what the page shows of a document of `dualarm why`.

    Sliders have the indices of those that change the same values.
    """
    rows = document["levers"]
    sliders = [k for k, row in enumerate(rows) if row.get("stops")]
    levers = []
    for k, row in enumerate(rows):
        keys = set(row["values"])
        excludes = [i for i in sliders if i != k and not keys.isdisjoint(rows[i]["values"])]
        stops = {"stops": row["stops"], "excludes": excludes} if k in sliders else {}
        levers.append({name: row[name] for name in _MEMBERS} | stops)
    return {
        "levers": levers,
        "combinations": document["combinations"],
        "sentences": document["sentences"],
    }


def kept_levers(folder: Path, pieces: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Read the levers of a plan; None without a document, or with one of another plan.

    Args:
        folder: of the plan.
        pieces: of the page of the plan, with their slack.
    """
    try:
        document = json.loads((folder / WHY).read_text(encoding="utf-8"))
        slack = [(round(row["length"], 6), round(row["slack"], 6)) for row in document["pieces"]]
        fits = slack == [(piece["length"], piece["slack"]) for piece in pieces]
        return levers_of(document) if fits else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def page_with_levers(page: Path, document: Mapping[str, Any]) -> bytes | None:
    """Build a page anew with levers; None without a page, or with one of another version.

    Args:
        page: the page of the plan.
        document: of `dualarm why`.
    """
    try:
        text = page.read_text(encoding="utf-8").partition(DATA)[2].partition("</script>")[0]
        data = json.loads(text)
    except (OSError, ValueError):
        return None
    if data.get("version") != __version__ or "pieces" not in data:
        return None
    return page_html(data | {"levers": levers_of(document)})
