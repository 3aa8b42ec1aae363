"""Where a recording goes: a file, or a viewer that is running; each may fail on its own."""

from __future__ import annotations

import atexit
import ctypes
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from vo.errors import OutputError
from vo.recording.growing_rrd import GrowingRrd
from vo.recording.viewer import check_viewer

_APPLICATION = "vo"
_FILE_TIMEOUT_S, _VIEWER_TIMEOUT_S = 20.0, 2.0
_open: list[rr.RecordingStream] = []  # kept: one that is dropped waits for its viewer for ever

_log = logging.getLogger(__name__)


class Outlet:
    """A stream to a file or a viewer; what fails ends it with a warning, never the run."""

    def __init__(self, name: str, stream: rr.RecordingStream, file: GrowingRrd | None) -> None:
        self._name = name
        self._stream = stream
        self._file = file
        self._timeout_s = _VIEWER_TIMEOUT_S if file is None else _FILE_TIMEOUT_S
        self._is_open = True

    def fix(self, entity: str, archetype: Any) -> None:
        """Log what holds at all times."""
        self._try(lambda: self._stream.log(entity, archetype, static=True, strict=True))

    def send(self, entity: str, times: Sequence[Any], columns: Sequence[Any]) -> None:
        """Log rows."""
        self._try(lambda: self._stream.send_columns(entity, times, columns, strict=True))

    def flush(self) -> None:
        """Wait until all is written; this is where a full disk shows."""
        self._try(lambda: self._stream.flush(timeout_sec=self._timeout_s))

    def close(self) -> None:
        """Write what is left, with the footer."""
        self.flush()
        if self._file is not None:
            self._stream.disconnect()  # returns also after a failure: the pipe is always emptied
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


def open_file(path: Path, title: str, blueprint: rrb.Blueprint) -> Outlet:
    """An outlet to a new file; one that exists is replaced.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = GrowingRrd(path)
        stream = _new_stream()
        stream.save(file.inlet, default_blueprint=blueprint)
    except (RuntimeError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"cannot write the recording {path}: {reason}; choose another file"
        ) from error
    file.opened()
    stream.send_recording_name(title)
    return Outlet(str(path), stream, file)


def open_viewer(url: str, title: str, blueprint: rrb.Blueprint) -> Outlet:
    """An outlet to a viewer that is running.

    Raises:
        OutputError: no viewer answers there.
    """
    check_viewer(url)
    stream = _new_stream()
    stream.connect_grpc(url, default_blueprint=blueprint)
    stream.send_recording_name(title)
    return Outlet(url, stream, None)


def _new_stream() -> rr.RecordingStream:
    """A stream that cannot keep the program from ending."""
    stream = rr.RecordingStream(_APPLICATION)
    _open.append(stream)
    atexit.unregister(rr.rerun_shutdown)
    atexit.unregister(_shut_down)
    atexit.register(_shut_down)
    return stream


def _shut_down() -> None:
    """What rerun does when a program ends, unless it would wait for ever."""
    for stream in _open:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(stream.inner))  # never freed: that waits too
    if not _open:
        rr.rerun_shutdown()
