"""Two plans on one clock: their pages side by side, and the stages that differ."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass

from dualarm_cli.page.page import POLICY

SAME = 0.0005
"""Stages whose lengths differ by less are equally long [s]."""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; font: 14px/1.4 system-ui, sans-serif }}
* {{ box-sizing: border-box }}
body {{ margin: 0; height: 100vh; display: grid; grid-template: auto minmax(0, 1fr) / 1fr 1fr; gap: 0 4px }}
header {{ grid-column: 1 / 3; padding: 6px 12px; max-height: 30vh; overflow: auto }}
iframe {{ width: 100%; height: 100%; border: 0 }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
th, td {{ padding: 1px 10px; text-align: right }}
th:nth-child(3), td:nth-child(3), th:last-child, td:last-child {{ text-align: left }}
tbody tr {{ cursor: pointer }}
tbody tr:hover {{ background: color-mix(in srgb, currentColor 12%, transparent) }}
.slower {{ color: #c0392b; font-weight: 600 }}
.faster {{ color: #1a7f5a; font-weight: 600 }}
@media (prefers-color-scheme: dark) {{ .slower {{ color: #ff8f80 }} .faster {{ color: #6fd3ab }} }}
</style>
</head>
<body>
<header>
<details open><summary>{sentence}</summary>
<table>
<thead><tr><th>A</th><th>B</th><th>work</th><th>A s</th><th>B s</th><th>B − A s</th><th>cause</th></tr></thead>
<tbody>{rows}</tbody>
</table>
</details>
</header>
<script type="application/json" id="pages">{pages}</script>
<script>
const frames = JSON.parse(document.getElementById("pages").textContent).map((text, k) => {{
  const frame = document.createElement("iframe");
  frame.title = "AB"[k];
  frame.srcdoc = text;
  return document.body.appendChild(frame);
}});
const shown = [0, 0];
const clocks = () => frames.map((frame) => frame.contentWindow.dualarm);
const ready = () => clocks().every((clock) => clock && clock.ready);
const show = (k, time) => {{
  const clock = clocks()[k];
  clock.setTime(time);
  shown[k] = clock.time;
}};
setInterval(() => {{
  if (!ready()) return;
  clocks().forEach((clock, k) => {{
    if (Math.abs(clock.time - shown[k]) < 1e-9) return;
    shown[k] = clock.time;
    show(1 - k, clock.time);
  }});
}}, 30);
document.querySelectorAll("tbody tr").forEach((row) => row.addEventListener("click", () => {{
  clocks().forEach((clock) => clock.pause());
  show(0, Number(row.dataset.a));
  show(1, Number(row.dataset.b));
}}));
</script>
</body>
</html>
"""


@dataclass(frozen=True)
class ComparedStage:
    """A row of the table: a stage of A, of B, or of both."""

    numbers: tuple[str, str]
    """Its numbers in A and B, as they are written."""
    starts: tuple[float, float]
    """When it begins in A and B [s]; a click on the row leads there."""
    work: str
    """What is done."""
    lengths: tuple[str, str]
    """How long it is in A and B, as they are written."""
    difference: float
    """How much longer it is in B [s]."""
    cause: str
    """What is to blame."""


def side_by_side(
    pages: tuple[bytes, bytes], title: str, sentence: str, stages: Sequence[ComparedStage]
) -> bytes:
    """Returns one HTML file with two plans on one clock.

    Args:
        pages: of the plans (`page_html`).
        title: of the file.
        sentence: which plan is faster, and why.
        stages: what differs is marked in their table.
    """
    texts = json.dumps([page.decode("utf-8") for page in pages])
    words = {
        "title": html.escape(title),
        "sentence": html.escape(sentence),
        "rows": "".join(map(_row, stages)),
        "pages": texts.replace("<", "\\u003c"),
        "policy": POLICY,
    }
    return _PAGE.format(**words).encode()


def _row(stage: ComparedStage) -> str:
    """Returns a row as HTML; everything that comes from files is text."""
    change = stage.difference
    mark = "slower" if change > SAME else "faster" if change < -SAME else ""
    signed = f"{change:+.3f}".replace("-", "−") if mark else "0.000"
    cells = [*stage.numbers, stage.work, *stage.lengths]
    texts = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
    a, b = stage.starts
    return (
        f'<tr data-a="{a!r}" data-b="{b!r}">{texts}<td class="{mark}">{signed}</td>'
        f"<td>{html.escape(stage.cause)}</td></tr>"
    )
