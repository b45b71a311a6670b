"""`dualarm explain`: every code that the program prints is explained, and no other."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

import dualarm_cli
from dualarm_cli.cli.run import run
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.explanations import explanations
from dualarm_cli.files.source.diagnostics import error_text
from dualarm_cli.refusals import Refusal, codes, sentences

PACKAGE = Path(dualarm_cli.__file__).parent
CODE = re.compile(r"\bE[1-9][0-9]{2}\b")


def test_the_table_has_every_code_of_the_program_and_no_other() -> None:
    used = {
        code
        for file in PACKAGE.rglob("*.py")
        if file.name != "explanations.py"
        for code in re.findall(r"\"(E[1-9][0-9]{2})\"", file.read_text())
    }
    assert used == set(explanations())
    assert list(explanations()) == sorted(explanations())
    assert set(codes()) == set(sentences())


@pytest.mark.parametrize("code", explanations())
def test_an_explanation_says_why_and_what_to_do(
    code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its example, where it has one, is of that code."""
    one = explanations()[code]
    assert run(["explain", code.lower()]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"{code}: {one.title}\n")
    assert one.causes
    assert one.remedies
    for sentence in (*one.causes, *one.remedies):
        assert sentence in shown
        assert sentence.endswith(".")
    assert set(CODE.findall(one.example)) <= {code}


def test_an_explanation_names_a_page_that_the_wheel_carries(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The path is a file, and below one of the paths of `docs` that the build puts into the wheel."""
    build = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    carried = build["targets"]["wheel"]["force-include"]
    for code, entry in explanations().items():
        assert run(["explain", code]) == 0
        *_, shown = capsys.readouterr().out.strip().rpartition("\nMore: ")
        assert entry.page, code
        assert Path(shown) == PACKAGE.parent / "docs" / entry.page
        assert Path(shown).is_file(), code
        source = f"docs/{entry.page}"
        assert source in carried or source.rsplit("/", 1)[0] in carried, code
    assert all(f"dualarm_cli/bundled/{name}" == path for name, path in carried.items())


def test_an_unknown_code_gets_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["explain", "E2000"]) == 2
    assert "did you mean 'E200'?" in capsys.readouterr().err


def test_all_codes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["explain"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(explanations())
    assert run(["explain", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [row["code"] for row in document["codes"]] == list(explanations())


MISTAKES = {
    "E101": ("mode: paired", "mode: {paired"),
    "E102": ("id: tray-2", "id: tray-1"),
    "E104": ("approach: 80 mm", "approach: .nan"),
    "E105": ("mode: paired", "mode: *x"),
    "E200": ("approach: 80 mm", "approach: 80 s"),
    "E201": ("mode: paired", "mod: paired"),
    "E300": ("start: home", "start: hom"),
    "E500": ("cell: cell.yaml", "cell: cel.yaml"),
}


@pytest.mark.parametrize("code", MISTAKES)
def test_an_error_ends_with_the_command_that_explains_it(
    code: str, tmp_path: Path, tasks_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tasks_folder / "02_two_trays"
    old, new = MISTAKES[code]
    text = (source / "tasks.yaml").read_text()
    if old == "start: home" and old not in text:
        text = text.replace("mode: paired", "mode: paired\nstart: home")
    assert old in text
    (tmp_path / "tasks.yaml").write_text(text.replace(old, new))
    (tmp_path / "cell.yaml").write_text((source / "cell.yaml").read_text())
    assert run(["plan", str(tmp_path / "tasks.yaml"), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error[{code}]: {tmp_path}") or f"\nerror[{code}]: " in err
    assert f"`dualarm explain {code}`" in err.splitlines()[-1]


def test_a_job_without_a_plan_names_the_code_and_where_to_read_more(
    tmp_path: Path, tasks_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A target 5 m away."""
    source = tasks_folder / "02_two_trays"
    text = (source / "tasks.yaml").read_text()
    far = re.sub(r"xyz: \[[^]]*\]", "xyz: [5, 5, 1]", text, count=1)
    (tmp_path / "tasks.yaml").write_text(far)
    (tmp_path / "cell.yaml").write_text((source / "cell.yaml").read_text())
    code = run(["plan", str(tmp_path / "tasks.yaml"), "--out", str(tmp_path / "out")])
    err = capsys.readouterr().err
    assert code == 3
    assert err.startswith("error[E610]: ") or "\nerror[E610]: " in err
    assert err.splitlines()[-1] == "More about it: `dualarm explain E610`"


def test_each_refusal_has_its_own_line():
    """With its code; help that they share has none."""
    refusals = (Refusal("by_arm", arm=arm, data={"cause": "x"}) for arm in ("left", "right"))
    assert error_text(InfeasibleError(*refusals)).splitlines() == [
        "error[E600]: left arm: x",
        "error[E600]: right arm: x",
        "More about it: `dualarm explain E600`",
    ]
