"""The shape of the code: folders, their imports, and the names in them."""

from __future__ import annotations

import ast
import re
import tomllib
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from dualarm_cli import kinds
from dualarm_cli.refusals import HEADS, helps, remedies, sentences

PACKAGE = Path(__file__).parent.parent / "dualarm_cli"
MOST_MODULES = 20
"""Modules in one folder, `__init__.py` not counted."""
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def modules():
    """Returns the package's modules by their dotted names."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def parsed(path):
    """Returns a module's syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(path):
    """Returns all nodes of a module's syntax tree."""
    return tuple(ast.walk(parsed(path)))


@pytest.fixture(scope="module", autouse=True)
def _forgotten():
    """Frees the trees when the last of these tests is over."""
    yield
    parsed.cache_clear()
    nodes.cache_clear()


def imported(path, names):
    """Returns the package's modules that a module imports, wherever in it."""
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE.name):
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield full if full in names else node.module


def folder(path):
    """Returns the folder of a module; a module beside the rooms (errors, registry) counts as one of its own."""
    room = path if path.parent == PACKAGE else path.parent
    return room.relative_to(PACKAGE.parent).as_posix()


def test_no_folder_has_more_modules_than_a_reader_can_hold():
    """At most 20; what has more hides rooms that are not there yet."""
    sizes = defaultdict(int)
    for path in modules().values():
        sizes[folder(path)] += path.name != "__init__.py"
    assert {name: size for name, size in sizes.items() if size > MOST_MODULES} == {}


def test_folders_do_not_import_each_other():
    """Folders can be put in an order in which each imports from earlier ones only; a circle raises CycleError.

    The package's own `__init__` does not count: it names what is public.
    """
    names, graph = modules(), defaultdict(set)
    for name, path in names.items():
        if name == PACKAGE.name:
            continue
        for other in imported(path, names):
            if folder(names[other]) != folder(path):
                graph[folder(path)].add(folder(names[other]))
    assert list(TopologicalSorter(graph).static_order())


def test_the_contract_keeps_every_kind_of_work_apart():
    """The list of the import contract is that of the kinds."""
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    [modules] = [
        contract["modules"]
        for contract in project["tool"]["importlinter"]["contracts"]
        if contract["type"] == "independence"
    ]
    assert sorted(modules) == sorted(f"{kinds.__name__}.{kind}" for kind in kinds.KINDS)


def test_public_class_names_are_unique():
    """A name that is looked up leads to one place."""
    places = defaultdict(list)
    for name, path in modules().items():
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_every_room_is_on_the_map():
    """`docs/architecture.md` names each folder of the package, and each folder says in a sentence what it is for."""
    text = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    for path in PACKAGE.iterdir():
        if path.is_dir() and (path / "__init__.py").exists():
            assert f"`{path.name}`" in text, path.name
    for init in PACKAGE.rglob("__init__.py"):
        assert ast.get_docstring(parsed(init)), init


def test_limits_have_one_law_and_a_job_one_pace():
    """`JointLimits.law` and `Job.limits` alone compute what follows from limits and from a job's speed."""
    found = set()
    for name, path in modules().items():
        for node in nodes(path):
            if isinstance(node, ast.Call):
                call = ast.unparse(node)
                if re.search(r"limits\.scaled\(.*\bspeed\)$", call) or re.match(
                    r"RestToRest\((\w+)\.velocity, \1\.acceleration, \1\.jerk\)$", call
                ):
                    found.add((name.removeprefix("dualarm_cli."), call))
    assert found == {
        ("model.job", "self.cell.robot.limits.scaled(self.speed)"),
        ("model.robot", "RestToRest(self.velocity, self.acceleration, self.jerk)"),
    }


def test_no_code_compares_a_blending_with_a_word():
    """Members of BLENDINGS say what depends on them."""
    words, found = {"none", "lines"}, []
    for name, path in modules().items():
        for node in nodes(path):
            if isinstance(node, ast.Compare) and "blend" in ast.unparse(node):
                parts = (node.left, *node.comparators)
                if any(isinstance(part, ast.Constant) and part.value in words for part in parts):
                    found.append(f"{name}:{node.lineno}")
    assert found == []


TEXT_METHODS = {"search", "match", "fullmatch", "findall", "finditer", "split", "sub"}


