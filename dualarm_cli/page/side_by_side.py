"""Page with two plans side by side on a clock, below a table.

The table has all plans.

Page of `dualarm compare solvers`: the result of each method, with its motion next to that of the best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dualarm_cli.model.verification import exceptions
from dualarm_cli.page.page import POLICY, page_ends, script_json
from dualarm_cli.page.tables import STYLE, PageCell, PageRow, PageTable, table_html, text_html
from dualarm_cli.records import dataclass
from dualarm_cli.report.comparison.comparison import (
    SHOWN,
    SOLVERS,
    row_namer,
    section_title,
    varied_solvers,
)

TIME_TOLERANCE = 0.0005
"""Time tolerance of equally long stages [s]."""
MIN_WIDTH = 720
"""Minimum width of a plan's page [CSS pixels]."""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}body {{ margin: 0; height: 100vh; display: grid; grid-template: auto minmax(0, 1fr) / 1fr 1fr; gap: 0 4px }}
header {{ grid-column: 1 / 3; padding: 6px 12px; max-height: 34vh; overflow: auto }}
p {{ margin: 4px 0 }}
iframe {{ width: 100%; height: 100%; border: 0 }}
iframe:only-of-type {{ grid-column: 1 / 3 }}
@media (max-width: {narrowest}px) {{
  body {{ height: auto; grid-template: none / minmax(0, 1fr) }}
  header, iframe:only-of-type {{ grid-column: 1 }}
  header {{ max-height: none }}
  td:last-child {{ min-width: 16rem }}
  iframe {{ height: 88vh; height: 88svh; border-top: 4px solid #8884 }}
}}
tr[tabindex] {{ cursor: pointer }}
tr[tabindex]:hover {{ background: color-mix(in srgb, currentColor 12%, transparent) }}
tr.left > :first-child::before {{ content: "◧ " }}
tr.right > :first-child::before {{ content: "◨ " }}
tr.left, tr.right, tr.alone {{ background: color-mix(in srgb, currentColor 8%, transparent) }}
#axis {{ display: block; width: 100%; margin-top: 6px; cursor: crosshair }}
#axis text {{ font-size: 0.78rem; fill: currentColor }}
#axis rect {{ fill: #aab3bf }}
#axis .wait {{ fill: #8a94a155 }}
#axis .pick {{ fill: #07c679 }}
#axis .place {{ fill: #592b65; stroke: #8886 }}
#axis .give {{ fill: #490b0e; stroke: #8886 }}
#axis .take {{ fill: #93e768 }}
#axis .path {{ fill: #e8cf11 }}
#axis .seam {{ fill: #97491c }}
#axis .tool {{ fill: #2320a0; stroke: #8886 }}
#axis line {{ stroke: #8888 }}
#axis .cursor {{ stroke: #c4004f; stroke-width: 1.5 }}
</style>
</head>
<body>
<header>
<details open><summary>{sentence}</summary>
{tables}</details>
<svg id="axis" role="img" aria-label="Both plans on one time axis"></svg>
</header>
<script type="application/json" id="ends">{ends}</script>
{plans}
<script>
const [before, after] = JSON.parse(document.getElementById("ends").textContent);
const plans = [...document.querySelectorAll("script.plan")];
const rows = [...document.querySelectorAll("tbody tr")];
let frames = [], time = 0;

/** Shows plans from left to right; plans already shown stay. */
function open(numbers) {{
  const former = frames;
  frames = numbers.map((plan, k) => {{
    if (former[k]?.plan === plan) return former[k];
    const frame = document.createElement("iframe");
    frame.title = `plan ${{plan + 1}}`;
    frame.srcdoc = before + plans[plan].textContent + after;
    return {{ plan, frame, shown: null, data: JSON.parse(plans[plan].textContent) }};
  }});
  former.filter((old) => !frames.includes(old)).forEach((old) => old.frame.remove());
  document.body.append(...frames.map((one) => one.frame).filter((frame) => !frame.isConnected));
  const places = numbers.length > 1 ? ["left", "right"] : ["alone"];
  rows.forEach((row) => {{
    const at = row.dataset.plan === undefined ? -1 : numbers.indexOf(Number(row.dataset.plan));
    row.className = places[at] ?? "";
  }});
  fit();
  draw();
}}

const size = parseFloat(getComputedStyle(document.documentElement).fontSize) / 14;
const LEFT = 118 * size, ROW = 13 * size;
let width = 0;
const axis = document.getElementById("axis");
const longest = () => Math.max(...frames.map((one) => one.data.duration));
const along = (at) => LEFT + ((width - LEFT - 12) * at) / longest();
const add = (tag, properties, text = "", parent = axis) => {{
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  Object.entries(properties).forEach(([name, value]) => node.setAttribute(name, value));
  node.textContent = text;
  return parent.appendChild(node);
}};

/** Names the class of a segment's bar: what is done, or nothing for transfers. */
function family({{ kind, action }}) {{
  if (["wait", "path", "seam"].includes(kind)) return kind;
  return ["transfer", "return"].includes(kind) ? "" : action.replace(/^(take|leave)_tool$/, "tool");
}}

/** Draws what the arms of the shown plans do, below each other on one time axis. */
function draw() {{
  axis.replaceChildren();
  width = axis.clientWidth;
  let y = ROW + 1;
  const steps = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
  const step = steps.find((length) => longest() / length <= width / (70 * size)) ?? 2000;
  for (let at = 0; at <= longest() + 1e-9; at += step) {{
    add("text", {{ x: along(at), y: 0.7 * ROW, "text-anchor": "middle" }}, String(Number(at.toFixed(1))));
  }}
  frames.forEach(({{ data: {{ segments = [], duration, title }} }}, k) => {{
    const mark = frames.length > 1 ? "◧◨"[k] : "";
    add("text", {{ x: 0, y: y + 0.75 * ROW }}, `${{mark}} ${{duration.toFixed(3)}} s`.trim());
    for (const arm of new Set(segments.map((segment) => segment.arm))) {{
      add("text", {{ x: LEFT - 6, y: y + 0.75 * ROW, "text-anchor": "end" }}, arm);
      for (const segment of segments.filter((row) => row.arm === arm)) {{
        const kind = family(segment), low = kind === "" || kind === "wait";
        const length = Math.max(along(segment.end) - along(segment.start) - 0.5, 0.5);
        const [top, height] = low ? [y + 0.4 * ROW, 0.45 * ROW] : [y, 0.85 * ROW];
        const bar = add("rect", {{ x: along(segment.start), width: length, y: top, height, class: kind }});
        add("title", {{}}, `${{title}}: ${{arm}}, ${{segment.kind}} ${{segment.task}}`, bar);
      }}
      y += ROW;
    }}
    add("line", {{ x1: along(duration), x2: along(duration), y1: 0.8 * ROW, y2: y }});
    y += 4;
  }});
  axis.setAttribute("viewBox", `0 0 ${{width}} ${{y}}`);
  add("line", {{ class: "cursor", y1: 0.8 * ROW, y2: y }});
  mark();
}}

/** Moves the cursor of the common axis. */
function mark() {{
  const cursor = axis.querySelector(".cursor");
  ["x1", "x2"].forEach((end) => cursor?.setAttribute(end, along(Math.min(time, longest()))));
}}
axis.addEventListener("click", (event) => {{
  const box = axis.getBoundingClientRect();
  time = Math.min(Math.max((event.clientX - box.left - LEFT) / (width - LEFT - 12), 0), 1) * longest();
  if (frames.every((one) => clock(one)?.ready)) frames.forEach((one) => show(one, time));
  mark();
}});

/** Zooms pages out in narrow columns, and in with the text of this page. */
function fit() {{
  const zoom = innerWidth > {narrowest} ? Math.min(size, innerWidth / frames.length / {narrowest}) : 1;
  frames.forEach((one) => (one.frame.style.zoom = zoom));
}}
addEventListener("resize", () => {{
  fit();
  draw();
}});

const clock = (one) => one.frame.contentWindow.dualarm;
const show = (one, at) => {{
  clock(one).setTime(at);
  one.shown = clock(one).time;
}};
setInterval(() => {{
  if (!frames.every((one) => clock(one)?.ready)) return;
  frames.forEach((one) => clock(one).align(longest(), clock(frames[0]).joints));
  const led = frames.find((one) => one.shown !== null && Math.abs(clock(one).time - one.shown) > 1e-9);
  if (led) time = led.shown = clock(led).time;
  frames.forEach((one) => {{
    if ((led && one !== led) || one.shown === null) show(one, time);
  }});
  mark();
}}, 30);

/** Shows a row's plan next to its reference plan, or moves both plans to the row's stage. */
function choose(row) {{
  const {{ plan, reference, a, b }} = row.dataset;
  if (plan !== undefined) return open([...new Set([Number(reference), Number(plan)])]);
  frames.forEach((one) => clock(one)?.pause());
  if (frames.every((one) => clock(one)?.ready)) frames.forEach((one, k) => show(one, Number([a, b][k])));
}}
rows.filter((row) => Object.keys(row.dataset).length).forEach((row) => {{
  row.tabIndex = 0;
  row.addEventListener("click", () => choose(row));
  row.addEventListener("keydown", (event) => event.key === "Enter" && choose(row));
}});
open({first});
</script>
</body>
</html>
"""


@dataclass(frozen=True)
class ComparedStage:
    """Row of the table: a stage of A, of B, or of both."""

    numbers: tuple[str, str]
    """Stage numbers in A and B, as text."""
    starts: tuple[float, float]
    """Start times in A and B [s], for a click on the row.

    Both plans move there.
    """
    work: str
    """Work of the stage."""
    lengths: tuple[str, str]
    """Durations in A and B, as text."""
    difference: float
    """Duration in B minus that in A [s]."""
    cause: str
    """Cause of the difference."""


def stages_table(stages: Sequence[ComparedStage]) -> PageTable:
    """Build the table of two schedules' stages, with differences marked."""
    columns = [(name, name != "work") for name in ("A", "B", "work", "A s", "B s", "B − A s")]
    return PageTable("", [*columns, ("cause", False)], [_stage_row(stage) for stage in stages])


def _stage_row(stage: ComparedStage) -> PageRow:
    change = stage.difference
    mark = "bad" if change > TIME_TOLERANCE else "good" if change < -TIME_TOLERANCE else ""
    signed = f"{change:+.3f}".replace("-", "−") if mark else "0.000"
    texts = [PageCell(text) for text in (*stage.numbers, stage.work, *stage.lengths)]
    cells = [*texts, PageCell(signed, mark), PageCell(stage.cause)]
    return PageRow(cells, {"a": repr(stage.starts[0]), "b": repr(stage.starts[1])})


def side_by_side(
    title: str,
    sentence: str,
    tables: Sequence[PageTable],
    plans: Sequence[Mapping[str, Any]],
    first: Sequence[int],
) -> bytes:
    """Build an HTML file that shows one or two plans together.

    Two plans have one clock.

    Args:
        title: of the file.
        sentence: above the tables.
        tables: rows with the data `plan` and `reference` show the plans of these numbers; rows with `a` and `b` move
            the left and the right plan to these times [s].
        plans: data of their pages (`page_data`), held once, as is the code that shows them.
        first: places of the plans in sight at first.

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    words = {
        "policy": POLICY,
        "title": text_html(title),
        "style": STYLE,
        "sentence": text_html(sentence),
        "tables": "".join(map(table_html, tables)),
        "ends": script_json(page_ends(title)),
        "plans": "\n".join(
            f'<script type="application/json" class="plan">{script_json(plan)}</script>'
            for plan in plans
        ),
        "first": script_json(list(first)),
        "narrowest": MIN_WIDTH,
    }
    return _PAGE.format(**words).encode("utf-8", "backslashreplace")


TITLE, HINT = "Methods compared", "Click a method to show its plan next to the fastest one."
_MARKS = {"verified": "good", "failed": "bad", "infeasible": "bad", "not served": ""}

PlanKey = tuple[str, ...]
"""Task file and solver settings that identify a row (SOLVERS)."""


def plan_key(tasks: str, row: Mapping[str, Any]) -> PlanKey:
    """Compose the key of a row's plan.

    Args:
        tasks: name of the task file.
        row: of the document.
    """
    return tasks, *(row[key] for key in SOLVERS)


def solvers_page(document: Mapping[str, Any], plans: Mapping[PlanKey, Mapping[str, Any]]) -> bytes:
    """Build one HTML file with all plans of a comparison.

    Args:
        document: of `dualarm compare solvers`.
        plans: data of their pages (`page_data`).

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    shown: list[dict[str, Any]] = []
    tables = []
    first: list[int] = []
    for section in document["comparisons"]:
        places: dict[int, int] = {}
        called = row_namer(section["rows"])
        for k, row in enumerate(section["rows"]):
            data = plans.get(plan_key(section["tasks"], row))
            if data is not None:
                places[k] = len(shown)
                shown.append({**data, "title": f"{data['title']}: {called(row)}"})
        tables.append(_table(section, places))
        first = first or list(places.values())[:2]
    return side_by_side(TITLE, HINT, tables, shown, first)


def _table(section: dict[str, Any], places: Mapping[int, int]) -> PageTable:
    """Build the table of one task file.

    Args:
        section: of the document.
        places: where the plans of its rows are, by the number of the row; the best one's comes first.
    """
    rows, varied = section["rows"], varied_solvers(section["rows"])
    title = section_title(section, section["tasks"])
    if section["lower_bound"] is not None:
        title += f", lower bound {section['lower_bound']:.3f} s"
    names = [(name, False) for name in ("method", *varied)]
    numbers = [(n, True) for n in ("cycle s", "loss s", "loss", "to the bound", "clearance mm")]
    best = min((row["cycle_time"] for row in rows if row["status"] == "verified"), default=None)
    page_rows = []
    for k, row in enumerate(rows):
        cells = [PageCell(row[key]) for key in ("method", *varied)]
        cells += [PageCell(text) for text in _figures(row, best)]
        plan = row["status"] + (f": {row['reason']}" if row["reason"] else "")
        mark = "warn" if row["status"] == "verified" and row["caveats"] else _MARKS[row["status"]]
        cells.append(PageCell(plan + exceptions(row["caveats"]), mark))
        data = {"plan": places[k], "reference": min(places.values())} if k in places else {}
        page_rows.append(PageRow(cells, data))
    columns = [*names, *numbers, ("plan", False)]
    return PageTable(title, columns, page_rows, note=section["sentence"])


def _figures(row: Mapping[str, Any], best: float | None) -> list[str]:
    """Format a row's cycle time, loss against the best row, gap and clearance."""
    time, clearance = row["cycle_time"], row["clearance"]
    if time is None:
        return ["–"] * 5
    loss, share = "–", "–"
    if best is not None and abs(time - best) < SHOWN:
        loss, share = "0.000", "0.0%"
    elif best is not None:
        loss = f"{time - best:+.3f}".replace("-", "−")
        share = f"{time / best - 1.0:+.1%}".replace("-", "−") if best > 0.0 else "–"
    return [
        f"{time:.3f}",
        loss,
        share,
        "–" if row["gap"] is None else f"{row['gap']:.1%}",
        "–" if clearance is None else f"{clearance * 1e3:.1f}",
    ]
