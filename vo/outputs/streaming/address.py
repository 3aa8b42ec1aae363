"""Addresses of outputs for poses: `-`, `udp://HOST:PORT` and `ws://HOST:PORT`."""

from __future__ import annotations

import sys
from urllib.parse import urlsplit

from vo.base.errors import OutputError
from vo.outputs.streaming.sink import PoseSink

STANDARD_OUTPUT = "-"
_LOCAL_HOST = "127.0.0.1"
_FOXGLOVE_PORT = 8765


def open_address(address: str) -> PoseSink:
    """Open an output.

    `address`: `-` for standard output, `udp://HOST:PORT` to send datagrams, `ws://HOST:PORT` to
    serve Foxglove, where the host is 127.0.0.1 and the port 8765 if they are left out.

    Raises:
        OutputError: it is not such an address, or cannot be used.
    """
    if address == STANDARD_OUTPUT:
        return _standard_output()
    scheme, host, port = _parts(address)
    if scheme == "ws":
        # protobuf takes long to import
        from vo.outputs.streaming.foxglove_server import FoxgloveServer

        port = _FOXGLOVE_PORT if port is None else port
        return FoxgloveServer(address, host or _LOCAL_HOST, port)
    if not host or not port:
        raise OutputError(f"{address}: host or port is missing; write udp://HOST:PORT")
    from vo.outputs.streaming.udp import UdpSender

    return UdpSender(address, host, port)


def _standard_output() -> PoseSink:
    from vo.outputs.streaming.json_lines import JsonLines

    if sys.stdout is None or sys.stdout.closed:
        raise OutputError("standard output is closed, so poses cannot be written there")
    sys.stdout.flush()
    return JsonLines(getattr(sys.stdout.buffer, "raw", sys.stdout.buffer))


def _parts(address: str) -> tuple[str, str, int | None]:
    """Scheme, host and port; the last two may be empty and None."""
    expected = "write -, udp://HOST:PORT or ws://HOST:PORT"
    try:
        parts = urlsplit(address)
        scheme, host, port = parts.scheme, parts.hostname or "", parts.port
    except ValueError as error:
        raise OutputError(f"{address} is no address for poses ({error}); {expected}") from error
    if scheme not in ("udp", "ws") or not parts.netloc + parts.path == parts.netloc:
        raise OutputError(f"{address} is no address for poses; {expected}")
    if "@" in parts.netloc or parts.query or parts.fragment:
        raise OutputError(f"{address} is more than an address for poses; {expected}")
    return scheme, host, port
