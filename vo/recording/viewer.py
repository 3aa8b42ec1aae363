"""The rerun viewer as a program: where it is, whether one answers, starting one."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import quote, urlsplit

from vo.errors import OutputError

DEFAULT_PORT = 9876
_LOCALHOST = "127.0.0.1"
_ANSWER_TIMEOUT_S = 3.0
_START_TIMEOUT_S = 20.0
# Source: RFC 9113, sec. 3.4: the preface and empty settings, which every gRPC server answers.
_HTTP2_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
_SCHEMES = ("rerun", "rerun+http", "rerun+https")


def viewer_url(where: str) -> str:
    """The whole URL of what people type: a URL, `host:port`, a host or a port.

    Raises:
        OutputError: it is none of these.
    """
    text = where if "://" in where else f"rerun+http://{_with_host(where)}"
    parts = urlsplit(text)
    try:
        port = parts.port or DEFAULT_PORT
    except ValueError:
        port = 0
    if parts.scheme not in _SCHEMES or not parts.hostname or not port:
        raise OutputError(
            f"{where!r} is no address of a viewer; give HOST:PORT or "
            f"rerun+http://{_LOCALHOST}:{DEFAULT_PORT}/proxy"
        )
    return f"{parts.scheme}://{parts.hostname}:{port}/proxy"


def check_viewer(url: str) -> None:
    """Make sure that something answers: rerun itself would wait, and drop what is logged.

    Raises:
        OutputError: nothing does.
    """
    parts = urlsplit(url)
    host, port = parts.hostname or _LOCALHOST, parts.port or DEFAULT_PORT
    try:
        with socket.create_connection((host, port), timeout=_ANSWER_TIMEOUT_S) as connection:
            connection.sendall(_HTTP2_GREETING)
            if not connection.recv(1):
                raise ConnectionError("it hangs up")
    except OSError as error:
        raise OutputError(
            f"no viewer answers at {host}:{port} ({error.strerror or str(error)}); start one there "
            "with `rerun`, or let --spawn or --serve do it"
        ) from error


class ViewerProcess:
    """A viewer that was started here.

    Attributes:
        url: where data can be streamed to.
        page: address for the browser; None of a native viewer.
    """

    def __init__(self, process: subprocess.Popen[bytes], port: int, page: str | None) -> None:
        self._process = process
        self.url = f"rerun+http://{_LOCALHOST}:{port}/proxy"
        self.page = page

    def wait(self) -> None:
        """Until it is closed.

        Raises:
            OutputError: it ended by itself, and not well.
        """
        status = self._process.wait()
        if status:
            raise OutputError(f"the viewer ended with status {status}; use --serve or --web")

    def stop(self) -> None:
        """Close it."""
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def start_native(file: Path | None = None) -> ViewerProcess:
    """Open the native viewer on a port of its own, showing a file if one is given.

    It is not a part of this process: it stays when `vo` ends.

    Raises:
        OutputError: it does not start, most often because there is no display.
    """
    problem, advice = "a viewer cannot be opened here", "use --serve or --web"
    if sys.platform == "linux" and not any(map(os.environ.get, _DISPLAYS)):
        raise OutputError(f"{problem}: no display, {' and '.join(_DISPLAYS)} are not set; {advice}")
    port = _free_port()
    shown = "--expect-data-soon" if file is None else str(file)
    arguments = [shown, "--port", str(port), "--bind", _LOCALHOST, "--hide-welcome-screen"]
    process = _start(arguments, (port,), problem, advice)
    return ViewerProcess(process, port, None)


def start_web(*, port: int = 0, bind: str = _LOCALHOST) -> ViewerProcess:
    """Serve the web viewer, showing what will be streamed to it.

    Args:
        port: of the web page; 0 takes a free one.
        bind: address to listen on; other machines reach `0.0.0.0` only.

    Raises:
        OutputError: it cannot be served.
    """
    web, data = port or _free_port(), _free_port()
    ports = ["--web-viewer-port", str(web), "--port", str(data), "--bind", bind]
    arguments = ["--serve-web", *ports, "--hide-welcome-screen"]
    process = _start(arguments, (web, data), "the viewer cannot be served", "try another --port")
    page = f"http://{host_of(bind)}:{web}/"
    proxy = f"rerun+http://{host_of(bind)}:{data}/proxy"
    return ViewerProcess(process, data, f"{page}?url={quote(proxy, safe='')}")


def host_of(bind: str) -> str:
    """The name under which an address that is listened on can be reached."""
    return socket.gethostname() if bind in ("0.0.0.0", "::") else bind


def _start(
    arguments: list[str], ports: tuple[int, ...], problem: str, advice: str
) -> subprocess.Popen[bytes]:
    with tempfile.TemporaryFile() as said:
        try:
            process = subprocess.Popen(
                [_program(), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
                env={**os.environ, "RUST_LOG": "warn"},
                start_new_session=True,  # Ctrl-C is for the one who started it
            )
        except OSError as error:
            raise OutputError(f"{problem}: {error.strerror or error}; {advice}") from error
        if _listens(process, ports):
            return process
        process.kill()
        process.wait()
        said.seek(0)
        raise OutputError(f"{problem}: {_last_words(said.read())}; {advice}")


def _listens(process: subprocess.Popen[bytes], ports: tuple[int, ...]) -> bool:
    """Wait until every port answers, and the program has not ended at once."""
    give_up = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < give_up and process.poll() is None:
        if all(_answers(port) for port in ports):
            time.sleep(0.5)  # without a display it listens first and ends then
            return process.poll() is None
        time.sleep(0.1)
    return False


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((_LOCALHOST, port)) == 0


def _last_words(said: bytes) -> str:
    lines = [line.strip() for line in said.decode(errors="replace").splitlines() if line.strip()]
    if not lines:
        return "it ended without a word"
    reason = lines[-1].rpartition(": ")[2]  # where in the code it happened comes before
    return " ".join(reason.split()).rstrip(".")[:200]


def _program() -> str:
    """The viewer itself: the command `rerun` is a wrapper, which would not pass signals on."""
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    if sys.platform == "darwin" and (folder / "Rerun.app").exists():
        return str(folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun")
    return str(folder / "rerun")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_LOCALHOST, 0))
        port: int = probe.getsockname()[1]
    return port


def _with_host(where: str) -> str:
    return f"{_LOCALHOST}:{where}" if where.isdigit() else where
