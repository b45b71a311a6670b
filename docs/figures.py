"""Makes every number and every picture of the docs in one run.

    PYTHONPATH=. python docs/figures.py [STEP ...]

Without a step all are done, in this order:

- `table`: the plans of `PLANS` are made. Their numbers are written to `docs/figures.json`.
- `drawings`: the commands of `DRAWINGS` draw the figures in `docs`.
- `screens`: Chromium takes a picture of the page of each plan, and the README's picture, into `docs/pictures`.
- `hero`: the README's picture alone; not part of a whole run.
- `pages`: the table's numbers are written into the pages, wherever a comment names one.
- `outputs`: the commands of all pages run, and the outputs below them get their numbers. This takes long.
- `measurements`: the benchmarks of `docs/measurements.md` run, and their tables replace those of the page. Not part of
  a whole run either: it takes most of an hour, and needs an idle machine with two cores.

A number of a page that is not in an output has its source behind it: `31.542 s<!-- figure: 04_packing cycle_time -->`
is the member of that row of the table in the unit and with the decimals that the page has. What a page lists by rows
is between `<!-- rows: NAME -->` and `<!-- end -->`, and is written whole. A picture carries the row that it shows, as
the text `dualarm` of the PNG.
"""

from __future__ import annotations

import base64
import datetime
import json
import os
import platform
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
ROOT = DOCS.parent
TABLE = DOCS / "figures.json"
PICTURES = DOCS / "pictures"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
Row = dict[str, Any]

