"""Files around the code: they name one version, what the wheel bundles, and the machines that it is built for."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import platform
import re
import shutil
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from dualarm_cli import DualArmError, __version__, native

ROOT = Path(__file__).parents[1]
WEB = ROOT / "dualarm_cli" / "page" / "web"


@pytest.fixture(scope="module")
def hook() -> ModuleType:
    """The build hook, without hatchling's part of it."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read(name: str) -> dict:
    """The content of a YAML file of the project."""
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_the_citation_names_the_version_and_its_date() -> None:
    """Those of the package and of the changelog."""
    citation = read("CITATION.cff")
    dated = f"## [{citation['version']}] – {citation['date-released']}"
    assert citation["version"] == __version__
    assert dated in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_wheels_are_built_and_tried_for_every_target(hook: ModuleType) -> None:
    """The machines of the workflow are those that the build hook compiles for; this one is among them."""
    jobs = read(".github/workflows/ci.yaml")["jobs"]
    tried = [row["target"] for row in jobs["smoke"]["strategy"]["matrix"]["include"]]
    assert jobs["wheel"]["strategy"]["matrix"]["target"] == tried == list(hook.TARGETS)
    assert hook.TARGETS[hook.native_target()][1].endswith(f"_{platform.machine()}")
    assert len({tag for _, tag, _ in hook.TARGETS.values()}) == len(hook.TARGETS)


def test_a_library_of_other_sources_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A character of a comment more; files that are not compiled do not count, and wheels have no sources."""
    loaded, folder = native.library(), tmp_path / "src"
    shutil.copytree(native.SOURCES, folder)
    (folder / "notes.txt").write_text("not compiled")
    native.check_sources(loaded, folder)
    native.check_sources(loaded, tmp_path / "none")
    with (folder / "paths.h").open("a", encoding="utf-8") as file:
        file.write("// more\n")
    with pytest.raises(ValueError, match="not built from the C code"):
        native.check_sources(loaded, folder)
    with pytest.raises(ValueError, match="not built from the C code"):
        native.check_sources(ctypes.CDLL(None), folder)
    monkeypatch.setattr(native, "check_sources", partial(native.check_sources, folder=folder))
    with pytest.raises(DualArmError, match="install dualarm again with pip"):
        native.library.__wrapped__()


def test_issue_forms_ask_in_fields_with_labels() -> None:
    """As the host of the repository requires: a name, a description, and fields with ids and labels."""
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yaml"):
        form = read(str(path.relative_to(ROOT)))
        assert form["name"] and form["description"]
        ids = [field["id"] for field in form["body"]]
        assert len(set(ids)) == len(ids)
        assert all(field["attributes"]["label"] for field in form["body"])


def test_notices_name_all_that_the_page_bundles() -> None:
    """Every package that the page's sources import, with its copyright."""
    imported = {
        name.split("/")[0]
        for path in (WEB / "src").rglob("*.js")
        for name in re.findall(r'from "([a-z@][^"]*)"|import "([a-z@][^"]*)"', path.read_text())
        for name in name
        if name
    }
    notices = (ROOT / "THIRD_PARTY_NOTICES.md").read_text(encoding="utf-8").lower()
    assert imported and imported <= set(
        json.loads((WEB / "package.json").read_text())["dependencies"]
    )
    assert all(re.search(rf"{name}.*copyright", notices) for name in imported)
