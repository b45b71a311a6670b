"""Video of a page's 3-D view: headless Chromium draws the frames, ffmpeg encodes them.

Both are programs of the machine. Chromium is driven over its debugging pipe, whose messages are JSON ended by a zero
byte, so that no port is opened.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dualarm_cli.errors import OutputError, UsageError
from dualarm_cli.exporting.whole_files import write_file
from dualarm_cli.records import dataclass

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
"""Names of the browser's program, in order of search."""
_FLAGS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


_LAUNCHER = """
import fcntl, os, sys
reads, writes = (fcntl.fcntl(int(word), fcntl.F_DUPFD, 10) for word in sys.argv[1:3])
os.dup2(reads, 3), os.dup2(writes, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Program that becomes the browser, which reads descriptor 3 and writes 4."""


@dataclass(frozen=True)
class VideoForm:
    """Size, rate and encoder of a kind of video file."""

    width: int
    """Width [px]."""
    height: int
    """Height [px]."""
    rate: int
    """Frames per second."""
    encoder: tuple[str, ...]
    """Options of ffmpeg."""


FORMS = {
    ".mp4": VideoForm(
        1280,
        720,
        25,
        (*("-c:v", "libx264", "-crf", "20"), *("-pix_fmt", "yuv420p", "-movflags", "+faststart")),
    ),
    ".gif": VideoForm(
        640,
        360,
        12,
        (
            "-filter_complex",
            "split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=none",
        ),
    ),
}
"""Forms of video by the suffix of the file."""
ANSWER_LIMIT = 120.0
"""Longest time to wait for one answer of the browser [s]."""


def refuse_video(video: Path) -> None:
    """Refuse a video that cannot be made, before any work.

    Raises:
        UsageError: its suffix is of no form, or a program is missing.
    """
    if video.suffix.lower() not in FORMS:
        raise UsageError(f"--video: {video.name} must end in {' or '.join(FORMS)}")
    missing = [
        name
        for name, program in (("Chromium", _browser()), ("ffmpeg", shutil.which("ffmpeg")))
        if not program
    ]
    if missing:
        raise UsageError(
            f"--video needs {' and '.join(missing)} on this machine; install "
            f"{'it' if len(missing) == 1 else 'them'}, or record the page yourself"
        )


def write_video(page: Path, video: Path, progress: Callable[[int, int], None]) -> None:
    """Record the 3-D view of a page in real time.

    Args:
        page: file that `Plan.write_page` wrote.
        video: file to write; its suffix selects the form.
        progress: called with the frames done and all frames.

    Raises:
        OutputError: a program fails, or the file cannot be written.
    """
    form = FORMS[video.suffix.lower()]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"video{video.suffix.lower()}"
        source = ("-f", "image2pipe", "-framerate", str(form.rate), "-i", "-")
        command = ["ffmpeg", "-loglevel", "error", *source]
        pipe = subprocess.PIPE
        with subprocess.Popen([*command, *form.encoder, file], stdin=pipe, stderr=pipe) as ffmpeg:
            assert ffmpeg.stdin is not None and ffmpeg.stderr is not None
            try:
                for picture in _frames(page, form, progress):
                    ffmpeg.stdin.write(picture)
                ffmpeg.stdin.close()
            except BrokenPipeError:
                pass
            except BaseException:
                ffmpeg.kill()
                raise
            reason = ffmpeg.stderr.read().decode(errors="replace").strip()
        if ffmpeg.returncode != 0 or not file.is_file():
            raise OutputError(
                f"{video}: ffmpeg failed: {reason.splitlines()[-1] if reason else ffmpeg.returncode}"
            )
        write_file(video, file.read_bytes(), True)


def _frames(page: Path, form: VideoForm, progress: Callable[[int, int], None]) -> Iterator[bytes]:
    """Draw the frames of a plan as JPEG pictures."""
    with browsing(page) as evaluate:
        duration = float(evaluate("window.dualarm.duration"))
        count = max(int(duration * form.rate) + 1, 2)
        for k in range(count):
            moment = min(k / form.rate, duration)
            url = str(evaluate(f"window.dualarm.frame({moment!r}, {form.width}, {form.height})"))
            yield base64.b64decode(url.partition(",")[2])
            progress(k + 1, count)


@contextmanager
def browsing(page: Path) -> Iterator[Callable[[str], Any]]:
    """Open a page in the browser and yield the evaluator of its expressions.

    Raises:
        OutputError: the browser ends, is silent, or cannot draw the page.
    """
    (reads, tells), (hears, writes) = os.pipe(), os.pipe()
    # The browser may still write while it ends.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        flags = [
            *_FLAGS,
            f"--user-data-dir={profile}",
            *(["--no-sandbox"] if os.geteuid() == 0 else []),
        ]
        command = [sys.executable, "-c", _LAUNCHER, str(reads), str(writes), _browser(), *flags]
        quiet = subprocess.DEVNULL
        browser = subprocess.Popen(command, stdout=quiet, stderr=quiet, pass_fds=(reads, writes))
        os.close(reads)
        os.close(writes)
        try:
            pipe = _Pipe(tells, hears)
            target = pipe.call("Target.createTarget", {"url": f"{page.absolute().as_uri()}#t=0"})
            named = {"targetId": target["targetId"], "flatten": True}
            session = pipe.call("Target.attachToTarget", named)["sessionId"]

            def evaluate(expression: str) -> Any:
                request = {"expression": expression, "returnByValue": True, "awaitPromise": True}
                return pipe.call("Runtime.evaluate", request, session)["result"].get("value")

            until = time.monotonic() + ANSWER_LIMIT
            while not evaluate("window.dualarm?.ready && window.dualarm.frame !== undefined"):
                if time.monotonic() > until:
                    raise OutputError(f"{page}: Chromium cannot draw the 3-D view of the page")
                time.sleep(0.05)
            yield evaluate
        finally:
            os.close(tells)
            os.close(hears)
            browser.terminate()
            browser.wait()


class _Pipe:
    """Requests to a browser and its answers."""

    def __init__(self, tells: int, hears: int) -> None:
        """Hold the descriptors for requests and answers."""
        self._tells, self._hears = tells, hears
        self._rest, self._last = b"", 0

    def call(self, method: str, params: dict[str, Any], session: str = "") -> dict[str, Any]:
        """Send a request and wait for its result.

        Raises:
            OutputError: the browser has ended, is silent, or refuses the request.
        """
        self._last += 1
        request = {"id": self._last, "method": method, "params": params}
        try:
            os.write(
                self._tells,
                json.dumps(request | ({"sessionId": session} if session else {})).encode() + b"\0",
            )
        except BrokenPipeError:
            raise OutputError("Chromium has ended; start it once by hand to see why") from None
        while (answer := self._message()).get("id") != self._last:
            pass
        fault = answer.get("error") or answer["result"].get("exceptionDetails")
        if fault:
            raise OutputError(
                f"Chromium refuses {method}: {fault.get('message') or fault.get('text')}"
            )
        result: dict[str, Any] = answer["result"]
        return result

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._hears], [], [], ANSWER_LIMIT)
            part = os.read(self._hears, 1 << 20) if ready else b""
            if not part:
                raise OutputError("Chromium does not answer; start it once by hand to see why")
            self._rest += part
        text, _, self._rest = self._rest.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        return message


def _browser() -> str:
    """Find the browser's program; empty if there is none."""
    return next(filter(None, map(shutil.which, BROWSERS)), "")
