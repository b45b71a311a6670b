"""The budget of the code, room by room: `budget.toml` says what each may cost.

A figure there may fall, and rises only in the commit that says what the addition replaced. Where the code has become
smaller its figure has to follow, so that what was saved is not spent unseen.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from collections import Counter, defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "dualarm_cli"
SOURCES = PACKAGE / "compiled" / "src"
BUDGET = tomllib.loads(Path(__file__).with_name("budget.toml").read_text(encoding="utf-8"))
SLACK = 0.02
"""Fraction by which an allowance may exceed the figure of a room, and 20 lines more."""
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
PATHS = sorted(PACKAGE.rglob("*.py"))


@cache
def source(path):
    return path.read_text(encoding="utf-8")


@cache
def tree(path):
    return ast.parse(source(path))


def code_lines(path):
    """Select the numbers of a module's lines without blanks, comments and docstrings."""
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source(path)).readline):
        if token.type not in SILENT:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree(path)):
        body = getattr(node, "body", None)
        for item in body if isinstance(body, list) else []:
            value = item.value if isinstance(item, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                lines -= set(range(item.lineno, item.end_lineno + 1))
    return lines


def room(path):
    """Name the room of a module: its folder, or the module itself beside the folders."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def commands(path):
    """Whether a module's functions have one parameter for each option of a command."""
    return room(path) in ("cli", "interface")


def name_of(path):
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports():
    """Map each module to the modules that it imports when it is loaded."""
    names = {name_of(path) for path in PATHS}
    graph = {}
    for path in PATHS:
        if path.parent == PACKAGE and path.name == "__init__.py":
            continue  # it names what is public
        delayed = set()
        for node in ast.walk(tree(path)):
            hints = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            if hints or isinstance(node, FUNCTIONS):
                delayed.update(ast.walk(node))
        graph[name_of(path)] = targets = set()
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ImportFrom) and node not in delayed:
                full = [f"{node.module}.{alias.name}" for alias in node.names]
                targets.update(one if one in names else node.module for one in full)
        targets &= names - {name_of(path), PACKAGE.name}
    return graph


def held(what, figures, allowed):
    """Compare figures with their allowances, both ways."""
    over = {k: (n, allowed.get(k, 0)) for k, n in figures.items() if n > allowed.get(k, 0)}
    assert over == {}, f"{what} beyond the budget (now, allowed): take something away"
    wide = {
        k: (figures.get(k, 0), n)
        for k, n in allowed.items()
        if n > figures.get(k, 0) * (1.0 + SLACK) + 20
    }
    assert wide == {}, f"{what} have become fewer (now, allowed): lower the budget"


def test_rooms_keep_to_their_lines_of_code():
    figures = Counter()
    for path in PATHS:
        figures[room(path)] += len(code_lines(path))
    held("lines of code", figures, BUDGET["lines"])


def test_settings_are_fields_and_not_module_constants():
    """Names in capitals on the level of a module, each name of a tuple."""
    figures = Counter()
    for path in PATHS:
        for node in tree(path).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
            for target in targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                figures[room(path)] += sum(
                    isinstance(name, ast.Name) and name.id.isupper() for name in names
                )
    held("module constants", figures, BUDGET["constants"])


def test_functions_can_be_read_at_once():
    """At most 60 lines of code."""
    long = {}
    for path in PATHS:
        lines = code_lines(path)
        for node in ast.walk(tree(path)):
            if isinstance(node, FUNCTIONS) and not commands(path):
                size = len(lines & set(range(node.lineno, node.end_lineno + 1)))
                if size > BUDGET["function_lines"]:
                    long[f"{name_of(path)}:{node.name}"] = size
    assert long == {}


def test_modules_are_one_thought():
    """At most 500 lines, with comments and docstrings."""
    lines = {name_of(path): len(source(path).splitlines()) for path in PATHS}
    assert {name: n for name, n in lines.items() if n > 500} == {}


def test_few_functions_have_seven_parameters():
    """Keyword-only ones are counted, `self` and `cls` are not."""
    figures = Counter()
    for path in PATHS:
        for node in ast.walk(tree(path)):
            if isinstance(node, FUNCTIONS) and not commands(path):
                given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                count = len(given) - (bool(given) and given[0].arg in ("self", "cls"))
                figures["over six"] += count > 6
    held("functions with more than six parameters", figures, BUDGET["parameters"])


def test_modules_are_few_and_used_by_more_than_one():
    graph, importers = imports(), Counter()
    for targets in graph.values():
        importers.update(targets)
    inner = {name_of(path) for path in PATHS if path.name not in ("__init__.py", "__main__.py")}
    single = sum(importers[name] == 1 for name in inner)
    assert len(inner) <= BUDGET["modules"]
    assert single <= BUDGET["one_importer"] * len(inner)


def longest(graph):
    """Compute the length of the longest chain that ends at each node; a circle raises CycleError."""
    length = {}
    for node in TopologicalSorter(graph).static_order():
        length[node] = 1 + max((length[other] for other in graph.get(node, ())), default=0)
    return length


def test_imports_have_no_circle_and_are_not_deep():
    """Of modules the longest chain; of folders, each with all that is in it, the levels up to planning."""
    graph = imports()
    assert max(longest(graph).values()) <= BUDGET["module_chain"]
    folders = defaultdict(set)
    for name, targets in graph.items():
        folders[_folder(name)] |= {_folder(other) for other in targets} - {_folder(name), None}
    del folders[None]
    assert longest(folders)["planning"] <= BUDGET["folder_levels"]


def _folder(name):
    """Name the folder of a module, or None beside the folders.

    Kinds of work read files and judge, and both ask which kinds there are: these three are one level.
    """
    parts = name.split(".")
    if not (PACKAGE / parts[1]).is_dir():
        return None
    return "kinds" if parts[1] in ("files", "kinds", "verification") else parts[1]


def test_headers_have_no_circle_and_declare_what_their_source_defines():
    graph = {}
    for header in SOURCES.glob("*.h"):
        text = header.read_text(encoding="utf-8")
        graph[header.name] = set(re.findall(r'#include "(.*)"', text))
        # A header of inline functions has no source.
        source_file = header.with_suffix(".c")
        code = source_file.read_text(encoding="utf-8") if source_file.exists() else ""
        for function in re.findall(r"^\w[\w *]*?(\w+)\([^;{]*\);", text, re.MULTILINE):
            assert re.search(rf"^\w[\w *]*\b{function}\([^;{{]*\)\s*\{{", code, re.MULTILINE), (
                header.name,
                function,
            )
    assert set(TopologicalSorter(graph).static_order()) >= set(graph)


@pytest.fixture(scope="module", autouse=True)
def _free_trees():
    yield
    source.cache_clear()
    tree.cache_clear()
    imports.cache_clear()
