from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.source.projects import BadReferenceError, Project, display_name
from dualarm_cli.files.tasks.tasks import load_job
from tests.checked_files import check_file

Change = Callable[..., None]


def test_the_project_folder_is_the_nearest_marked_ancestor(tmp_path: Path) -> None:
    """dualarm.toml or .git; else the file's parent's parent."""
    folder = tmp_path / "a" / "b" / "c"
    folder.mkdir(parents=True)
    assert Project.of(folder / "tasks.yaml").folder == tmp_path / "a" / "b"
    (tmp_path / ".git").mkdir()
    assert Project.of(folder / "tasks.yaml").folder == tmp_path
    (tmp_path / "a" / "dualarm.toml").write_text("")
    assert Project.of(folder / "tasks.yaml").folder == tmp_path / "a"


def test_paths_are_relative_to_the_file_that_holds_them(project: Path) -> None:
    """Tasks in one folder, cells in another, robots in a third; every hash has its project name."""
    for folder, names in {
        "t": ["tasks.yaml"],
        "c": ["cell.yaml"],
        "r": ["robot.yaml", "tiny.urdf"],
    }.items():
        (project / folder).mkdir()
        for name in names:
            (project / name).rename(project / folder / name)
    for path, old, new in (
        ("t/tasks.yaml", "cell: cell.yaml", "cell: ../c/cell.yaml"),
        ("c/cell.yaml", "robot: robot.yaml", "robot: ../r/robot.yaml"),
    ):
        (project / path).write_text((project / path).read_text().replace(old, new))
    job = load_job("t/tasks.yaml")
    assert list(job.inputs) == ["t/tasks.yaml", "c/cell.yaml", "r/robot.yaml", "r/tiny.urdf"]
    assert job.tasks[0].stops[0].place.file == "t/tasks.yaml"
    (project / "r/tiny.urdf").write_text("")
    assert [str(d) for d in check_file("t/tasks.yaml")] == [
        "r/tiny.urdf: E400 is empty; a URDF is required"
    ]


def test_a_symbolic_link_cannot_lead_out_of_the_project(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Links are resolved before the folder is compared."""
    outside = tmp_path_factory.mktemp("outside") / "cell.yaml"
    outside.write_text((project / "cell.yaml").read_text())
    (project / "cell.yaml").unlink()
    (project / "cell.yaml").symlink_to(outside)
    assert [str(d) for d in check_file("tasks.yaml")] == [
        f"tasks.yaml:2:7: E500 'cell.yaml' leaves the project folder '{project.name}'; keep the "
        "file inside it, or put a dualarm.toml into the folder that holds both"
    ]


@pytest.mark.parametrize(
    "reference", ["/etc/passwd", "~/x", "C:\\x", "http://a/b", " ", "a\0b", ".."]
)
def test_what_is_no_relative_path_is_refused(reference: str, project: Path) -> None:
    """Absolute paths, home folders, URLs, blanks, NUL and ways out."""
    with pytest.raises(BadReferenceError):
        Project(project).follow(reference, project / "tasks.yaml")


def test_referenced_files_are_shown_as_the_user_would_name_them() -> None:
    """Relative to the working directory, like the file that names them."""
    assert display_name("../cells/a.yaml", "tasks/t.yaml") == "cells/a.yaml"
    assert display_name("a.yaml", "t.yaml") == "a.yaml"


def test_a_file_name_that_is_not_utf_8_loads(project: Path) -> None:
    """Bytes of the file system survive; only what is printed is made printable."""
    name = b"t\xff.yaml".decode("utf-8", "surrogateescape")
    (project / "tasks.yaml").rename(project / name)
    assert len(load_job(name).tasks) == 2
