"""Baselines: the same bytes for the same scores, and nothing that is damaged is believed."""

from __future__ import annotations

import json
import random

import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.evaluation.request import machine, other_machine
from dualarm_cli.scoring.baseline import baseline_bytes, read_baseline

SETTINGS = {"effort": "quick", "platform": None, "redundancy": None, "seed": 0, "timing": "ruckig"}


@pytest.fixture
def written(recorded, tmp_path):
    """A baseline of two cases in a file."""
    path = tmp_path / "scores.json"
    cases = {"cells/é \udcff/tasks.yaml": recorded(cycle_time=0.1 + 0.2), "b": recorded(gap=None)}
    path.write_bytes(baseline_bytes(SETTINGS, cases))
    return path, cases


def test_what_is_written_is_read_back_without_loss(written):
    """Names that are no text and the last digit of a float among it."""
    path, cases = written
    found = read_baseline(path)
    assert dict(found.cases) == cases
    assert dict(found.settings) == SETTINGS


def test_bytes_do_not_depend_on_the_order_of_anything(recorded):
    """Cases, settings and the members of every case in any order."""
    cases = {name: recorded(cycle_time=float(k + 1)) for k, name in enumerate("abcdef")}
    first = baseline_bytes(SETTINGS, cases)
    for seed in range(5):
        generator = random.Random(seed)
        names, keys = list(cases), list(SETTINGS)
        generator.shuffle(names)
        generator.shuffle(keys)
        shuffled = {
            name: recorded(
                cycle_time=cases[name].cycle_time,
                limiting=dict(reversed(cases[name].limiting.items())),
                limits=dict(reversed(cases[name].limits.items())),
            )
            for name in names
        }
        assert baseline_bytes({key: SETTINGS[key] for key in keys}, shuffled) == first
    assert json.loads(first)["format"] == "dualarm.scores/1"


def test_the_machine_is_recorded_and_compared(recorded, tmp_path):
    """Baselines that do not name one are compared as before; one that names something else is damaged."""
    path = tmp_path / "scores.json"
    path.write_bytes(baseline_bytes(SETTINGS, {"a": recorded()}, machine()))
    assert read_baseline(path).made_on == machine()
    assert other_machine(machine()) == other_machine("") == ""
    assert other_machine("x86-64-v0") == f"the baseline was made on x86-64-v0, this is {machine()}"
    path.write_bytes(baseline_bytes(SETTINGS, {"a": recorded()}))
    assert read_baseline(path).made_on == ""
    damaged = baseline_bytes(SETTINGS, {"a": recorded()}, "x").decode().replace('"x"', "7")
    assert "made_on is 7, not a text" in refused(path, damaged)


def refused(path, text):
    """Returns the message that a baseline is refused with."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as error:
        read_baseline(path)
    return str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("dualarm.scores/1", "dualarm.scores/2", "its format is 'dualarm.scores/2'"),
        ('"cycle_time": 10.0', '"cycle_time": NaN', "NaN is not a number"),
        ('"cycle_time": 10.0', '"cycle_time": Infinity', "Infinity is not a number"),
        ('"cycle_time": 10.0', '"cycle_time": 1e999', "cycle_time is inf"),
        ('"cycle_time": 10.0', f'"cycle_time": 1{"0" * 400}', "cycle_time is 1000"),
        ('"cycle_time": 10.0', f'"cycle_time": 1{"0" * 5000}', "is not a baseline"),
        ('"velocity": 3.0', f'"velocity": 1{"0" * 400}', "limiting, limits or inputs"),
        ('"cycle_time": 10.0', '"cycle_time": null', "cycle_time is nothing"),
        ('"cycle_time": 10.0', '"cycle_time": true', "cycle_time is true"),
        ('"cycle_time": 10.0', '"cycle_time": "10"', "cycle_time is '10'"),
        ('"cycle_time": 10.0', '"cycle_time": -1', "cycle_time is negative"),
        ('"cycle_time": 10.0', '"cycletime": 10.0', "must have clearance, cycle_time"),
        ('"cycle_time": 10.0,', '"cycle_time": 10.0, "gap": 1,', "'gap' is used twice"),
        ('"velocity": 3.0', '"velocity": "3"', "limiting, limits or inputs"),
        ('"cases"', '"caes"', "'cases' and 'settings' must be there"),
    ],
)
def test_damage_of_every_kind_is_refused_with_its_reason(recorded, tmp_path, old, new, words):
    """And with what to do."""
    text = baseline_bytes(SETTINGS, {"a": recorded()}).decode()
    assert old in text
    message = refused(tmp_path / "scores.json", text.replace(old, new, 1))
    assert words in message
    assert "--update-baseline" in message


def test_no_cut_of_a_baseline_is_taken_for_one(written):
    """Wherever it ends too early."""
    path, _ = written
    data = path.read_bytes()
    for end in range(0, len(data) - 2, 17):
        path.write_bytes(data[:end])
        with pytest.raises(InputError):
            read_baseline(path)


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", "[" * 100_000, "<<<<<<< HEAD"])
def test_what_is_something_else_is_refused(tmp_path, text):
    """Never a traceback, never a pass."""
    refused(tmp_path / "scores.json", text)


def test_what_is_no_text_is_said_in_words_of_ours(tmp_path):
    """None of Python's."""
    assert "byte 0xe9 is not UTF-8" in refused(tmp_path / "scores.json", b'{"a": "\xe9"}')
    assert "nested too deeply" in refused(tmp_path / "scores.json", "[" * 100_000)


def test_no_cases_and_no_file_are_refused(tmp_path):
    """Nothing could be compared with them."""
    empty = baseline_bytes(SETTINGS, {}).decode()
    assert "has no cases" in refused(tmp_path / "scores.json", empty)
    with pytest.raises(InputError, match="cannot be read"):
        read_baseline(tmp_path / "nowhere.json")