def test_no_message_of_an_error_is_matched_by_a_pattern():
    """What an error says is for people; `InfeasibleError.refusals` has the data."""
    found = []
    for name, path in modules().items():
        caught = {node.name for node in nodes(path) if isinstance(node, ast.ExceptHandler)}
        for call in nodes(path):
            if isinstance(call, ast.Call) and getattr(call.func, "attr", "") in TEXT_METHODS:
                names = {
                    node.id
                    for part in call.args
                    for node in ast.walk(part)
                    if isinstance(node, ast.Name)
                }
                found += [f"{name}: {one}" for one in sorted(names & (caught - {None}))]
    assert found == []


CUTS = {"startswith", "endswith", "removeprefix", "removesuffix", "partition", "rpartition"}


def test_no_sentence_of_our_own_is_cut_or_searched():
    """Notes have topics, errors have fields: what is said is data until it is printed."""
    sentences = re.compile(
        r"(^|\.)(note|message|reason|sentence|detail|assumption|doing)s?$|^str\((error|failure|line|found|note|check|refusal)\)$",
        re.IGNORECASE,
    )
    found = set()
    for name, path in modules().items():
        for node in nodes(path):
            texts = []
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in CUTS:
                texts = [node.func.value]
            elif isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
                texts = node.comparators
            if any(sentences.search(ast.unparse(text)) for text in texts):
                found.add((name, ast.unparse(node)))
    foreign = {
        ("dualarm_cli.errors", "words in str(error)"),
        ("dualarm_cli.robot_import.expanded_text", "'ermission denied' in str(error)"),
        ("dualarm_cli.robot_import.importing", "quote(name) in diagnostic.message"),
        ("dualarm_cli.scoring.baseline", "str(error).partition(' for integer')"),
    }
    whole = {
        ("dualarm_cli.files.cells.cells", "note not in self.notes"),
        ("dualarm_cli.planning.room_rules", "note in ruled.notes"),
        ("dualarm_cli.robot_import.importing_pair", "reason not in reasons"),
    }
    assert found == foreign | whole, (
        "texts of libraries and of Python alone, the joint that a reader's message names, and notes that are kept once"
    )


def _written(node: ast.AST) -> bool:
    """State whether an expression has text that is written where it stands: alone, in lists, sums, choices, calls."""
    match node:
        case ast.List(elts=parts) | ast.Tuple(elts=parts):
            return any(map(_written, parts))
        case ast.IfExp(body=first, orelse=second) | ast.BinOp(left=first, right=second):
            return _written(first) or _written(second)
        case ast.Call(func=ast.Attribute(value=text)):
            return _written(text)
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and re.search(r"[a-z]", node.value) is not None
    )


SAID = r"(notes|reasons|warnings)$"
"""Names of lists of what is told about a plan, a calibration or an import."""


def test_notes_are_data() -> None:
    """Notes and causes are sentences of tables (`NoteTable`, `Refusal`), filled in; none is written where it stands."""
    found = []
    for name, path in modules().items():
        for node in nodes(path):
            added: list[ast.AST] = []
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                if re.search(
                    r"(notes|reasons|warnings)\.(append|insert|extend)$|^No(Path|Seam|Posture)$",
                    called,
                ):
                    added = list(node.args)
            elif isinstance(node, ast.AugAssign) and re.search(SAID, ast.unparse(node.target)):
                added = [node.value]
            elif isinstance(node, ast.Assign) and re.search(SAID, ast.unparse(node.targets[0])):
                added = [node.value] if isinstance(node.value, ast.List | ast.Tuple) else []
            elif isinstance(node, ast.FunctionDef) and re.search(SAID, node.name):
                added = [n.value for n in ast.walk(node) if isinstance(n, ast.Return) and n.value]
            elif isinstance(node, ast.keyword) and node.arg in ("notes", "unbounded"):
                added = [node.value]
            found += [(name, ast.unparse(one)) for one in added if _written(one)]
    assert found == []


def _note_tables() -> dict[tuple[str, str], set[str]]:
    """Collect the keys of each table of notes, by its module and name."""
    tables, made = {}, 0
    for module, path in modules().items():
        for node in nodes(path):
            is_table = isinstance(node, ast.Call) and ast.unparse(node.func) == "NoteTable"
            made += is_table
            if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("NoteTable("):
                tables[module, node.targets[0].id] = {word.arg for word in node.value.keywords}
    assert made == len(tables), "a table has a name in its module"
    return tables