JOBS = {
    "01_first_pick": (
        "the smallest useful job",
        "the four targets, and how long the tools are",
    ),
    "02_two_trays": (
        "named frames, free yaw, symmetry, `after`",
        "`frames`, which say where the trays are",
    ),
    "03_bottin_planar": (
        "the robot and the move of [Bottin2021]",
        "the method (`--platform`): the move is a paper's",
    ),
    "04_packing": (
        "24 picks from trays into cartons",
        "`frames` of trays and cartons; `study.yaml` varies the height of the table",
    ),
    "05_two_robots": (
        "two robots with bases of their own, a cap on the tool speed",
        "`base` of both robots, `speed` and `tool_speed`",
    ),
    "06_shared_bin": (
        "a crowded cell: both arms pick from one bin",
        "walls of the bin in `obstacles`, and `clearance`",
    ),
    "07_two_shelves": (
        "shelves of two compartments that are filled from the front",
        "boards of the shelves in `obstacles`, and `approach`, which must lead out of them",
    ),
    "08_narrow_bin": (
        "a narrow bin that the arms use in turn",
        "sizes of bin and box, and which arm comes first",
    ),
    "09_yumi": (
        "arms without closed forms; picks, then a [path](paths.md) of both tools",
        "the robot, and the points of the path",
    ),
    "10_seam": (
        "a [seam](seams.md) on a part that the other arm holds",
        "`curve` of the seam, and the pose of the part",
    ),
    "11_any_order": (
        "a kit whose [order](orders.md) the planner chooses",
        "its rules, such as `after` and `sequences`",
    ),
    "12_chute": (
        "a [buffer](orders.md#buffers) with room for two parts",
        "`capacity` of the buffer, and the poses of the two ends of the chute",
    ),
    "13_hand_over": (
        "two brackets that go [from arm to arm](hand-over.md)",
        "the shape of the part, and how both arms grip it",
    ),
    "14_two_grippers": (
        "an arm that [changes its gripper](tool-change.md)",
        "`tool_changes`, the tools and their stands",
    ),
    "15_conveyor": (
        "parts on a [conveyor](conveyor.md)",
        "`velocity` of the belt, and when parts pass",
    ),
}
"""What each bundled job shows, and what to change first in a copy of it."""
PLANS = {
    **{job: [job, "--effort", "quick"] for job in JOBS},
    "04_packing": ["04_packing"],
    "04_packing with stops": ["04_packing", "--blend", "none"],
}
"""Plans of the docs by row of the table: the words after `dualarm plan`."""
DRAWINGS = {
    "any_order.png": (
        "dualarm plan tasks/11_any_order/tasks.yaml --effort quick",
        "order.png",
    ),
    "circles.png": ("dualarm plan tasks/papers/choi_circles/tasks.yaml", "circles_paths.png"),
    "curves.png": ("dualarm curve tasks/papers/qin_curves/tasks.yaml", "curves.png"),
    "gantt.png": ("dualarm plan tasks/04_packing/tasks.yaml", "gantt.png"),
    "platform.png": ("dualarm platform", "platform.png"),
    "reach.png": ("dualarm robot reach tasks/04_packing/cell.yaml --step 100mm", "reach.png"),
    "seam.png": ("dualarm plan tasks/10_seam/tasks.yaml --effort quick", "seam_seams.png"),
    "study_pareto.png": ("dualarm sweep tasks/04_packing/study.yaml", "packing-study/pareto.png"),
    "study_sensitivity.png": (
        "dualarm sweep tasks/04_packing/study.yaml",
        "packing-study/sensitivity.png",
    ),
    "tool_changes.png": (
        "dualarm plan tasks/14_two_grippers/tasks.yaml --effort quick",
        "changes.png",
    ),
}
"""Figures of the docs: the command of a page that draws each, and the file that it writes."""
MOMENTS = {"09_yumi": 0.65, "10_seam": 0.45, "13_hand_over": 0.3}
"""Instant of a screen picture as a share of the cycle; a third for all others."""
HERO = "04_packing"
"""Job of the README's picture."""
HERO_MOMENT = 0.235
"""Instant of the README's picture as a share of the cycle: both arms at their cartons."""
HERO_SIZE = (3840, 2400)
"""Width and height of the view that it is cut from [pixels]."""
HERO_CUT = (0.205, 0.03, 0.765, 0.56)
"""Left, upper, right and lower edge of the cut as shares of the view: the robot and its work."""
SIZE = (1280, 800)
"""Width and height of screen pictures [pixels]."""
BROWSER = (
    *("--headless=new", "--no-sandbox", "--hide-scrollbars", "--virtual-time-budget=6000"),
    *(
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        f"--window-size={SIZE[0]},{SIZE[1]}",
    ),
)
NUMBER = re.compile(
    r"(?P<number>\d[\d.]*)(?P<unit>(?: [^\s<\d]+)?)<!-- figure: (?P<source>[^>]+) -->"
)
ROWS = re.compile(r"(<!-- rows: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
MEASUREMENTS = DOCS / "measurements.md"
MEASURED = re.compile(
    r"<!-- (?P<how>measured|measured alone): python -m (?P<words>[^>]+) -->\n(.*?)<!-- end -->",
    re.DOTALL,
)
STATE = re.compile(r"(<!-- state -->\n)(.*?)(<!-- end -->)", re.DOTALL)
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
UNITS = {"": 1.0, " s": 1.0, " %": 100.0, " mm": 1000.0, " ms": 1000.0}
"""Size of the SI unit in the units of the pages."""


def dualarm(words: list[str], folder: Path) -> float:
    """Runs a command in a folder that holds `tasks`; returns its processor time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "dualarm_cli", *words]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def row_of(name: str, folder: Path) -> Row:
    """Makes a plan of the table in a folder; returns its row, numbers in SI units."""
    words = PLANS[name]
    seconds = dualarm(["plan", *words, "--out", name, "--force", "--quiet"], folder)
    report = json.loads((folder / name / "report.json").read_text())
    gap = report["smallest_clearance"]
    return {
        "command": shlex.join(["dualarm", "plan", *words]),
        "robot": report["robot"],
        "stages": len(report["stages"]),
        "parts": report["parts"],
        "closes": report["closes"],
        "cycle_time": round(report["cycle_time"], 6),
        "lower_bound": _rounded(report["lower_bound"]),
        "gap": _rounded(report["gap"]),
        "clearance": _rounded(gap and gap["clearance"]),
        "processor_time": round(seconds, 1),
    }


def _rounded(number: float | None) -> float | None:
    return None if number is None else round(number, 6)


def differences(name: str, row: Row, folder: Path) -> list[str]:
    """Makes a plan again; returns how it differs from its row, but for the time that it takes."""
    now = row_of(name, folder)
    return [
        f"{name}: {key} is {now[key]}, docs/figures.json has {row[key]}"
        for key in row
        if key != "processor_time" and now[key] != row[key]
    ]


def table() -> dict[str, Row]:
    """Reads the table."""
    rows: dict[str, Row] = json.loads(TABLE.read_text(encoding="utf-8"))
    return rows


def write_table(folder: Path) -> None:
    """Makes all plans, and writes their numbers."""
    rows = {name: row_of(name, folder) for name in PLANS}
    TABLE.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def shown(row: Row) -> Row:
    """Returns what a picture carries: the row without the time that planning took."""
    return {key: value for key, value in row.items() if key != "processor_time"}


def drawn_row(figure: str) -> str | None:
    """Returns the row of the table that a drawing shows, or none: a study, a curve, another effort."""
    command = DRAWINGS[figure][0]
    commands = {row["command"]: name for name, row in table().items()}
    return commands.get(command.replace("tasks/", "").replace("/tasks.yaml", ""))


def save(picture: Path, to: Path, row: Row | None, colours: int | None = 256) -> None:
    """Writes a picture with few colours, or with all, and with the row that it shows."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    if row is not None:
        text.add_text("dualarm", json.dumps(shown(row)))
    with Image.open(picture) as image:
        picture_of = image.convert("RGB")
        shown_colours = picture_of if colours is None else picture_of.quantize(colours)
        shown_colours.save(to, pnginfo=text, optimize=True)


def draw(folder: Path) -> None:
    """Draws the figures of commands; `--plot` or `--out` names the file."""
    for command in dict.fromkeys(command for command, _ in DRAWINGS.values()):
        files = {name: file for name, (drawing, file) in DRAWINGS.items() if drawing == command}
        asked = re.sub("_(paths|seams)", "", next(iter(files.values())).split("/")[0])
        option = "--out" if {"reach", "sweep"} & set(command.split()) else "--plot"
        plan = ["--out", "drawing", "--force"] if command.startswith("dualarm plan") else []
        dualarm([*shlex.split(command)[1:], option, asked, *plan], folder)
        for name, file in files.items():
            row = drawn_row(name)
            save(folder / file, DOCS / name, None if row is None else table()[row])


def take_screens(folder: Path) -> None:
    """Takes a picture of the page of each job, planned before or now."""
    browser = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome")))
    )
    PICTURES.mkdir(exist_ok=True)
    for old in PICTURES.glob("*.png"):
        old.unlink()
    for name in JOBS:
        page, row = folder / name / "report.html", table()[name]
        if not page.exists():
            row_of(name, folder)
        time = MOMENTS.get(name, 1 / 3) * row["cycle_time"]
        picture = folder / "screen.png"
        address = f"{page.resolve().as_uri()}#t={time:.3f}"
        command = [browser, *BROWSER, f"--screenshot={picture}", address]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        save(picture, PICTURES / f"{name}.png", row)
    take_hero(folder)


