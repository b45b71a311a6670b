"""Which task files are meant by names, patterns and folders."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dualarm_cli.errors import UsageError
from dualarm_cli.scoring.baseline import find_cases

ALL = ["cells/[x]/tasks.yaml", "cells/a/tasks.yaml", "cells/b/c/tasks.yaml"]


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Three task files, cells beside them, one hidden."""
    monkeypatch.chdir(tmp_path)
    for name in [*ALL, "cells/.old/tasks.yaml"]:
        Path(name).parent.mkdir(parents=True)
        Path(name).write_text("# a job\ndualarm: tasks/1\ncell: cell.yaml\n")
        Path(name).with_name("cell.yaml").write_text("dualarm: cell/1\n")
    return tmp_path


@pytest.mark.parametrize(
    "patterns",
    [
        ["cells/**/tasks.yaml"],
        ["cells"],
        ["./cells/"],
        ["cells/*"],
        ["cel*"],
        ["."],
        ["cells/*/tasks.yaml", "cells/b/../b/c/tasks.yaml"],
        ["cells/b", "cells/a", "cells/[x]/tasks.yaml", "cells/a/tasks.yaml"],
    ],
)
def test_patterns_folders_and_names_are_the_same_cases(tree, patterns):
    """Each once, sorted, by its name from the working directory; hidden ones and cell files left out."""
    assert find_cases(patterns) == ALL


def test_absolute_names_below_the_working_directory_are_the_same_cases(tree, monkeypatch):
    """Those elsewhere stay absolute."""
    assert find_cases([str(tree / "cells" / "**" / "tasks.yaml")]) == ALL
    monkeypatch.chdir(tree / "cells" / "a")
    assert find_cases([str(tree / "cells" / "b")]) == [str(tree / "cells/b/c/tasks.yaml")]
    assert find_cases(["../b"]) == ["../b/c/tasks.yaml"]


def test_a_hidden_file_is_found_by_its_name(tree):
    """And a name that nothing has stays, so that its absence is told as that of a file."""
    assert find_cases(["cells/.old/tasks.yaml"]) == ["cells/.old/tasks.yaml"]
    assert find_cases(["cells/z/tasks.yaml"]) == ["cells/z/tasks.yaml"]


@pytest.mark.parametrize("pattern", ["cells/**/jobs.yaml", "", "cells/.git*", "empty", "\0"])
def test_what_matches_nothing_is_refused_though_others_match(tree, pattern):
    """Zero cases never pass, nor does a pattern that has lost all of its own."""
    Path("empty").mkdir()
    with pytest.raises(UsageError, match="nothing to score"):
        find_cases(["cells", pattern])


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ('"dualarm": tasks/1\ncell: cell.yaml\n', True),
        ("'dualarm' : 'tasks/1'\n", True),
        ('{"dualarm": "tasks/1", "cell": "cell.yaml"}\n', True),
        ("{ dualarm: tasks/1 }\n", True),
        ("\ufeffdualarm: tasks/1\n", True),
        ("cell: cell.yaml\r\ndualarm: tasks/1\r\n", True),
        ("# a job\n" * 10_000 + "dualarm: tasks/1\n", True),
        ("# dualarm: tasks/1\ndualarm: cell/1\n", False),
        ("dualarm: study/1\ntasks: [a/tasks/1]\n", False),
    ],
)
def test_a_task_file_of_a_folder_is_one_however_it_is_written(tmp_path, text, is_one):
    """What is passed over in silence is not compared with the baseline."""
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "other.yaml").write_text("dualarm: tasks/1\n")
    (tmp_path / "a" / "job.yaml").write_bytes(text.encode())
    found = find_cases([str(tmp_path / "a")])
    assert [name for name in found if name.endswith("job.yaml")] == [
        str(tmp_path / "a" / "job.yaml")
    ] * is_one


def test_a_folder_that_cannot_be_looked_into_is_not_passed_over(tree, monkeypatch):
    """The others have cases all the same."""
    scandir = os.scandir

    def denied(path):
        if str(path).endswith("b"):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", denied)
    with pytest.raises(UsageError, match=r"'cells/b' cannot be searched .*Permission denied"):
        find_cases(["cells"])
