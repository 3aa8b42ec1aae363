"""Serves one recording over HTTP to the web viewer, which downloads it as a whole.

Rerun's own file server uses one core permanently.
"""

from __future__ import annotations

import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType

from vo.errors import OutputError

NAME = "recording.rrd"


class FileServer:
    """Context manager that serves a file at `/recording.rrd`.

    Args:
        file: the recording.
        bind: address to listen on.

    Raises:
        OutputError: the address cannot be used.
    """

    def __init__(self, file: Path, bind: str) -> None:
        try:
            self._server = ThreadingHTTPServer((bind, 0), _handler_of(file))
        except OSError as error:
            reason = error.strerror or error
            raise OutputError(f"cannot serve on {bind}: {reason}; try another --bind") from error
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


def _handler_of(file: Path) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != f"/{NAME}":
                self.send_error(404)
                return
            with file.open("rb") as opened:
                self.send_response(200)
                self.send_header("Content-Type", "application/octet-stream")
                self.send_header("Content-Length", str(file.stat().st_size))
                self.send_header(
                    "Access-Control-Allow-Origin", "*"
                )  # the page has a different port
                self.end_headers()
                shutil.copyfileobj(opened, self.wfile)

        def log_message(self, format: str, *args: object) -> None:
            """Suppress the log, which would go to the terminal."""

        def handle(self) -> None:
            try:
                super().handle()
            except ConnectionError:
                return  # the page was closed during the download

    return Handler