def take_hero(folder: Path) -> None:
    """Takes the README's picture: a cut of the 3-D view without marks of closest pairs."""
    from PIL import Image

    from dualarm_cli.page.video import browsing

    page, row = folder / HERO / "report.html", table()[HERO]
    if not page.exists():
        row_of(HERO, folder)
    width, height = HERO_SIZE
    time = HERO_MOMENT * row["cycle_time"]
    buttons = "[...document.querySelectorAll('.view-bar button')]"
    with browsing(page) as evaluate:
        evaluate(f"{buttons}.find((button) => button.textContent === 'closest').click()")
        url = evaluate(f"window.dualarm.frame({time}, {width}, {height}, true)")
    with Image.open(BytesIO(base64.b64decode(url.partition(",")[2]))) as view:
        left, upper, right, lower = HERO_CUT
        cut = view.crop((left * width, upper * height, right * width, lower * height))
        cut.reduce(2).save(folder / "hero.png")
    save(folder / "hero.png", PICTURES / "hero.png", row, None)


def filled(text: str, rows: Mapping[str, Row]) -> str:
    """Returns the text of a page with the numbers and the rows of the table."""

    def number(match: re.Match[str]) -> str:
        name, _, member = match["source"].strip().rpartition(" ")
        decimals = len(match["number"].partition(".")[2])
        value = f"{rows[name][member] * UNITS[match['unit']]:.{decimals}f}"
        return f"{value}{match['unit']}<!-- figure: {match['source']} -->"

    def block(match: re.Match[str]) -> str:
        lines = "".join(f"{line}\n" for line in LISTS[match[2]](rows))
        return f"{match[1]}{lines}{match[4]}"

    return ROWS.sub(block, NUMBER.sub(number, text))


def fill_pages() -> None:
    """Writes the numbers of the table into the pages."""
    rows = table()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        page.write_text(filled(text, rows), encoding="utf-8")


