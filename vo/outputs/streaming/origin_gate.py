"""A door before a websocket server, which lets no foreign web page in.

Any web page may connect to a server on this machine; browsers say by `Origin` whose it is.
"""

from __future__ import annotations

import logging
import re
import socket
import threading
from collections.abc import Sequence
from contextlib import closing, suppress
from urllib.parse import urlsplit

_OWN_HOSTS = ("localhost", "127.0.0.1", "::1")
_FOXGLOVE = ("https://app.foxglove.dev", "file://")
"""The program in the browser and on the desktop."""
_MAX_HEAD_BYTES = 1 << 14
_HEAD_TIMEOUT_S = 5.0
_PART_BYTES = 1 << 16
_REFUSAL = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
_ORIGIN = re.compile(rb"^origin[ \t]*:[ \t]*(.*?)[ \t\r]*$", re.IGNORECASE | re.MULTILINE)
_log = logging.getLogger(__name__)


class OriginGate:
    """Passes connections to a server, except those of web pages that are not allowed.

    `target`: address of the server. `allowed`: origins besides this machine's and Foxglove's; `*`
    for all.

    Raises:
        OSError: it cannot listen there.
    """

    def __init__(
        self, host: str, port: int, target: tuple[str, int], allowed: Sequence[str] = ()
    ) -> None:
        self._target = target
        self._allowed = {origin.lower().rstrip("/") for origin in (*_FOXGLOVE, *allowed)}
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._listener = socket.create_server(address[:2], family=family)
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Accept no more connections."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def allows(self, origin: str) -> bool:
        """Whether pages of an origin may connect."""
        if "*" in self._allowed or origin.lower().rstrip("/") in self._allowed:
            return True
        with suppress(ValueError):
            return urlsplit(origin).hostname in _OWN_HOSTS
        return False

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:  # closed
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with closing(client), suppress(OSError):
            client.settimeout(_HEAD_TIMEOUT_S)
            head = _request_head(client)
            origins = [found.decode("latin-1") for found in _ORIGIN.findall(head)]
            # Without an upgrade, a second request could follow on the same connection.
            if not all(map(self.allows, origins)) or b"upgrade: websocket" not in head.lower():
                if origins:
                    _log.warning(
                        "a web page of %s asked for the poses and was refused; `allow_origins` "
                        "lets it have them",
                        origins[0][:100],
                    )
                client.sendall(_REFUSAL)
                return
            client.settimeout(None)
            with closing(socket.create_connection(self._target)) as server:
                server.sendall(head)
                threading.Thread(target=_pass_on, args=(client, server), daemon=True).start()
                _pass_on(server, client)


def _request_head(client: socket.socket) -> bytes:
    """What the client sends up to the end of its headers."""
    head = b""
    while b"\r\n\r\n" not in head:
        part = client.recv(4096)
        if not part or len(head) > _MAX_HEAD_BYTES:
            raise OSError("no request")
        head += part
    return head


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    """Pass bytes on until either side ends."""
    with suppress(OSError):
        while part := source.recv(_PART_BYTES):
            sink.sendall(part)
    with suppress(OSError):
        sink.shutdown(socket.SHUT_RDWR)
