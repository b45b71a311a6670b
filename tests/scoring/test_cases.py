"""Which task files are meant by names, patterns and folders."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.errors import UsageError
from dualarm_cli.scoring.cases import find_cases

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
