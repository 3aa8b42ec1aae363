"""The rerun viewer as a process: its address, a check that it runs, and its start."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote, urlsplit

from vo.base.errors import OutputError
from vo.base.extras import require

DEFAULT_PORT = 9876
_LOCALHOST = "127.0.0.1"
_ANSWER_TIMEOUT_S = 3.0
_START_TIMEOUT_S = 20.0
# Source: RFC 9113, sec. 3.4: the connection preface and empty settings; every server answers.
_HTTP2_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
_SCHEMES = ("rerun", "rerun+http", "rerun+https")

# Becomes the program given after the parent's process id. Source: prctl(2), PR_SET_PDEATHSIG.
_ENDING_WITH_PARENT = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)
if os.getppid() == int(sys.argv[1]):  # otherwise the parent has ended already
    os.execv(sys.argv[2], sys.argv[2:])
"""


def viewer_url(address: str) -> str:
    """The complete URL of an address: a URL, `host:port`, a host or a port.

    Raises:
        OutputError: the address is none of these.
    """
    text = address if "://" in address else f"rerun+http://{_with_host(address)}"
    parts = urlsplit(text)
    try:
        port = parts.port or DEFAULT_PORT
    except ValueError:
        port = 0
    if parts.scheme not in _SCHEMES or not parts.hostname or not port:
        raise OutputError(
            f"{address!r} is not the address of a viewer; use HOST:PORT or "
            f"rerun+http://{_LOCALHOST}:{DEFAULT_PORT}/proxy"
        )
    return f"{parts.scheme}://{parts.hostname}:{port}/proxy"


def check_viewer(url: str) -> None:
    """Check that a viewer answers; rerun itself would wait, and drop the logged data.

    Raises:
        OutputError: no viewer answers.
    """
    parts = urlsplit(url)
    host, port = parts.hostname or _LOCALHOST, parts.port or DEFAULT_PORT
    try:
        with socket.create_connection((host, port), timeout=_ANSWER_TIMEOUT_S) as connection:
            connection.sendall(_HTTP2_GREETING)
            if not connection.recv(1):
                raise ConnectionError("connection closed")
    except OSError as error:
        raise OutputError(
            f"no viewer answers at {host}:{port} ({error.strerror or str(error)}); start one there "
            "with `rerun`, or use `spawn` or `serve`"
        ) from error


class ViewerProcess:
    """A viewer process started by this program.

    `url`: address to stream data to. `page`: address for a browser; None for a native viewer.
    """

    def __init__(
        self, process: subprocess.Popen[bytes], port: int, page: str | None, advice: str
    ) -> None:
        self._process, self._advice = process, advice
        self.url = f"rerun+http://{_LOCALHOST}:{port}/proxy"
        self.page = page

    def wait(self) -> None:
        """Wait until the viewer is closed.

        Raises:
            OutputError: it ended with an error.
        """
        status = self._process.wait()
        if status:
            raise OutputError(f"the viewer ended with status {status}; {self._advice}")

    def stop(self) -> None:
        """Close the viewer."""
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def start_native(file: Path | None = None) -> ViewerProcess:
    """Open the native viewer on a free port, with a file if one is given.

    It stays open when `vo` ends.

    Raises:
        OutputError: it does not start, usually because there is no display.
    """
    require("rerun_cli", "view", "viewers")
    problem, advice = (
        "a viewer cannot be opened here",
        f"use `{'serve' if file is None else 'web'}`",
    )
    if sys.platform == "linux" and not any(map(os.environ.get, _DISPLAYS)):
        raise OutputError(f"{problem}: no display, {' and '.join(_DISPLAYS)} are not set; {advice}")
    port = _free_port()
    shown = "--expect-data-soon" if file is None else str(file)
    arguments = [shown, "--port", str(port), "--bind", _LOCALHOST, "--hide-welcome-screen"]
    process = _start(arguments, (port,), problem, advice)
    return ViewerProcess(process, port, None, advice)


def start_web(*, port: int = 0, bind: str = _LOCALHOST) -> ViewerProcess:
    """Serve the web viewer, for data that are streamed to it.

    `port`: of the web page; 0 selects a free one. `bind`: address to listen on; `0.0.0.0` is
    reachable from other machines.

    Raises:
        OutputError: the server does not start.
    """
    web, data = port or _free_port(), _free_port()
    ports = ["--web-viewer-port", str(web), "--port", str(data), "--bind", bind]
    arguments = ["--serve-web", *ports, "--hide-welcome-screen"]
    problem, advice = "the viewer cannot be served", "try another `port`"
    process = _start(arguments, (web, data), problem, advice, starter=_ending_with_this_process())
    page = f"http://{host_of(bind)}:{web}/"
    proxy = f"rerun+http://{host_of(bind)}:{data}/proxy"
    return ViewerProcess(process, data, f"{page}?url={quote(proxy, safe='')}", advice)


def host_of(bind: str) -> str:
    """The host name under which an address to listen on can be reached."""
    return socket.gethostname() if bind in ("0.0.0.0", "::") else bind


def _ending_with_this_process() -> list[str]:
    """First part of a command that is killed with this process; empty where that is impossible.

    The kernel sends the signal when the calling thread ends, however it ends.
    """
    if sys.platform != "linux":
        return []
    return [sys.executable, "-I", "-S", "-c", _ENDING_WITH_PARENT, str(os.getpid())]


def _start(
    arguments: list[str],
    ports: tuple[int, ...],
    problem: str,
    advice: str,
    starter: Sequence[str] = (),
) -> subprocess.Popen[bytes]:
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                [*starter, _program(), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**os.environ, "RUST_LOG": "warn"},
                start_new_session=True,  # so that Ctrl-C does not reach it
            )
        except OSError as error:
            raise OutputError(f"{problem}: {error.strerror or error}; {advice}") from error
        if _listens(process, ports):
            return process
        process.kill()
        process.wait()
        output.seek(0)
        raise OutputError(f"{problem}: {_last_line(output.read())}; {advice}")


def _listens(process: subprocess.Popen[bytes], ports: tuple[int, ...]) -> bool:
    """Wait until every port answers; whether the program still runs then."""
    give_up = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < give_up and process.poll() is None:
        if all(_answers(port) for port in ports):
            time.sleep(0.5)  # without a display it first listens and then ends
            return process.poll() is None
        time.sleep(0.1)
    return False


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((_LOCALHOST, port)) == 0


def _last_line(output: bytes) -> str:
    lines = [line.strip() for line in output.decode(errors="replace").splitlines() if line.strip()]
    if not lines:
        return "it ended without output"
    reason = lines[-1].rpartition(": ")[2]  # without the place in the code
    return " ".join(reason.split()).rstrip(".")[:200]


def _program() -> str:
    """The executable of the viewer; the command `rerun` does not forward signals to it."""
    require("rerun_cli", "view", "viewers")
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


def _with_host(address: str) -> str:
    return f"{_LOCALHOST}:{address}" if address.isdigit() else address
