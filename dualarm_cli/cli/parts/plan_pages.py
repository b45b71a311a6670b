"""`--pages DIR`: an index of many plans, and a page for each of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated
from urllib.parse import unquote

import typer

from dualarm_cli.cli.parts.output import print_message
from dualarm_cli.errors import InputError, OutputError

PagesOption = Annotated[
    Path | None,
    typer.Option(
        "--pages",
        metavar="DIR",
        help="Folder for index.html and a page for each plan, in which the cell moves: 1 to 2 MB each.",
    ),
]


def refuse_pages(folder: Path | None, force: bool) -> None:
    """Raise before planning if pages could not be written, or would replace other files.

    Args:
        folder: folder of the pages, or None.
        force: whether anything may be replaced.

    Raises:
        OutputError: with what to do.
        PageNotBuiltError: this installation has no code of the page.
    """
    if folder is None:
        return
    from dualarm_cli.exporting.files import check_writable
    from dualarm_cli.exporting.whole_files import place_in
    from dualarm_cli.page.index_page import FOLDER, INDEX
    from dualarm_cli.page.page import require_built

    require_built()
    check_writable(folder, force=True, option="--pages")
    index, _ = place_in(folder, INDEX), place_in(folder, FOLDER)
    if force or not index.exists():
        return
    if not _former_index(folder):
        raise OutputError(
            f"--pages {folder}: already holds an {INDEX} that is no index of plans; add --force to replace it, or "
            "name another"
        )


def write_pages(
    folder: Path, index: bytes, plans: Mapping[str, tuple[str, str]], quiet: bool
) -> None:
    """Write an index and its pages, and remove the earlier index's pages.

    The index is written last.

    Args:
        folder: made if need be.
        index: of all plans.
        plans: by the names of their pages: what each is called, and the data of its page, packed.
        quiet: whether to say nothing.

    Raises:
        OutputError: something cannot be written.
    """
    from dualarm_cli.exporting.whole_files import replace_all
    from dualarm_cli.page.index_page import FOLDER, INDEX
    from dualarm_cli.page.packed import unpacked_document
    from dualarm_cli.page.page import page_html

    former = _former_pages(folder)
    size = len(index)
    for name, (title, data) in plans.items():
        page = page_html(unpacked_document(data) | {"title": title})
        replace_all(folder, {f"{FOLDER}/{name}": [page]})
        size += len(page)
    replace_all(folder, {INDEX: [index]})
    for path in former:
        if path.name not in plans:
            path.unlink(missing_ok=True)
    if not quiet:
        many = f"{len(plans)} plan{'s' * (len(plans) != 1)}"
        print_message(f"written: {folder / INDEX}, which leads to {many} ({size / 1e6:.1f} MB)")


def _former_index(folder: Path) -> bytes:
    """Return the index of plans in a folder, or an empty text."""
    from dualarm_cli.files.source.text_source import read_bytes
    from dualarm_cli.page.index_page import INDEX, MARK

    try:
        text = read_bytes(folder / INDEX, INDEX)
    except InputError:
        return b""
    return text if text.startswith(MARK) else b""


def _former_pages(folder: Path) -> list[Path]:
    """Return the pages in the folder's own place that an earlier index leads to.

    The index may come from elsewhere: a name in it never leads to another folder.
    """
    from dualarm_cli.page.index_page import FOLDER

    text = _former_index(folder).decode("utf-8", "replace")
    named = set(map(unquote, re.findall(rf'<a href="{FOLDER}/([^"/]+\.html)"', text)))
    place = folder / FOLDER
    if place.is_symlink() or not place.is_dir():
        return []
    return [path for path in place.iterdir() if path.name in named and not path.is_dir()]