def _possible_keys(key: ast.AST) -> set[str]:
    """Collect the keys that an argument may be: a text, or a choice of texts."""
    if isinstance(key, ast.IfExp):
        return _possible_keys(key.body) | _possible_keys(key.orelse)
    assert isinstance(key, ast.Constant), (
        f"the key of a note is written where it is made: {ast.unparse(key)}"
    )
    return {key.value}


def test_every_sentence_of_a_note_is_used_and_exists() -> None:
    """A key without a sentence would fail where a note is due; a sentence that nothing makes goes."""
    tables = _note_tables()
    assert len(tables) > 15
    used: dict[tuple[str, str], set[str]] = {table: set() for table in tables}
    for module, path in modules().items():
        table_of = {name: (home, name) for home, name in tables if home == module}
        for node in nodes(path):
            if isinstance(node, ast.ImportFrom):
                table_of |= {
                    alias.asname or alias.name: (node.module, alias.name)
                    for alias in node.names
                    if (node.module, alias.name) in tables
                }
            elif isinstance(node, ast.Assign):
                part = re.match(r"partial\((\w+),", ast.unparse(node.value))
                if part and part[1] in table_of:
                    table_of[ast.unparse(node.targets[0])] = table_of[part[1]]
        for node in nodes(path):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in table_of:
                used[table_of[node.func.id]] |= _possible_keys(node.args[0])
    assert used == tables


