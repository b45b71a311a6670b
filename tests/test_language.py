"""The field's terms: private words of this project do not come back into messages, names and docstrings."""

from __future__ import annotations

import re
from collections.abc import Iterable
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
    r"for ever",
    r"(is|stands) there (already|twice)",
    r"is due (right )?after",
    r"say order",
    r"no way (was found|to where)",
)
"""collision-free; without collision checking; repair; data model; compared with; asynchronous; detour; message."""


PATTERN = re.compile(rf"\b(?:{'|'.join(PRIVATE)})\b", re.IGNORECASE)
ROOT = PACKAGE.parent


def found_in(paths: Iterable[Path]) -> list[str]:
    """Returns the private words of files, line by line and across the end of a line of text."""
    found = []
    for path in sorted(paths):
        text = re.sub(r"[\"'\s]+", " ", path.read_text(encoding="utf-8").replace("_", " "))
        found += [f"{path.relative_to(ROOT)}: {one.group()}" for one in PATTERN.finditer(text)]
    return found


def test_no_private_word_is_in_the_package():
    """Messages, names, docstrings and comments."""
    assert found_in(PACKAGE.rglob("*.py")) == []


def test_no_private_word_is_in_the_documentation():
    """README and every page."""
    assert found_in([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]) == []


def test_modules_say_what_is_in_them():
    """By the name of a thing, which one may search for: no clause as "What a solver is asked"."""
    clause = re.compile(r'"""(?:What|How|Where|Which|Who|Whether|Everything|So many)\b')
    modules = PACKAGE.rglob("*.py")
    assert [path for path in modules if clause.match(path.read_text(encoding="utf-8"))] == []
