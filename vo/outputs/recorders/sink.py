"""Sinks of a recording: a file or a running viewer; a failure of one does not affect the other."""

from __future__ import annotations

import atexit
import ctypes
import logging
import os
import struct
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from vo.base.errors import OutputError
from vo.outputs.recorders.viewer import check_viewer

_BLOCK = 1 << 20  # bytes
# Layout of an .rrd file: a header, then messages: their kind, their length, their content.
_MAGIC, _HEADER_BYTES = b"RRF2", 12
_MESSAGE = struct.Struct("<QQ")


class PipedFile:
    """Copies data from a pipe to a file in a separate thread.

    After a failure it continues to read, and discards the data; the file ends with a whole message.

    `pipe_path`: path for rerun to write to. `error`: of writing, None without one.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
        read_end, self._write_end = os.pipe()
        self.pipe_path = Path(f"/dev/fd/{self._write_end}")
        self.error: OSError | None = None
        self._thread = threading.Thread(
            target=self._copy, args=(read_end,), name="rrd-file", daemon=True
        )
        self._thread.start()

    def close_pipe(self) -> None:
        """Close the pipe here, once rerun has opened it; the file ends when rerun closes it."""
        os.close(self._write_end)

    def wait(self, timeout_s: float) -> None:
        """Wait until all is written."""
        self._thread.join(timeout_s)

    def _copy(self, read_end: int) -> None:
        with open(read_end, "rb", buffering=0) as pipe, self._file:
            while data := pipe.read(_BLOCK):
                self._write(data)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while len(rest) and self.error is None:
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.error = error
                with suppress(OSError):
                    self._file.truncate(end_of_messages(self._file.fileno()))


def end_of_messages(file: int) -> int:
    """Position after the last complete message of an open `.rrd` file."""
    size = os.fstat(file).st_size
    if os.pread(file, len(_MAGIC), 0) != _MAGIC:
        return size
    position = _HEADER_BYTES
    while len(header := os.pread(file, _MESSAGE.size, position)) == _MESSAGE.size:
        end = position + _MESSAGE.size + _MESSAGE.unpack(header)[1]
        if end > size:
            break
        position = end
    return min(position, size)


_APPLICATION = "vo"
_FILE_TIMEOUT_S, _VIEWER_TIMEOUT_S = 3600.0, 2.0  # a slow disk is waited for
_open: list[
    rr.RecordingStream
] = []  # kept: the destructor of a stream may wait for its viewer forever

_log = logging.getLogger(__name__)


class Sink:
    """A stream to a file or a viewer; a failure ends the stream with a warning, not the run."""

    def __init__(self, name: str, stream: rr.RecordingStream, file: PipedFile | None) -> None:
        self._name = name
        self._stream = stream
        self._file = file
        self._timeout_s = _VIEWER_TIMEOUT_S if file is None else _FILE_TIMEOUT_S
        self._is_open = True

    def log_static(self, entity: str, archetype: Any) -> None:
        """Log data that are valid at all times."""
        self._try(lambda: self._stream.log(entity, archetype, static=True, strict=True))

    def send(self, entity: str, times: Sequence[Any], columns: Sequence[Any]) -> None:
        """Log rows."""
        self._try(lambda: self._stream.send_columns(entity, times, columns, strict=True))

    def flush(self) -> None:
        """Wait until all is written; detects a full disk."""
        self._try(lambda: self._stream.flush(timeout_sec=self._timeout_s))

    def close(self) -> None:
        """Write the remaining data and the footer."""
        self.flush()
        if self._file is not None:
            self._stream.disconnect()  # returns after a failure, too: the pipe is emptied
            self._file.wait(_FILE_TIMEOUT_S)
            self._try(lambda: None)
            _open.remove(self._stream)
        elif self._is_open:
            self._try(self._stream.disconnect)
            _open.remove(self._stream)

    def _try(self, action: Callable[[], None]) -> None:
        if not self._is_open:
            return
        try:
            action()
            if self._file is not None and self._file.error is not None:
                raise self._file.error
        except (RuntimeError, OSError) as error:
            reason = getattr(error, "strerror", None) or error
            _log.warning("recording to %s stopped: %s", self._name, reason)
            self._is_open = False


def open_file(path: Path, title: str, blueprint: rrb.Blueprint) -> Sink:
    """Open a new file; an existing one is replaced.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = PipedFile(path)
        stream = _new_stream()
        stream.save(file.pipe_path, default_blueprint=blueprint)
    except (RuntimeError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"cannot write the recording {path}: {reason}; choose another file"
        ) from error
    file.close_pipe()
    stream.send_recording_name(title)
    return Sink(str(path), stream, file)


def open_viewer(url: str, title: str, blueprint: rrb.Blueprint) -> Sink:
    """Connect to a running viewer.

    Raises:
        OutputError: no viewer answers there.
    """
    check_viewer(url)
    stream = _new_stream()
    stream.connect_grpc(url, default_blueprint=blueprint)
    stream.send_recording_name(title)
    return Sink(url, stream, None)


def _new_stream() -> rr.RecordingStream:
    """A stream that cannot prevent the program from ending."""
    stream = rr.RecordingStream(_APPLICATION)
    _open.append(stream)
    atexit.unregister(rr.rerun_shutdown)
    atexit.unregister(_shut_down)
    atexit.register(_shut_down)
    return stream


def _shut_down() -> None:
    """Shut rerun down at the end of the program, unless that would wait forever."""
    for stream in _open:
        ctypes.pythonapi.Py_IncRef(
            ctypes.py_object(stream.inner)
        )  # never freed: freeing waits, too
    if not _open:
        rr.rerun_shutdown()
