"""Code that decides takes no function whose last digits depend on the processor."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "dualarm_cli"
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
    "geometry/elementary.py": "the functions themselves",
    "geometry/products.py": "the products themselves",
    "kinds/seam/closed_chain/program.py": "products of scipy's sparse matrices, which are loops",
    "model/study.py": "powers of ten of figures that are shown",
    "robot_import/description.py": "powers of ten of figures that are shown",
    "compiled/decimals.py": "powers of ten, which are exact",
    "stages/peers/program.py": "symbols of casadi",
    "stages/peers/program_kinematics.py": "symbols of casadi",
    "verification/driven_motion.py": "a fit of logged samples, which decides nothing about a plan",
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
HINTS = {
    "@": "product of geometry.products",
    "**": "np.square, np.sqrt, or cube and power of geometry.elementary",
    "sort": 'kind="stable"',
}


def places(source: str) -> list[tuple[int, str]]:
    """Returns lines, and what in them depends on the processor and should be used instead."""
    found = []
    for node in ast.walk(ast.parse(source)):
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
        for line, instead in places(path.read_text(encoding="utf-8")):
            found.append(f"dualarm_cli/{name}:{line}: use {instead}")
    assert not found, "\n".join(found)


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
    ],
)
def test_each_of_them_is_noticed(source):
    """One line of each."""
    assert len(places(source)) == 1


@pytest.mark.parametrize(
    "source", ["2**k", 'np.argsort(x, kind="stable")', "math.sqrt(2.0)", "np.square(x)"]
)
def test_what_is_the_same_everywhere_is_allowed(source):
    """IEEE 754 defines these to the last digit."""
    assert places(source) == []
