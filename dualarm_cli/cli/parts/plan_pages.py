"""`--pages DIR`: an index of many plans, and a page for each of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated
from urllib.parse import unquote

import typer

from dualarm_cli.cli.parts.output import print_message
from dualarm_cli.errors import OutputError

PagesOption = Annotated[
    Path | None,
    typer.Option(
        "--pages",
        metavar="DIR",
        help="Folder for index.html and a page for each plan, in which the cell moves: 1 to 2 MB each.",
        show_default=False,
    ),
]


def refuse_pages(folder: Path | None, force: bool) -> None:
    """Raises before any work is done where pages could not be written, or would replace what is no index.

    Args:
        folder: for the pages; None where none are asked for.
        force: whether anything may be replaced.

    Raises:
        OutputError: with what to do.
        PageNotBuiltError: this installation has no code of the page.
    """
    if folder is None:
        return
    from dualarm_cli.exporting.files import check_writable
    from dualarm_cli.page.index_page import INDEX, MARK
    from dualarm_cli.page.page import require_built

    require_built()
    check_writable(folder, force=True, option="--pages")
    index = folder / INDEX
    if force or not index.exists():
        return
    if not index.is_file() or not index.read_bytes().startswith(MARK):
        raise OutputError(
            f"--pages {folder}: already holds an {INDEX} that is no index of plans; add --force to replace it, or "
            "name another"
        )


def write_pages(
    folder: Path, index: bytes, plans: Mapping[str, tuple[str, str]], quiet: bool
) -> None:
    """Writes an index and the pages that it leads to, the index last; those of the index before it go.

    Args:
        folder: made if need be.
        index: of all plans.
        plans: by the names of their pages: what each is called, and the data of its page, packed.
        quiet: whether to say nothing.

    Raises:
        OutputError: something cannot be written.
    """
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.page.index_page import FOLDER, INDEX
    from dualarm_cli.page.packed import unpacked_document
    from dualarm_cli.page.page import page_html

    former = _former_pages(folder)
    try:
        (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"--pages {folder}: cannot be made: {error.strerror}") from None
    size = len(index)
    for name, (title, data) in plans.items():
        page = page_html(unpacked_document(data) | {"title": title})
        write_file(folder / FOLDER / name, page, force=True)
        size += len(page)
    write_file(folder / INDEX, index, force=True)
    for path in former - {folder / FOLDER / name for name in plans}:
        path.unlink(missing_ok=True)
    if not quiet:
        many = f"{len(plans)} plan{'s' * (len(plans) != 1)}"
        print_message(f"written: {folder / INDEX}, which leads to {many} ({size / 1e6:.1f} MB)")


def _former_pages(folder: Path) -> set[Path]:
    """Returns the pages that an earlier index leads to."""
    from dualarm_cli.page.index_page import FOLDER, INDEX, MARK

    try:
        text = (folder / INDEX).read_bytes()
    except OSError:
        return set()
    if not text.startswith(MARK):
        return set()
    names = re.findall(rf'<a href="{FOLDER}/([^"/]+\.html)"', text.decode("utf-8", "replace"))
    return {folder / FOLDER / unquote(name) for name in names}
