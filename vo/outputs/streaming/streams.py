"""All outputs of a run that receive each pose as soon as it is known."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit

from vo.base.errors import OutputError
from vo.base.faults import Fault
from vo.base.types import Estimate
from vo.outputs.streaming.sink import PoseRecords, PoseSink, PoseUpdate, encoded

STANDARD_OUTPUT = "-"
_LOCAL_HOST = "127.0.0.1"
_FOXGLOVE_PORT = 8765


def open_address(address: str, allow_origins: Sequence[str] = ()) -> PoseSink:
    """Open an output.

    `address`: `-` for standard output, `udp://HOST:PORT` to send datagrams, `ws://HOST:PORT` to
    serve Foxglove, where the host is 127.0.0.1 and the port 8765 if they are left out, to
    `allow_origins` besides this machine and Foxglove.

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
        return FoxgloveServer(address, host or _LOCAL_HOST, port, allow_origins)
    if not host or not port:
        raise OutputError(f"{address}: host or port is missing; write udp://HOST:PORT")
    from vo.outputs.streaming.json_lines import UdpSender

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


_log = logging.getLogger(__name__)


class PoseStreams:
    """Sends each frame to several outputs; one that fails is left out from then on.

    `sinks`: any number of outputs.
    """

    def __init__(self, sinks: Sequence[PoseSink] = ()) -> None:
        self._sinks = list(sinks)
        self._stop: KeyboardInterrupt | None = None

    def begin(
        self, *, is_metric: bool, faults: Sequence[Fault] = (), is_live: bool = False
    ) -> None:
        """Before the first frame; the arguments are those of `PoseRecords` and `PoseUpdate`."""
        self._records = PoseRecords(is_metric=is_metric, faults=faults)
        self._is_live = is_live

    def send(self, estimate: Estimate, *, is_metric: bool = False) -> None:
        """Send one frame. Whatever happens, the run can finish the frame: see `check`.

        `is_metric`: whether an inertial sensor has given its lengths the metre.
        """
        if not self._sinks:
            return
        record = encoded(self._records.record(estimate, is_metric=is_metric))
        update = PoseUpdate(estimate, record, self._is_live)
        for sink in list(self._sinks):
            try:
                sink.send(update)
            except BrokenPipeError:
                self._sinks.remove(sink)
                self._stop = KeyboardInterrupt(signal.SIGPIPE)
            except KeyboardInterrupt as stop:  # while the reader let it wait
                self._sinks.remove(sink)  # perhaps in the middle of a line
                self._stop = stop
            except Exception as error:  # of any kind: the run goes on
                self._sinks.remove(sink)
                reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
                _log.warning("%s: no more poses are written: %s", sink.name, reason)

    def check(self) -> None:
        """End the run if the only reader of an output is gone.

        Raises:
            KeyboardInterrupt: with the number of SIGPIPE, or of the signal that came while an
                output waited for its reader.
        """
        if self._stop is not None:
            raise self._stop


@contextmanager
def opened_streams(
    targets: Sequence[str | PoseSink], allow_origins: Sequence[str] = ()
) -> Iterator[PoseStreams]:
    """Outputs to addresses (see `open_address`), or outputs of one's own; closed at the end.

    Raises:
        OutputError: an address is invalid, given twice, or cannot be used.
    """
    with ExitStack() as stack:
        sinks: list[PoseSink] = []
        for number, target in enumerate(targets):
            if target in targets[:number]:
                name = target if isinstance(target, str) else target.name
                raise OutputError(f"{name} is given twice for poses; leave one out")
            sink = open_address(target, allow_origins) if isinstance(target, str) else target
            stack.callback(sink.close)
            sinks.append(sink)
        yield PoseStreams(sinks)
