"""Self-contained HTML page: a plan's data and the built code that shows them."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from dualarm_cli.errors import MissingDependencyError

BUILT = ("page.css", "page.js")
"""Files built by `hatch_build.py` together with the package."""
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""Content security policy: the page loads nothing from elsewhere."""
DATA = '<script type="application/json" id="data">'
"""Tag before the data of a page."""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{css}</style>
</head>
<body>
<div id="page">
<p class="missing">The program of this page has not started.
If this text stays, write the page again: dualarm report PLAN</p>
</div>
<noscript>This page shows a plan in motion and needs JavaScript.</noscript>
{tag}{data}</script>
<script>{js}</script>
</body>
</html>
"""


class PageNotBuiltError(MissingDependencyError):
    """Error of an installation without the page's built code."""

    def __init__(self) -> None:
        """Compose the message."""
        Exception.__init__(
            self,
            "the page was not built into this installation, as Node's packages could not be reached then; "
            "install dualarm again with a network, or from a wheel",
        )


def built_folder() -> Traversable:
    """Return the folder of the built code; it may be missing."""
    return resources.files("dualarm_cli.page") / "built"


def require_built() -> None:
    """Raise PageNotBuiltError if this installation lacks the built code."""
    if not all((built_folder() / name).is_file() for name in BUILT):
        raise PageNotBuiltError


def page_html(data: Mapping[str, Any]) -> bytes:
    """Build the page of a plan's data (`page_data`).

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    before, after = page_ends(str(data["title"]))
    return f"{before}{script_json(data)}{after}".encode("utf-8", "backslashreplace")


def page_ends(title: str) -> tuple[str, str]:
    """Build the parts of a page before and after its data.

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    require_built()
    css, js = ((built_folder() / name).read_text(encoding="utf-8") for name in BUILT)
    before, _, after = _PAGE.partition("{data}")
    head = before.format(
        title=html.escape(title), policy=POLICY, tag=DATA, css=css.replace("</style", "<\\/style")
    )
    return head, after.format(js=js.replace("</script", "<\\/script"))


def script_json(document: Any) -> str:
    """Encode a document as JSON that cannot end or open a script element."""
    text = json.dumps(document, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c")