def gallery_rows(rows: Mapping[str, Row]) -> Iterator[str]:
    """Yields the gallery: a picture of each job that has one, its cycle and what it shows."""
    for name, (what, change) in JOBS.items():
        row = rows[name]
        yield f"## {name}\n"
        cycle = f"{'Cycle' if row['closes'] else 'Duration'} {row['cycle_time']:.3f} s"
        if row["lower_bound"]:
            cycle += f"; no plan of these stages is faster than {row['lower_bound']:.3f} s"
        yield f"{row['robot']}: {what}. {cycle}.\n"
        yield f"Change first: {change}. `{row['command']}`\n"
        if (PICTURES / f"{name}.png").exists():
            yield f"![The page of {name}: the cell in motion, who does what and when](../pictures/{name}.png)\n"


def planning_rows(rows: Mapping[str, Row]) -> Iterator[str]:
    """Yields the table of planning times."""
    yield "| command | stages | cycle | processor time |"
    yield "| --- | --- | --- | --- |"
    for row in rows.values():
        yield (
            f"| `{row['command']}` | {row['stages']} | {row['cycle_time']:.3f} s "
            f"| {row['processor_time']:.0f} s |"
        )


LISTS: Mapping[str, Callable[[Mapping[str, Row]], Iterator[str]]] = {
    "gallery": gallery_rows,
    "planning": planning_rows,
}
"""What is written whole, by its name in the page."""


def correct_outputs() -> None:
    """Runs the commands of all pages, and writes what they print into the outputs below them."""
    sys.path.insert(0, str(DOCS))
    import blocks

    for page in blocks.PAGES:
        with tempfile.TemporaryDirectory() as folder:
            page.write_text(blocks.correct_page(page, Path(folder), slow=True), encoding="utf-8")


def measure() -> None:
    """Runs all benchmarks of the measurements, and writes their tables into the page.

    Two run beside each other, but those that are measured alone. A run that is interrupted leaves the tables that it
    has, below the sentence on the state before: the page's text must then say which they are.
    """
    text = MEASUREMENTS.read_text(encoding="utf-8")
    found = {match["words"]: match["how"] == "measured alone" for match in MEASURED.finditer(text)}
    beside = [words for words, alone in found.items() if not alone]
    before = state()
    with ThreadPool(2) as pool:
        for words, table in pool.imap_unordered(lambda words: (words, measured(words)), beside, 1):
            write_measured(words, table)
    for words in (words for words, alone in found.items() if alone):
        write_measured(words, measured(words))
    text = MEASUREMENTS.read_text(encoding="utf-8")
    text = STATE.sub(lambda match: f"{match[1]}{before}\n{match[3]}", text)
    MEASUREMENTS.write_text(text, encoding="utf-8")


def write_measured(words: str, table: str) -> None:
    """Writes a benchmark's table into the page."""

    def block(match: re.Match[str]) -> str:
        head = f"<!-- {match['how']}: python -m {match['words']} -->"
        return f"{head}\n\n{table.strip()}\n\n<!-- end -->" if match["words"] == words else match[0]

    text = MEASURED.sub(block, MEASUREMENTS.read_text(encoding="utf-8"))
    MEASUREMENTS.write_text(text, encoding="utf-8")


def measured(words: str) -> str:
    """Runs a benchmark in the root folder; returns what it prints.

    Raises:
        subprocess.CalledProcessError: it fails.
    """
    command = [sys.executable, "-m", *shlex.split(words)]
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)}
    begin = time.perf_counter()
    done = subprocess.run(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, check=True, text=True
    )
    print(f"{time.perf_counter() - begin:6.0f} s  {words}", file=sys.stderr, flush=True)
    return done.stdout


def state() -> str:
    """Returns the sentence that says what was measured, when, and on which machine."""
    git = ["git", "-C", str(ROOT), "rev-parse", "--short=8", "HEAD"]
    commit = subprocess.run(git, capture_output=True, check=True, text=True).stdout.strip()
    processor = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    name = processor[1] if processor else platform.machine()
    day = datetime.date.today().isoformat()
    machine = f"{os.cpu_count()} cores of {name}, Python {platform.python_version()}"
    return f"Measured at commit {commit} on {day}: {machine}."


def main(steps: list[str]) -> None:
    """Does the steps that are named, or a whole run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tasks").symlink_to(ROOT / "tasks", target_is_directory=True)
        does: dict[str, Callable[[], None]] = {
            "table": lambda: write_table(folder),
            "drawings": lambda: draw(folder),
            "screens": lambda: take_screens(folder),
            "pages": fill_pages,
            "outputs": correct_outputs,
            "hero": lambda: take_hero(folder),
            "measurements": measure,
        }
        for step in steps or list(does)[:-2]:
            does[step]()


if __name__ == "__main__":
    main(sys.argv[1:])
