"""Values of every bundled file replaced by those of other kinds: `check` says what is wrong, where, and never fails."""

from __future__ import annotations

import copy
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from dualarm_cli.cli.check import _check_one
from dualarm_cli.errors import Diagnostic

ROOT = Path(__file__).parents[2]
FILES = sorted(
    str(path.relative_to(ROOT))
    for folder in ("tasks", "robots")
    for path in (ROOT / folder).rglob("*.yaml")
)
VALUES = (
    *(
        "5",
        '"x"',
        "[]",
        "{}",
        "null",
        "true",
        "1e400",
        ".nan",
        "-1",
        "[[a, b]]",
        "{a: 5}",
        "1e-300",
    ),
    *(
        "srs",
        "spherical_wrist",
        "any",
        "both",
        "free",
        "optimise",
        "12 deg",
        "3 m/s",
        "[0, 0, 0]",
        "0",
    ),
)
MARK = "replaced_here"
Key = tuple[str | int, ...]


def keys_of(value: Any, before: Key = ()) -> Iterator[Key]:
    """Yields the way to every value of a document, outer ones first."""
    pairs = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, inner in pairs:
        yield (*before, key)
        yield from keys_of(inner, (*before, key))


def replaced(document: Any, ways: list[Key], literals: list[str]) -> str:
    """Returns a document's text with some values replaced; what is within one that was replaced stays out."""
    document = copy.deepcopy(document)
    for number, way in enumerate(ways):
        holder = document
        try:
            for key in way[:-1]:
                holder = holder[key]
            holder[way[-1]] = f"{MARK}{number}_"
        except (TypeError, KeyError, IndexError):
            continue
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=10_000)
    for number, literal in enumerate(literals):
        text = text.replace(f"{MARK}{number}_", literal)
    return text


def faults(file: Path, text: str, folder: Path) -> list[str]:
    """Returns what is wrong with what `check` says of a file with another text."""
    before = file.read_text()
    file.write_text(text)
    try:
        found = _check_one(str(file))["diagnostics"]
    except Exception as error:
        return [f"{type(error).__name__}: {error}"]
    finally:
        file.write_text(before)
    return [f"{fault}: {one}" for one in found for fault in _faults_of(one, folder)]


def _faults_of(one: Diagnostic, folder: Path) -> Iterator[str]:
    if one.line == 0:
        yield "no line"
    if not (Path(one.file).is_file() or (folder / one.file).is_file()):
        yield "no such file"
    for words in ("Value error", "Input should", "inf ", "nan ", "NoneType", "dict", "<class"):
        if words in one.message:
            yield f"says {words!r}"


@pytest.fixture
def bundled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the bundled tasks and robots."""
    for folder in ("tasks", "robots"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    (tmp_path / "dualarm.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _try_all(name: str, folder: Path, tries: list[tuple[list[Key], list[str]]]) -> None:
    file = folder / name
    document = yaml.safe_load(file.read_text())
    wrong = {}
    for ways, literals in tries:
        found = faults(Path(name), replaced(document, ways, literals), folder)
        if found:
            wrong[f"{ways} = {literals}"] = found
    assert wrong == {}


@pytest.mark.parametrize("name", FILES)
def test_some_replaced_values_are_refused_in_their_place(name: str, bundled: Path) -> None:
    """Two tries for each file, two values at a time."""
    dice = random.Random(name)
    ways = list(keys_of(yaml.safe_load((bundled / name).read_text())))
    tries = [(dice.choices(ways, k=2), dice.choices(VALUES, k=2)) for _ in range(2)]
    _try_all(name, bundled, tries)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_every_value_replaced_is_refused_in_its_place(name: str, bundled: Path) -> None:
    """Each value by four others at least; of lists only the first two entries, as the others are like them."""
    dice = random.Random(name)
    ways = list(keys_of(yaml.safe_load((bundled / name).read_text())))
    ways = [way for way in ways if all(isinstance(key, str) or key < 2 for key in way)]
    tries = [([way], [literal]) for way in ways for literal in dice.sample(VALUES, 4)]
    tries += [(dice.choices(ways, k=3), dice.choices(VALUES, k=3)) for _ in range(100)]
    _try_all(name, bundled, tries)
