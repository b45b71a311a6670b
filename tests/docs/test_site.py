"""The site is built from the pages without a warning, and every page is reached from its navigation."""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-n", "-b", "html"]
    built = subprocess.run(
        [*command, "-d", str(out / "trees"), str(DOCS), str(out / "html")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return out / "html"


def test_every_page_is_in_the_navigation(site: Path) -> None:
    """A page that no table of contents names is a warning of Sphinx; here the front page links each of them."""
    front = (site / "index.html").read_text()
    pages = [page.relative_to(DOCS).with_suffix(".html") for page in DOCS.rglob("*.md")]
    assert len(pages) > 30
    missing = [
        str(page) for page in pages if f'href="{page}"' not in front and str(page) != "index.html"
    ]
    assert missing == []


def test_the_menu_is_the_readmes_table(site: Path) -> None:
    """Five groups in the order of need, and in each the pages as the README has them; `next` follows that path."""
    index = (DOCS / "index.md").read_text()
    menu = {}
    for caption, pages in re.findall(r":caption: (.+)\n:hidden:\n\n((?:.+\n)+?)```", index):
        menu[caption] = pages.split()
    groups = ["Start", "Describe", "Decide", "Show", "Automate"]
    assert list(menu) == [*groups, "Look up"]
    table = (DOCS.parent / "README.md").read_text().split("| you want … | page |")[1]
    for group, rows in zip(groups, re.split(r"\| \*\*\w+\*\* \| \|\n", table)[1:], strict=False):
        linked = re.findall(r"\| \[[^\]]+\]\(docs/([\w/-]+)\.md\)", rows)
        assert linked == menu[group], group
    path = [page for group in groups for page in menu[group]]
    for page, following in pairwise(path):
        html = (site / f"{page}.html").read_text()
        after = re.search(r'class="next-page" href="([^"]+)"', html)
        assert after is not None, page
        assert after[1].split("/")[-1] == f"{following.split('/')[-1]}.html", page


def test_titles_of_the_path_are_imperatives() -> None:
    """One grammar: each begins with the verb of what the reader wants to do."""
    verbs = (
        "Avoid|Browse|Build|Carry|Change|Come|Compare|Describe|Estimate|Export|Find|Follow|Get|Judge|"
        "Leave|Measure|Move|Pass|Pick|Plan|Repeat|See|Set up|Start|Watch|Work"
    )
    for page in [DOCS / "getting-started.md", *(DOCS / "how-to").glob("*.md")]:
        assert re.match(rf"# ({verbs}) ", page.read_text()), page.name


def test_commands_can_be_copied(site: Path) -> None:
    """The button is on commands, files and scripts, and not on what a command prints."""
    script = (site / "_static" / "copybutton.js").read_text()
    assert "div.highlight-sh pre, div.highlight-yaml pre, div.highlight-python pre" in script


def test_external_links_are_whole(site: Path) -> None:
    """Their form only: whether they answer is for `python -m sphinx -b linkcheck docs FOLDER`."""
    for page in DOCS.rglob("*.md"):
        for link in re.findall(r"\]\((http[^)]*)\)", page.read_text()):
            assert re.fullmatch(r"https://[\w.-]+\.[a-z]{2,}(/[^\s]*)?", link), (page, link)


def test_the_site_needs_no_other_host(site: Path) -> None:
    """Scripts, styles and formulas come with it: MathML in place of a script that reads TeX."""
    formulas = 0
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//", text), page
        formulas += text.count("<math ")
        # The index of a letter stands beside it, also where a dot stands above: `\dot J_G`.
        assert not re.search(r"<munder(?:over)?[^>]*>\s*<mi>[^<]</mi>", text), page
    assert formulas >= sum(
        len(re.findall(r"^\$\$\n.+?\n\$\$$", page.read_text(), re.MULTILINE | re.DOTALL))
        for page in DOCS.rglob("*.md")
    )
    assert formulas > 0


def test_options_keep_their_minus_signs(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert not re.search(r"[–—](?:effort|json|out|platform|force)\b", page.read_text()), page
