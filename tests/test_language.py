"""How we write: the field's terms, first lines that stand alone, and no dialect.

Private words and the patterns of a dialect are gone for good; keys of published files keep theirs.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "dualarm_cli"
PUBLISHED = {
    "kinds/seam/reading.py": {"way"},
    "kinds/seam/schema.py": {"way"},
    "report/console.py": {"beside"},
    "report/document.py": {"beside", "part_way"},
}
"""Keys of files and of reports, by the modules that read or write them."""
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
    r"in a ring",
    r"(decided|planned) anew",
    r"ways? of the tools?",
    r"worth while",
    r"drawn out for the platform",
    r"can be had together",
)
"""collision-free; without collision checking; repair; data model; compared with; asynchronous; detour; message;
a cycle; re-planned; paths; worthwhile; slowed down; trade-offs."""


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
    """Yield the first line of each docstring and of each text under a field or constant."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for item in body if isinstance(body, list) else []:
            value = item.value if isinstance(item, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield item.lineno, value.value.strip().split("\n")[0]


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
    published = PUBLISHED.get(path.relative_to(PACKAGE).as_posix(), set())
    for line, text in first_lines(tree):
        if BEGINNINGS.match(text):
            yield "beginnings", line, text
        if len(text.split()) > MOST_WORDS:
            yield "long first lines", line, text
    for line, name in bound_names(tree):
        if name in published:
            continue
        if name.strip("_").lower() in NAMES:
            yield "pronouns as names", line, name
        elif re.search(r"(^|_)ways?(_|$)", name.lower()):
            yield "way", line, name
    for line, text in sentences(source):
        for pattern, phrase in PHRASES.items():
            for match in re.finditer(rf"\b(?:{phrase})\b", text, re.IGNORECASE):
                if match.group() not in published:
                    yield pattern, line, text[max(0, match.start() - 40) : match.end() + 40]


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


def test_no_dialect_is_in_the_package():
    """First lines, names, comments and texts."""
    places = [
        f"{path.relative_to(PACKAGE)}:{line}: {pattern}: {text}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for pattern, line, text in dialect(path)
    ]
    assert places == [], "write as docs/contributing.md says"
