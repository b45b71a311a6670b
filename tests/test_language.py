"""How we write: the field's terms, first lines that stand alone, and no dialect.

Private words are gone for good. Patterns that are still being removed are counted room by room against
`language.toml`, whose figures may only fall.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "dualarm_cli"
ALLOWED = tomllib.loads(Path(__file__).with_name("language.toml").read_text(encoding="utf-8"))
SLACK = 10
"""Occurrences by which an allowance may exceed a room's count."""
MOST_WORDS = 16
BEGINNINGS = re.compile(r"(What|How|Where|Which|So many|By|Of|One)\b")
PHRASES = {
    "way": r"(?<!one-)ways?",
    "unnamed actors": r"nobody|somebody|anybody|everybody|whoever",
    "fillers": r"of which|for it to be|at all|in all|beside|there (?:is|are) not|none where none|decided anew"
    r"|(?:come|comes|came) to|gone by|done with|taken apart|so many",
    "judgements": r"hopeless|unlucky|dear|patient|roomy|promising|worth|badness",
    "feeling and speech": r"asks|tells|knows|wants|serves|go(?:es)? without|heeds|minds",
}
NAMES = {
    *(
        "one",
        "other",
        "own",
        "found",
        "some",
        "way",
        "ways",
        "worth",
        "hopeless",
        "unlucky",
        "dear",
    ),
    *("told", "asked", "known", "those"),
}
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
    """List the private words of files, line by line and across the end of a line of text."""
    found = []
    for path in sorted(paths):
        text = re.sub(r"[\"'\s]+", " ", path.read_text(encoding="utf-8").replace("_", " "))
        found += [f"{path.relative_to(ROOT)}: {one.group()}" for one in PATTERN.finditer(text)]
    return found


def first_lines(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line and first sentence of each docstring and of each text under a field or constant."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for item in body if isinstance(body, list) else []:
            value = item.value if isinstance(item, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                paragraph = " ".join(value.value.strip().split("\n\n")[0].split())
                yield item.lineno, re.split(r"(?<=[.;:]) ", paragraph)[0]


def bound_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line and name of each variable, parameter, field, function and class."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.lineno, node.name


def sentences(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each comment and string."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if (
            token.type in (tokenize.COMMENT, tokenize.STRING)
            or "FSTRING" in tokenize.tok_name[token.type]
        ):
            yield token.start[0], " ".join(token.string.split())


def dialect(path: Path) -> Iterator[tuple[str, int, str]]:
    """Yield pattern, line and text of each place that is not written as the field writes."""
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    for line, text in first_lines(tree):
        if BEGINNINGS.match(text):
            yield "beginnings", line, text
        if len(text.split()) > MOST_WORDS:
            yield "long first lines", line, text
    for line, name in bound_names(tree):
        if name.strip("_").lower() in NAMES:
            yield "pronouns as names", line, name
        elif re.search(r"(^|_)ways?(_|$)", name.lower()):
            yield "way", line, name
    for line, text in sentences(source):
        for pattern, phrase in PHRASES.items():
            for match in re.finditer(rf"\b(?:{phrase})\b", text, re.IGNORECASE):
                yield pattern, line, text[max(0, match.start() - 40) : match.end() + 40]


def count() -> dict[str, Counter[str]]:
    """Count the places by pattern and room: a folder of the package, or a module beside the folders."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for path in PACKAGE.rglob("*.py"):
        room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for pattern, _, _ in dialect(path):
            counts[pattern][room] += 1
    return counts


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


def test_dialect_only_falls():
    """Each pattern, in each room; the figure follows where a room was rewritten."""
    counts = count()
    over = [
        f"{pattern} in {room}: {n}, allowed {ALLOWED.get(pattern, {}).get(room, 0)}"
        for pattern, rooms in counts.items()
        for room, n in rooms.items()
        if n > ALLOWED.get(pattern, {}).get(room, 0)
    ]
    assert over == [], "write as docs/contributing.md says"
    wide = [
        f"{pattern} in {room}: {counts[pattern][room]}, allowed {allowed}"
        for pattern, rooms in ALLOWED.items()
        for room, allowed in rooms.items()
        if allowed > counts[pattern][room] + SLACK
    ]
    assert wide == [], "lower the allowance"
