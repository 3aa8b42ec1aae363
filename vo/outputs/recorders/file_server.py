"""Serves one recording over HTTP to the web viewer, which downloads it as a whole.

Rerun's own file server uses one core permanently.

Any web page that is open in a browser can send requests to this machine. So the address contains a
random token, only pages of the viewer's server may read the answer (CORS), and requests that name
another host are refused: a page could have made its own name point to this machine (DNS rebinding).
"""

from __future__ import annotations

import ipaddress
import secrets
import shutil
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from urllib.parse import urlsplit

from vo.base.errors import OutputError

_NAME = "recording.rrd"
_EVERYWHERE = ("0.0.0.0", "::")


class FileServer:
    """Context manager that serves a file.

    `page_port`: port of the viewer's page, on the same host. `path`: path of the file in its
    address; it cannot be guessed.

    Raises:
        OutputError: the address cannot be used.
    """

    def __init__(self, file: Path, bind: str, page_port: int) -> None:
        self.path = f"/{secrets.token_urlsafe(16)}/{_NAME}"
        handler = _handler_of(file, self.path, bind, page_port)
        try:
            self._server = ThreadingHTTPServer((bind, 0), handler)
        except OSError as error:
            reason = error.strerror or error
            raise OutputError(f"cannot serve on {bind}: {reason}; try another `bind`") from error
        self._server.daemon_threads = True
        self.port: int = self._server.server_address[1]

    def __enter__(self) -> FileServer:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.shutdown()
        self._server.server_close()


def _is_this_host(host: str, bind: str) -> bool:
    """Whether a request names this machine in a way that no other page can make its own."""
    name = urlsplit(f"//{host}").hostname or ""
    if name in ("localhost", bind.lower()):
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return bind in _EVERYWHERE and name == socket.gethostname().lower()
    return address.is_loopback or bind in _EVERYWHERE


def _handler_of(
    file: Path, address: str, bind: str, page_port: int
) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            host = self.headers.get("Host", "")
            if not _is_this_host(host, bind):
                self.send_error(403)
                return
            if not secrets.compare_digest(self.path.encode(), address.encode()):
                self.send_error(404)
                return
            with file.open("rb") as opened:
                self.send_response(200)
                self.send_header("Content-Type", "application/octet-stream")
                self.send_header("Content-Length", str(file.stat().st_size))
                origin = self.headers.get("Origin", "")
                if self._is_page(origin):
                    self.send_header("Access-Control-Allow-Origin", origin)
                    self.send_header("Vary", "Origin")
                self.end_headers()
                shutil.copyfileobj(opened, self.wfile)

        def _is_page(self, origin: str) -> bool:
            """Whether a request comes from the viewer's page."""
            try:
                parts = urlsplit(origin)
                is_page = parts.scheme == "http" and parts.port == page_port
            except ValueError:
                return False
            return is_page and _is_this_host(parts.netloc, bind)

        def log_message(self, format: str, *args: object) -> None:
            """Suppress the log, which would go to the terminal."""

        def handle(self) -> None:
            try:
                super().handle()
            except ConnectionError:
                return  # the page was closed during the download

    return Handler
