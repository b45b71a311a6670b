"""Live page: a local server whose page reloads when its content changes."""

from __future__ import annotations

import html
import socket
import threading
from collections import deque
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from dualarm_cli.page.page import POLICY

HOST = "127.0.0.1"
"""Address that the server listens on, reachable from this machine only."""
MAX_CONNECTIONS, IDLE_TIMEOUT = 50, 10.0
"""Maximum number of open connections, and their time limit without data [s]."""
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

    def __init__(self, port: int = 0) -> None:
        """Start the server.

        Args:
            port: 0 for any that is free.

        Raises:
            OSError: the port is taken.
        """
        self._content, self._version = b"", 0
        self._server = _Server((HOST, port), self._handler())
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

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
                # A foreign host name that resolves to this machine (DNS rebinding) gets no answer.
                host = self.headers.get("Host", "").partition(":")[0]
                contents = {"/": live._content, "/version": str(live._version).encode()}
                content = contents.get(self.path)
                if host not in (HOST, "localhost") or content is None:
                    self.send_error(404)
                    return
                self.send_response(200)
                kind = "text/html" if self.path == "/" else "text/plain"
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                """Log nothing: the terminal belongs to the plan."""

        return Handler
