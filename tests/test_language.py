"""The field's terms: private words of this project do not come back into messages, names and docstrings."""

from __future__ import annotations

import re
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "dualarm_cli"
PRIVATE = (
    r"(keeps?|keeping|kept) clear",
    r"blind(ly)?",
    r"mend(s|ed|ing|able)?",
    r"nouns?",
    r"(held|holds?) against",
    r"clocks? of (its|their) own",
    r"stops? aside",
    r"(is|are|was|were) told",
    r"what is said",
)
"""collision-free; without collision checking; repair; data model; compared with; asynchronous; detour; message."""


def test_no_private_word_is_in_the_package():
    """Line by line, and across the end of a line of text."""
    pattern = re.compile(rf"\b(?:{'|'.join(PRIVATE)})\b", re.IGNORECASE)
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        text = re.sub(r"[\"'\s]+", " ", path.read_text(encoding="utf-8").replace("_", " "))
        found += [f"{path.relative_to(PACKAGE)}: {one.group()}" for one in pattern.finditer(text)]
    assert found == []
