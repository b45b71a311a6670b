"""Shell completion, by the protocol that typer's scripts use: words in the environment, proposals on stdout."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.schemas import KINDS
from dualarm_cli.timing import TIMING_SOLVERS


@pytest.fixture
def complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Returns what is proposed for the last of some words, in a folder with two YAML files and a folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("tasks.yaml", "07_mine.yml", "notes.txt", ".hidden.yaml"):
        (tmp_path / name).touch()
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "a.yaml").touch()

    def proposals(*words: str) -> list[str]:
        monkeypatch.setenv("_DUALARM_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", " ".join(("dualarm", *words)))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        assert run([]) == 0
        return capsys.readouterr().out.split()

    return proposals


def test_solvers_are_proposed(complete) -> None:
    assert set(complete("plan", "--timing", "")) == {solver.name for solver in TIMING_SOLVERS}
    assert complete("plan", "--platform", "seq") == ["sequence"]
    assert "virtual_spring" in complete("plan", "--redundancy", "vir")
    assert complete("compare", "solvers", "--method", "min") == ["minimum_time"]
    assert complete("calibrate", "--method", "fr") == ["frame"]


def test_robots_are_proposed(complete) -> None:
    assert complete("robot", "show", "iiwa") == ["iiwa14", "iiwa7"]
    assert complete("robot", "export", "sda") == ["sda10f"]


def test_jobs_and_yaml_files_are_proposed(complete) -> None:
    """Bundled jobs first; files as the user began to write them; hidden ones only where a dot was typed."""
    assert complete("plan", "07") == ["07_two_shelves", "07_mine.yml"]
    assert complete("plan", "t") == ["tasks.yaml"]
    assert complete("plan", "c") == ["cells/"]
    assert complete("plan", "cells/") == ["cells/a.yaml"]
    assert complete("plan", "nowhere/") == []
    assert not [one for one in complete("plan", "") if one.startswith(".")]
    assert complete("plan", ".h") == [".hidden.yaml"]


def test_kinds_and_codes_are_proposed(complete) -> None:
    assert set(complete("schema", "")) == set(KINDS)
    assert complete("explain", "E600") == ["E600"]
