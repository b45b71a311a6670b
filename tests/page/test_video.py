"""`dualarm report --video`: what it needs, and what it writes with stand-ins for the browser and the encoder."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import pytest

from dualarm_cli.errors import OutputError, UsageError
from dualarm_cli.page.video import FORMS, refuse_video, write_video

BROWSER = """#!{python}
import base64, json, os
fault = os.environ.get("FAULT")
rest = b""
def answers():
    global rest
    while b"\\0" not in rest:
        part = os.read(3, 65536)
        if not part:
            raise SystemExit
        rest += part
    text, _, rest = rest.partition(b"\\0")
    return json.loads(text)
while True:
    ask = answers()
    expression = ask["params"].get("expression", "")
    value = True
    if ".duration" in expression:
        value = 0.5
    elif ".frame(" in expression:
        if fault == "ends":
            raise SystemExit
        value = "data:image/jpeg;base64," + base64.b64encode(expression.encode() + b"\\n").decode()
    result = {{"targetId": "t", "sessionId": "s", "result": {{"value": value}}}}
    if fault == "throws" and ".frame(" in expression:
        result["exceptionDetails"] = {{"text": "no WebGL"}}
    os.write(4, json.dumps({{"method": "Target.event"}}).encode() + b"\\0")
    os.write(4, json.dumps({{"id": ask["id"], "result": result}}).encode() + b"\\0")
"""
ENCODER = """#!/bin/sh
for last; do :; done
if [ "$FAULT" = encoder ]; then echo "broken codec" >&2; exit 1; fi
cat > "$last"
"""


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Puts a browser that draws its requests and an encoder that copies them first on the path."""
    folder = tmp_path / "bin"
    folder.mkdir()
    python = shutil.which("python3")
    for name, text in (("chromium", BROWSER.format(python=python)), ("ffmpeg", ENCODER)):
        (folder / name).write_text(text)
        (folder / name).chmod(stat.S_IRWXU)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder


def test_a_frame_is_drawn_for_each_period_and_for_the_end(programs: Path, tmp_path: Path) -> None:
    """At 12 frames a second half a second has the instants 0, 1/12, … 6/12 s."""
    counted: list[tuple[int, int]] = []
    write_video(tmp_path / "p.html", tmp_path / "v.gif", lambda *now: counted.append(now))
    expected = [f"window.dualarm.frame({k / 12!r}, 640, 360)" for k in range(7)]
    assert (tmp_path / "v.gif").read_text().splitlines() == expected
    assert counted == [(k + 1, 7) for k in range(7)]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("ends", "Chromium does not answer"),
        ("throws", "Chromium refuses Runtime.evaluate: no WebGL"),
        ("encoder", "ffmpeg failed: broken codec"),
    ],
)
def test_a_program_that_fails_leaves_no_video(
    fault: str, message: str, programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAULT", fault)
    with pytest.raises(OutputError, match=message):
        write_video(tmp_path / "p.html", tmp_path / "v.mp4", lambda *now: None)
    assert not (tmp_path / "v.mp4").exists()


def test_missing_programs_and_other_suffixes_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match=r"v\.avi must end in \.mp4 or \.gif"):
        refuse_video(Path("v.avi"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="needs Chromium and ffmpeg on this machine; install them"):
        refuse_video(Path("v.mp4"))


def test_forms_are_of_even_size(programs: Path) -> None:
    """The usual H.264 profile has half as many colour samples in both directions."""
    for suffix, form in FORMS.items():
        refuse_video(Path(f"V{suffix.upper()}"))
        assert form.width % 2 == form.height % 2 == 0
