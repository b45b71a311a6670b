"""Live page: a local server whose page reloads when its content changes."""

from __future__ import annotations

import html
import json
import secrets
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from dualarm_cli.page.page import POLICY

HOST = "127.0.0.1"
"""Address that the server listens on, reachable from this machine only."""
MAX_CONNECTIONS, IDLE_TIMEOUT = 50, 10.0
"""Maximum number of open connections, and their time limit without data [s]."""
MAX_BODY = 20_000
"""Maximum size of a request to plan [B]."""
Replan = Callable[[Any], dict[str, Any]]
"""Function that plans a job with levers, from a JSON document to the answer."""
_RELOAD = """<script>
(() => {
  const shown = "VERSION", key = "dualarm.time";
  const later = Number(sessionStorage.getItem(key));
  const begin = () => {
    if (!window.dualarm || !window.dualarm.ready) return setTimeout(begin, 100);
    if (later > 0) {
      window.dualarm.pause();
      window.dualarm.setTime(later);
    }
  };
  if (document.getElementById("data")) begin();
  setInterval(async () => {
    const answer = await fetch("/version").catch(() => null);
    if (!answer || await answer.text() === shown) return;
    if (window.dualarm) sessionStorage.setItem(key, String(window.dualarm.time));
    location.reload();
  }, 500);
})();
</script>
</body>"""
"""Script that polls twice a second, and keeps the cursor's time.

It polls for a newer version.
"""
_ERROR = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif }}
body {{ margin: 3rem auto; max-width: 60rem; padding: 0 1rem }}
pre {{ white-space: pre-wrap; padding: 1rem; border: 1px solid; border-left: 6px solid #c0392b }}
</style>
</head>
<body>
<h1>{title}</h1>
<pre>{text}</pre>
<p>{hint}</p>
</body>
</html>
"""


class _Server(ThreadingHTTPServer):
    """HTTP server that silent connections cannot block."""

    daemon_threads = True
    request_queue_size = 128
    """Maximum number of connections that wait to be accepted."""

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        """Start listening."""
        self._open: deque[socket.socket] = deque()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection, and close the oldest beyond MAX_CONNECTIONS."""
        self._open.append(request)
        while len(self._open) > MAX_CONNECTIONS:
            with suppress(OSError):
                self._open.popleft().shutdown(socket.SHUT_RDWR)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close an answered connection."""
        with suppress(ValueError):
            self._open.remove(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore broken connections: the terminal belongs to the plan."""


class LivePage:
    """Current page and the server that shows it."""

    def __init__(self, port: int = 0, replan: Replan | None = None) -> None:
        """Start the server.

        Args:
            port: 0 for any that is free.
            replan: plans with levers for readers who have the token; None refuses that.

        Raises:
            OSError: the port is taken.
        """
        self._content, self._version = b"", 0
        self._replan, self._token = replan, secrets.token_urlsafe(16)
        self._server = _Server((HOST, port), self._handler())
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    @property
    def link(self) -> str:
        """URL of the page with the token that permits planning."""
        return f"{self.address}?token={self._token}"

    def show(self, page: bytes) -> None:
        """Show a page (`page_html`); browsers with an older one reload."""
        self._version += 1
        policy = POLICY.replace("default-src 'none';", "default-src 'none'; connect-src 'self';")
        text = page.decode("utf-8").replace(POLICY, policy, 1)
        body, _, _ = text.rpartition("</body>")
        reload = _RELOAD.replace("VERSION", str(self._version))
        self._content = f"{body}{reload}\n</html>\n".encode()

    def show_text(self, title: str, text: str, hint: str) -> None:
        """Show a text instead of a plan, such as a file's error."""
        words = {"title": title, "text": text, "hint": hint}
        safe = {name: html.escape(word) for name, word in words.items()}
        self.show(_ERROR.format(policy=POLICY, **safe).encode())

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        live = self

        class Handler(BaseHTTPRequestHandler):
            """Request handler for the page and its version."""

            timeout = IDLE_TIMEOUT

            def do_GET(self) -> None:
                contents = {"/": live._content, "/version": str(live._version).encode()}
                path = urlsplit(self.path).path
                content = contents.get(path)
                if not self._is_named() or content is None:
                    self.send_error(404)
                    return
                self._answer(content, "text/html" if path == "/" else "text/plain")

            def do_POST(self) -> None:
                url = urlsplit(self.path)
                if not self._is_named() or url.path != "/replan" or live._replan is None:
                    self.send_error(404)
                    return
                token = parse_qs(url.query).get("token", [""])[0]
                if not secrets.compare_digest(token.encode(), live._token.encode()):
                    self.send_error(403)
                    return
                length = self.headers.get("Content-Length", "")
                if not length.isdecimal() or int(length) > MAX_BODY:
                    self.send_error(413)
                    return
                try:
                    document = json.loads(self.rfile.read(int(length)))
                except ValueError:
                    self.send_error(400)
                    return
                self._answer(json.dumps(live._replan(document)).encode(), "application/json")

            def _is_named(self) -> bool:
                """Check the host: a foreign name of this machine (DNS rebinding) gets no answer."""
                return self.headers.get("Host", "").partition(":")[0] in (HOST, "localhost")

            def _answer(self, content: bytes, kind: str) -> None:
                self.send_response(200)
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                """Log nothing: the terminal belongs to the plan."""

        return Handler
