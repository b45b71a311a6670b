"""Exports on another day, in every format."""

from __future__ import annotations

import time

import pytest

from dualarm_cli.formats import FORMATS, export

DAY = 86_400
"""[s]; archives store times of day in steps of 2 s."""


@pytest.mark.parametrize("name", FORMATS)
def test_an_export_a_day_later_has_the_same_bytes(exported, name, monkeypatch):
    """Neither the time of day nor a random number is in a file."""

    def exported_files():
        return {
            file: b"".join(parts) for file, parts in export(name, exported.request(5.0)).items()
        }

    today = exported_files()
    seconds, nanoseconds = time.time, time.time_ns
    monkeypatch.setattr(time, "time", lambda: seconds() + DAY)
    monkeypatch.setattr(time, "time_ns", lambda: nanoseconds() + DAY * 10**9)
    assert exported_files() == today
