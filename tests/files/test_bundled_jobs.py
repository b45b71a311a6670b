"""Bundled jobs go by their names wherever a task file is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError
from dualarm_cli.files.checking import load_file
from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.files.tasks.tasks import load_job


@pytest.mark.parametrize("name", bundled_tasks())
def test_a_bundled_job_is_read_by_its_name_anywhere(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    job = load_job(name)
    assert [task.id for task in job.tasks] == [
        task.id for task in load_job(bundled_tasks()[name]).tasks
    ]
    assert type(load_file(name)) is type(job)


def test_a_file_of_that_name_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "04_packing").write_text("dualarm: tasks/1\n")
    with pytest.raises(InputError, match="04_packing:1:1: E202"):
        load_job("04_packing")


def test_a_name_that_there_is_not_gets_the_nearest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["plan", "04_pack"]) == 2
    assert "no such bundled job, did you mean '04_packing'?" in capsys.readouterr().err


def test_a_plan_of_a_bundled_job_is_called_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two jobs planned in one folder do not get into each other's way; what was written is verified by name, too."""
    monkeypatch.chdir(tmp_path)
    assert run(["plan", "01_first_pick", "--effort", "quick", "--quiet"]) == 0
    assert (tmp_path / "01_first_pick-plan" / "schedule.json").is_file()
    assert run(["verify", "01_first_pick-plan", "--tasks", "01_first_pick", "--quiet"]) == 0
