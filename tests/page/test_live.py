"""`dualarm plan --watch`: a change of a file gives a new page, a mistake is shown with its line."""

from __future__ import annotations

import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.page.live import HOST, MAX_CONNECTIONS, LivePage
from dualarm_cli.page.page import page_html

PATIENCE = 60.0
"""How long a plan of three moves may take on a busy machine [s]."""


@pytest.fixture
def live() -> Iterator[LivePage]:
    page = LivePage()
    yield page
    page.close()


def fetched(address: str) -> str:
    with urllib.request.urlopen(address, timeout=10) as answer:
        return str(answer.read().decode())


def test_each_page_has_a_version_of_its_own(live: LivePage, built: Path) -> None:
    """A browser reloads when the version is another one; the page may ask nobody else."""
    live.show(page_html({"title": "first"}))
    first = fetched(live.address)
    version = fetched(f"{live.address}version")
    assert f'shown = "{version}"' in first
    assert "connect-src 'self'" in first
    live.show(page_html({"title": "second"}))
    assert fetched(f"{live.address}version") != version
    assert "<title>second</title>" in fetched(live.address)


def test_what_is_wrong_is_shown_as_text(live: LivePage) -> None:
    live.show_text("No plan", "tasks.yaml:3:5: <script>alert(1)</script>", "hint")
    shown = fetched(live.address)
    assert "tasks.yaml:3:5: &lt;script&gt;alert(1)&lt;/script&gt;" in shown


def test_idle_connections_are_closed_and_keep_nobody_waiting(
    live: LivePage, capfd: pytest.CaptureFixture[str]
) -> None:
    """Three hundred that say nothing: the oldest are closed, few threads wait, the page comes, nothing is printed."""
    live.show(b"<body>shown</body>")
    port = int(live.address.rstrip("/").rpartition(":")[2])
    before = threading.active_count()
    idle = [socket.create_connection((HOST, port), timeout=10) for _ in range(300)]
    try:
        assert "shown" in fetched(live.address)
        assert idle[0].recv(1) == b""
        until = time.monotonic() + 10.0
        while threading.active_count() > before + MAX_CONNECTIONS and time.monotonic() < until:
            time.sleep(0.01)
        assert threading.active_count() <= before + MAX_CONNECTIONS
    finally:
        for connection in idle:
            connection.close()
    assert "shown" in fetched(live.address)
    assert capfd.readouterr() == ("", "")


def test_planning_is_for_readers_with_the_token() -> None:
    """Without token, with another host name, or with too much or no JSON nothing is planned."""
    asked: list[object] = []

    def replan(document: object) -> dict[str, object]:
        asked.append(document)
        return {"cycle_time": 2.5}

    live = LivePage(replan=replan)
    port, query = int(live.address.rstrip("/").rpartition(":")[2]), live.link.partition("/?")[2]

    def posted(path: str, body: bytes, **headers: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(HOST, port, timeout=10)
        connection.request("POST", path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()

    try:
        body = b'{"levers": []}'
        for path, headers, sent, status in (
            ("/replan", {}, body, 403),
            ("/replan?token=guess", {}, body, 403),
            (f"/replan?{query}", {"Host": "elsewhere.example"}, body, 404),
            (f"/other?{query}", {}, body, 404),
            (f"/replan?{query}", {}, b"no JSON", 400),
            (f"/replan?{query}", {}, b" " * 30_000, 413),
        ):
            assert posted(path, sent, **headers)[0] == status
        assert asked == []
        assert posted(f"/replan?{query}", body) == (200, b'{"cycle_time": 2.5}')
        assert asked == [{"levers": []}]
        live.show(b"<body>shown</body>")
        assert "shown" in fetched(live.link)
    finally:
        live.close()


def test_only_this_machine_by_its_own_name_is_answered(live: LivePage) -> None:
    """Another name that leads here, and any other path, get nothing."""
    live.show(b"<body></body>")
    port = int(live.address.rstrip("/").rpartition(":")[2])
    for host, path, status in (
        (f"{HOST}:{port}", "/", 200),
        ("localhost", "/version", 200),
        ("elsewhere.example", "/", 404),
        (HOST, "/../etc/passwd", 404),
    ):
        connection = http.client.HTTPConnection(HOST, port, timeout=10)
        connection.putrequest("GET", path, skip_host=True)
        connection.putheader("Host", host)
        connection.endheaders()
        assert connection.getresponse().status == status
        connection.close()


TASKS = """\
dualarm: tasks/1
cell: cell.yaml
tasks:
  - {id: NAME, arm: left, move: {xyz: [80 mm, 100 mm, 0], rpy: [180 deg, 0, 0], free: yaw}}
"""
START = """\
import sys
from pathlib import Path
import dualarm_cli.page.page as page
folder = Path(sys.argv.pop(1))
page.built_folder = lambda: folder
from dualarm_cli.__main__ import main
main()
"""


def test_a_change_is_planned_and_a_mistake_is_shown(tmp_path: Path, built: Path) -> None:
    """A task is renamed, then the file is broken, then Ctrl-C."""
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: bottin_planar\n")
    tasks = tmp_path / "tasks.yaml"
    tasks.write_text(TASKS.replace("NAME", "one"))
    (tmp_path / "start.py").write_text(START)
    command = [sys.executable, "start.py", str(built), "plan", "tasks.yaml", "--watch", "--quiet"]
    folders = os.pathsep.join(filter(None, sys.path))
    process = subprocess.Popen(
        [*command, "--effort", "quick", "--out", "p"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": folders},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        told = process.stderr.readline()
        address = re.findall(r"http://\S+/", told)[0] if "http" in told else told
        until(lambda: '"one"' in page_of(address))
        tasks.write_text(TASKS.replace("NAME", "two"))
        until(lambda: '"two"' in page_of(address))
        tasks.write_text(TASKS.replace("id: NAME", "idd: three"))
        until(lambda: "tasks.yaml:4:6" in page_of(address))
        tasks.write_text(TASKS.replace("NAME", "four"))
        until(lambda: '"four"' in page_of(address))
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 0


def page_of(address: str) -> str:
    try:
        return fetched(address)
    except (urllib.error.URLError, ConnectionError):
        return ""


def until(holds: Callable[[], bool]) -> None:
    """Waits until something holds."""
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.2)


@pytest.mark.parametrize("option", ["--json", "--no-page", "--out=-"])
def test_options_that_show_no_page_do_not_go_with_it(
    option: str, built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["plan", "01_first_pick", "--watch", option]) == 2
    assert "--watch" in capsys.readouterr().err
