"""Small servers of live images, over RTSP and over HTTP, for tests and `scripts/live`.

The RTSP server sends JPEG images as RTP packets (RFC 2435) over the connection of RTSP itself (RFC
2326, interleaved), the HTTP server sends them as parts of one endless answer, as cameras do.
"""

from __future__ import annotations

import itertools
import socket
import struct
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import IO, NamedTuple, TypeVar

import cv2
import numpy as np

_CLOCK_HZ = 90_000  # of RTP time stamps of video
_PAYLOAD_TYPE = 26  # JPEG
_MAX_PAYLOAD = 8000
_TABLES_IN_BAND = 255  # value of Q
_DQT, _SOS, _EOI = 0xDB, 0xDA, b"\xff\xd9"

_Item = TypeVar("_Item")


class Scan(NamedTuple):
    """The parts of a baseline JPEG that RTP transmits."""

    width: int
    height: int
    tables: bytes
    data: bytes


def encode(image: np.ndarray) -> bytes:
    """An image as JPEG of the kind that RTP can carry: 4:2:0, with the standard Huffman tables."""
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    settings = [cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_OPTIMIZE, 0]
    done, data = cv2.imencode(".jpg", colour, settings)
    assert done
    return data.tobytes()


def scan_of(jpeg: bytes) -> Scan:
    """Take a JPEG apart."""
    tables, position, size = b"", 2, (0, 0)
    while True:
        marker, length = (
            jpeg[position + 1],
            int.from_bytes(jpeg[position + 2 : position + 4], "big"),
        )
        content = jpeg[position + 4 : position + 2 + length]
        position += 2 + length
        if marker == _DQT:
            tables += b"".join(content[i + 1 : i + 65] for i in range(0, len(content), 65))
        elif marker == 0xC0:
            size = struct.unpack(">HH", content[1:5])
        elif marker == _SOS:
            return Scan(size[1], size[0], tables, jpeg[position:].removesuffix(_EOI))


def rtp_packets(scan: Scan, number: Iterator[int], time_90khz: int) -> Iterator[bytes]:
    """The RTP packets of one image (RFC 2435, section 3)."""
    for offset in range(0, len(scan.data), _MAX_PAYLOAD):
        part = scan.data[offset : offset + _MAX_PAYLOAD]
        is_last = offset + _MAX_PAYLOAD >= len(scan.data)
        rtp = struct.pack(
            ">BBHII",
            0x80,
            _PAYLOAD_TYPE | 0x80 * is_last,
            next(number) & 0xFFFF,
            time_90khz & 0xFFFFFFFF,
            0x1234,
        )
        sizes = (1, _TABLES_IN_BAND, scan.width // 8, scan.height // 8)
        header = struct.pack(">I", offset) + bytes(sizes)
        if offset == 0:
            header += struct.pack(">BBH", 0, 0, len(scan.tables)) + scan.tables
        yield rtp + header + part


class LiveServer:
    """Serves images in a loop; each connection begins with the first of them.

    `sent`: images sent so far, over all connections. `scheme`: `rtsp` or `http`. `images`: (H, W)
    or (H, W, 3) uint8, H and W multiples of 16. `rate_hz`: images per second. `end`: number of
    images after which a connection is closed; None for no end.
    """

    def __init__(
        self, scheme: str, images: Iterable[np.ndarray], rate_hz: float, end: int | None = None
    ) -> None:
        self.sent = 0
        self.is_paused = False
        self._jpegs = [encode(image) for image in images]
        self._scans = [scan_of(jpeg) for jpeg in self._jpegs] if scheme == "rtsp" else []
        self._rate_hz, self._end = rate_hz, end
        self._serve = self._serve_rtsp if scheme == "rtsp" else self._serve_http
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._connections: list[socket.socket] = []
        self.port = self._listener.getsockname()[1]
        self.url = f"{scheme}://127.0.0.1:{self.port}/camera"
        self._has_stopped = False
        threading.Thread(target=self._accept, daemon=True).start()

    def cut_connections(self) -> None:
        """Close all connections at once, as a camera that loses its power."""
        connections, self._connections = self._connections, []
        for connection in connections:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def stop(self) -> None:
        """End; nobody can connect anymore."""
        self._has_stopped = True
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.cut_connections()

    def _accept(self) -> None:
        while not self._has_stopped:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._connections.append(connection)
            threading.Thread(target=self._handle, args=(connection,), daemon=True).start()

    def _handle(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            self._serve(connection)

    def _serve_rtsp(self, connection: socket.socket) -> None:
        lines = connection.makefile("rb")
        while True:
            request = _request(lines)
            if not request:
                return
            method, number = request[0].split()[0], _field(request, "cseq")
            connection.sendall(self._answer(method, number))
            if method == "TEARDOWN":
                return
            if method == "PLAY":
                break
        # What the client sends from now on, such as GET_PARAMETER, needs no answer.
        packet = itertools.count()
        for image, scan in self._in_time(self._scans):
            time_90khz = round(image * _CLOCK_HZ / self._rate_hz)
            for data in rtp_packets(scan, packet, time_90khz):
                connection.sendall(b"$\0" + struct.pack(">H", len(data)) + data)

    def _answer(self, method: str, number: str) -> bytes:
        headers = {"CSeq": number, "Session": "1"}
        body = ""
        if method == "OPTIONS":
            headers["Public"] = "OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN"
        if method == "SETUP":
            headers["Transport"] = "RTP/AVP/TCP;unicast;interleaved=0-1"
        if method == "DESCRIBE":
            body = (
                "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\n"
                f"m=video 0 RTP/AVP {_PAYLOAD_TYPE}\r\na=control:{self.url}/video\r\n"
            )
            headers |= {"Content-Type": "application/sdp", "Content-Length": str(len(body))}
        lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        return f"RTSP/1.0 200 OK\r\n{lines}\r\n{body}".encode()

    def _serve_http(self, connection: socket.socket) -> None:
        _request(connection.makefile("rb"))
        connection.sendall(
            b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=image\r\n\r\n"
        )
        for _, jpeg in self._in_time(self._jpegs):
            head = f"--image\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            connection.sendall(head.encode() + jpeg + b"\r\n")

    def _in_time(self, items: Sequence[_Item]) -> Iterator[tuple[int, _Item]]:
        """The items in a loop, each at its time, with a running number."""
        begun = time.monotonic()
        for number in itertools.count() if self._end is None else range(self._end):
            time.sleep(max(begun + number / self._rate_hz - time.monotonic(), 0.0))
            while self.is_paused and not self._has_stopped:
                time.sleep(0.01)
            if self._has_stopped:
                return
            yield number, items[number % len(items)]
            self.sent += 1


@contextmanager
def served(
    scheme: str, images: Iterable[np.ndarray], rate_hz: float, end: int | None = None
) -> Iterator[LiveServer]:
    """A `LiveServer` for the length of a block."""
    server = LiveServer(scheme, images, rate_hz, end)
    try:
        yield server
    finally:
        server.stop()


def _request(lines: IO[bytes]) -> list[str]:
    """The lines of a request; empty at the end of the connection."""
    request: list[str] = []
    while line := lines.readline().decode("latin-1").strip():
        request.append(line)
    return request


def _field(request: Sequence[str], name: str) -> str:
    found = [line for line in request if line.lower().startswith(f"{name}:")]
    return found[0].partition(":")[2].strip() if found else ""
