from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import bundled_robots, robots_folder
from tests.checked_files import check_file

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("tasks/**/*.yaml")), ids=lambda p: str(p.relative_to(ROOT))
)
def test_every_file_of_the_task_folder_is_good(path: Path) -> None:
    """What the repository ships passes its own check; the second one is the format's example."""
    assert [str(d) for d in check_file(path)] == []


@pytest.mark.parametrize("name", bundled_robots())
def test_every_bundled_robot_loads_by_name(name: str) -> None:
    """Its files are recorded under robots/, wherever the package is."""
    inputs = load_robot(name).inputs
    assert f"robots/{name}/robot.yaml" in inputs
    assert all(key.startswith(f"robots/{name}/") for key in inputs)


def test_a_bundled_robot_is_found_from_any_project(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cell outside the repository names it without a path."""
    (tmp_path / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {bundled_robots()[0]}\n")
    monkeypatch.chdir(tmp_path)
    loaded = load_cell("cell.yaml")
    assert f"{tmp_path.name}/cell.yaml" in loaded.inputs
    assert robots_folder().is_dir()
