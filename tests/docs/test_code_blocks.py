"""README and docs: every code block runs, every output is what is printed, every link leads somewhere."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


def script(name: str) -> ModuleType:
    """Returns a script of the docs as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded
    spec.loader.exec_module(loaded)
    return loaded


blocks = script("blocks")
PAGES = blocks.PAGES


def named(page: Path) -> str:
    """Returns the path of a page below the root folder."""
    return page.relative_to(ROOT).as_posix()


@pytest.mark.full_effort
@pytest.mark.parametrize("page", PAGES, ids=named)
def test_blocks_of_a_page(page, tmp_path):
    """Commands run, files are valid, outputs are to the digit what is printed."""
    assert blocks.correct_page(page, tmp_path, slow=False) == page.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if any("slow" in one.notes for one in blocks.blocks(page))],
    ids=named,
)
def test_blocks_of_a_page_that_take_long(page, tmp_path):
    """The same with the commands that take more than some seconds."""
    assert blocks.correct_page(page, tmp_path, slow=True) == page.read_text()


def test_a_changed_number_is_corrected():
    """Not by what is near: 3.57 s is not 3.58 s, and the third line of a table not the first."""
    shown = blocks.Block("text", "cycle: 3.58 s, 2 …\n│ 2 │ 0.5 │\n", {})
    printed = "cycle: 3.57 s, 3 parts\n│ 1 │ 0.5 │\n│ 2 │  0.6 │\n"
    assert blocks.corrected(shown, printed) == "cycle: 3.57 s, 3 …\n│ 2 │ 0.6 │\n"
    with pytest.raises(AssertionError, match="not printed"):
        blocks.corrected(blocks.Block("text", "cycle: 3.57 ms", {}), printed)


def test_commands_do_not_get_into_each_others_way():
    """Somebody who runs all commands in one folder meets no result of an earlier page."""
    folders: list[str] = []
    for page in PAGES:
        for block in blocks.blocks(page):
            for line in block.text.splitlines() if block.language == "sh" else ():
                if line.startswith("dualarm plan tasks/"):
                    assert "--out " in line, f"{named(page)}: {line}"
                    folders += re.findall(r"--out (\S+)", line)
    assert len(folders) == len(set(folders)), folders


def anchors(page: Path) -> set[str]:
    """Returns the anchors of a page's headings as GitHub and MyST make them."""
    text = blocks.BLOCK.sub("", page.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_links_of_a_page_lead_somewhere(page):
    """Files exist, and so do the headings that anchors name."""
    text = blocks.BLOCK.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        target, _, anchor = link.partition("#")
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), link
        if anchor:
            assert anchor in anchors(path), link


def test_the_readme_is_one_page_and_names_every_page():
    """At most 150 lines; each how-to page is in its table."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 150
    for page in (ROOT / "docs" / "how-to").glob("*.md"):
        assert f"(docs/how-to/{page.name})" in readme, page.name


def test_the_set_up_commands_are_those_that_ci_runs():
    """One line installs and plans, the other one installs and tests."""
    commands = re.findall(r"^python3 -m venv .*$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(commands) == 2
    plan, test = commands
    assert (
        ".venv/bin/pip install -q . && .venv/bin/dualarm plan tasks/04_packing/tasks.yaml" in plan
    )
    assert test.endswith(".venv/bin/python -m pytest -n 2")
