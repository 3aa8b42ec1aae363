"""Poses as lines of JSON in a file, a pipe or a terminal, and as UDP datagrams."""

from __future__ import annotations

import logging
import os
import select
import socket
from typing import IO

from vo.base.errors import OutputError
from vo.outputs.streaming.sink import PoseUpdate

_log = logging.getLogger(__name__)


class JsonLines:
    """Writes one line for each frame, at once.

    A reader that is too slow lets the run wait, so that it gets every pose. A live source does not
    wait: then poses are left out while the pipe is full.

    `file`: where to write; it stays open. `name`: what messages call it.
    """

    def __init__(self, file: IO[bytes], name: str = "standard output") -> None:
        self.name = name
        self._file = file
        self._left_out = 0

    def send(self, update: PoseUpdate) -> None:
        """Write a line.

        Raises:
            BrokenPipeError: the reader has closed the pipe.
            OSError: it cannot be written, as the disk is full.
        """
        # A pipe that can be written to takes at least 512 bytes, on Linux and macOS a whole line.
        if update.is_live and not self._is_writable(timeout_ms=0):
            self._leave_out()
            return
        rest = memoryview(update.record + b"\n")
        while rest:  # a file without a buffer may write a part only
            written = self._file.write(rest)
            if written is None:  # a full pipe that does not let its writer wait
                self._is_writable()
            else:
                rest = rest[written:]
        self._file.flush()

    def _is_writable(self, timeout_ms: int | None = None) -> bool:
        """Whether the file can be written to, after waiting for that."""
        try:
            number = self._file.fileno()
        except OSError:  # an object in memory
            return True
        poll = select.poll()
        poll.register(number, select.POLLOUT)
        return bool(poll.poll(timeout_ms))

    def _leave_out(self) -> None:
        self._left_out += 1
        if self._left_out == 1:
            _log.warning("%s: poses are left out, as they are read too slowly", self.name)

    def close(self) -> None:
        """Report how many poses were left out; every other line is written."""
        if self._left_out:
            _log.warning("%s: %d poses were left out", self.name, self._left_out)


class UdpSender:
    """Sends one datagram for each frame; those that do not arrive are counted, where known.

    `host`: name or address; IPv4 where it has both, as most programs listen there.

    Raises:
        OutputError: the host is unknown, or there is no route to it.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        self.name = name
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
            family, *_, where = min(found, key=lambda each: each[0] != socket.AF_INET)
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            # Only a connected socket is told that nothing listens on the other machine's port.
            self._socket.connect(where)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"{name}: {reason}; write udp://HOST:PORT for poses") from error
        self._sent = self._lost = 0

    def send(self, update: PoseUpdate) -> None:
        """Send a datagram; an error is no reason to stop."""
        self._sent += 1
        try:
            self._socket.send(update.record)
        except ConnectionRefusedError as error:  # of an earlier datagram; this one was not sent
            self._count(error)
            self._send_again(update.record)
        except OSError as error:
            self._count(error)

    def _send_again(self, record: bytes) -> None:
        try:
            self._socket.send(record)
        except OSError as error:
            self._count(error)

    def _count(self, error: OSError) -> None:
        self._lost += 1
        self._reason = error.strerror
        if self._lost == 1:
            _log.warning("%s: poses do not arrive (%s); the run goes on", self.name, self._reason)

    def close(self) -> None:
        """Close the socket, and report the number of lost datagrams."""
        number = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if number:  # of the last datagram
            self._count(OSError(number, os.strerror(number)))
        self._socket.close()
        if self._lost:
            counts = f"at least {self._lost} of {self._sent} poses did not arrive"
            _log.warning("%s: %s (%s)", self.name, counts, self._reason)