def test_every_refusal_has_a_sentence_that_is_used():
    """A key without a sentence would fail where a message is due; a sentence that nobody asks for goes."""
    texts = set()
    for name, path in modules().items():
        if name.endswith(".refusals"):
            continue
        for node in nodes(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.add(node.value)
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Refusal":
                key = node.args[0]
                assert not isinstance(key, ast.Constant) or key.value in sentences(), (name, key)
    assert texts >= {*sentences(), *remedies()}
    assert {*HEADS, *helps()} <= set(sentences())


def test_modules_that_docs_name_are_there():
    """A page that names `planning/planner.py`, `orders/rules` or `notes.py` names what is there."""
    root = PACKAGE.parent
    rooms = [path.name for folder in (PACKAGE, root) for path in folder.iterdir() if path.is_dir()]
    rooms.remove(".github")  # pages name workflows of the reader's repository
    pattern = rf"`((?:{'|'.join(map(re.escape, rooms))})/[\w./-]*[a-z_/]|\w+\.py)`"
    named = {
        (page.name, path)
        for page in (root / "README.md", *(root / "docs").rglob("*.md"))
        for path in re.findall(pattern, page.read_text("utf-8"))
    }
    assert named >= {
        ("architecture.md", "planning/planner.py"),
        ("architecture.md", "orders/rules"),
        ("architecture.md", "effort/stages.py"),
        ("architecture.md", "compiled/src/transfer_times.c"),
    }
    files = {path.name for path in (*PACKAGE.rglob("*.py"), *(root / "tests").rglob("*.py"))}
    assert not [
        (page, path)
        for page, path in sorted(named)
        if path not in files and not (PACKAGE / path).exists() and not (root / path).exists()
    ]


FREE = {
    "calibration",
    "cli",
    "evaluation",
    "formats",
    "page",
    "report/figures",
    "schemas",
    "scoring",
    "studies",
}
"""Folders whose numbers decide nothing about a plan."""
OWNERS = {
    "kinds/seam/closed_chain/program.py": "products of scipy's sparse matrices, which are loops",
    "model/studies/study.py": "powers of ten of figures that are shown",
    "robot_import/importing.py": "powers of ten of figures that are shown",
    "compiled/decimals.py": "powers of ten, which are exact",
    "verification/recorded_motion.py": "a fit of logged samples, which decides nothing about a plan",
}
"""Modules that may, and what they use."""
NUMPY = {
    *(
        "arccos",
        "arccosh",
        "arcsin",
        "arcsinh",
        "arctan",
        "arctan2",
        "arctanh",
        "cbrt",
        "cos",
        "cosh",
        "exp",
    ),
    *(
        "exp2",
        "expm1",
        "float_power",
        "log",
        "log10",
        "log1p",
        "log2",
        "logaddexp",
        "power",
        "sin",
        "sinc",
    ),
    *(
        "sinh",
        "tan",
        "tanh",
        "angle",
        "convolve",
        "correlate",
        "cov",
        "corrcoef",
        "geomspace",
        "logspace",
    ),
    *(
        "dot",
        "inner",
        "matmul",
        "tensordot",
        "vdot",
        "vecdot",
        "matvec",
        "linalg",
        "polyfit",
        "argpartition",
    ),
}
MATH = {
    *(
        "acos",
        "acosh",
        "asin",
        "asinh",
        "atan",
        "atan2",
        "atanh",
        "cbrt",
        "cos",
        "cosh",
        "exp",
        "exp2",
    ),
    *("expm1", "log", "log10", "log1p", "log2", "pow", "sin", "sinh", "sumprod", "tan", "tanh"),
}
SCIPY = {
    "geometry/splines.py": {"scipy.interpolate": "values of B-splines, by loops"},
    "kinds/path/following/arm_angle.py": {
        "scipy.interpolate": "a cubic spline of one number: a tridiagonal system, by a loop (gtsv)",
        "scipy.linalg": "a tridiagonal system, by a loop (ptsv)",
    },
    "kinds/seam/closed_chain/program.py": {"scipy.sparse": "matrices and their products, by loops"},
    "orders/proof/relaxation.py": {"scipy.optimize": "an assignment: sums and comparisons"},
    "files/robots/meshes.py": {"scipy.spatial": "convex hulls of meshes, by qhull"},
}
"""Modules that may use parts of scipy, and why these are the same on every processor."""
HINTS = {
    "@": "product of geometry.products",
    "**": "np.square, np.sqrt, or cube and power of geometry.elementary",
    "sort": 'kind="stable"',
}


def processor_dependent(source, allowed=()):
    """Returns lines, and what in them depends on the processor and should be used instead.

    Args:
        source: of a module.
        allowed: modules of scipy that it may use.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names]
            for name in [node.module or ""] if isinstance(node, ast.ImportFrom) else names:
                if name.split(".")[0] == "scipy" and name not in allowed:
                    found.append((node.lineno, f"geometry's function for {name}"))
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            found.append((node.lineno, HINTS["@"]))
        elif isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Pow):
            base = node.left if isinstance(node, ast.BinOp) else node.target
            # Powers of whole numbers are whole.
            if not (isinstance(base, ast.Constant) and isinstance(base.value, int)):
                found.append((node.lineno, HINTS["**"]))
        elif isinstance(node, ast.Attribute):
            owner = getattr(node.value, "id", None)
            if (owner == "np" and node.attr in NUMPY) or (owner == "math" and node.attr in MATH):
                found.append((node.lineno, f"geometry's function for {owner}.{node.attr}"))
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "argsort":
            kinds = [word.value for word in node.keywords if word.arg == "kind"]
            if not (kinds and getattr(kinds[0], "value", "") == "stable"):
                found.append((node.lineno, HINTS["sort"]))
    return found


def test_what_decides_is_the_same_on_every_processor():
    """No BLAS, no functions of numpy's or the C library's, no unstable order; `docs/contributing.md` says why."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if name in OWNERS or any(name.startswith(f"{folder}/") for folder in FREE):
            continue
        source = path.read_text(encoding="utf-8")
        for line, instead in processor_dependent(source, SCIPY.get(name, ())):
            found.append(f"dualarm_cli/{name}:{line}: use {instead}")
    assert not found, "\n".join(found)
    needless = [n for n in OWNERS if not processor_dependent((PACKAGE / n).read_text("utf-8"))]
    needless += [
        (n, part)
        for n, parts in SCIPY.items()
        for part in parts
        if len(processor_dependent((PACKAGE / n).read_text("utf-8"), parts))
        == len(processor_dependent((PACKAGE / n).read_text("utf-8"), parts.keys() - {part}))
    ]
    assert needless == []


@pytest.mark.parametrize(
    "source",
    [
        "a @ b",
        "a @= b",
        "x**3",
        "x ** y",
        "np.linalg.norm(x)",
        "np.dot(a, b)",
        "map(np.sin, x)",
        "math.atan2(1, 2)",
        "np.argsort(x)",
        "x.argsort()",
        'np.argsort(x, kind="quicksort")',
        "from scipy.linalg import solve",
        "import scipy.interpolate",
    ],
)
def test_each_of_them_is_noticed(source):
    """One line of each."""
    assert len(processor_dependent(source)) == 1


@pytest.mark.parametrize(
    "source", ["2**k", 'np.argsort(x, kind="stable")', "math.sqrt(2.0)", "np.square(x)"]
)
def test_what_is_the_same_everywhere_is_allowed(source):
    """IEEE 754 defines these to the last digit."""
    assert processor_dependent(source) == []
