"""`vo view`: a recorded run in the rerun viewer."""

from __future__ import annotations

import contextlib
import shlex
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo, echo_json

if TYPE_CHECKING:
    from vo.outputs.recorders.viewer import ViewerProcess

_MAGIC = b"RRF"  # first bytes of every .rrd file
_LOCALHOST = "127.0.0.1"
_WEB = "Web page"


def view_command(
    recording: Path = argument(
        "Folder of a run recorded with --rrd, or an .rrd file.", metavar="RUN"
    ),
    *,
    web: bool = option("Serve a web page instead of opening a window.", "--web", default=False),
    port: int = option(
        "Port of the web page.",
        default=0,
        min=0,
        max=65535,
        metavar="PORT",
        show_default="a free one",
        panel=_WEB,
    ),
    bind: str = option(
        "Network address to serve on; 0.0.0.0 allows access from other machines.",
        default=_LOCALHOST,
        metavar="ADDRESS",
        panel=_WEB,
    ),
    printing: options.Printing,
) -> None:
    """Show a run in the rerun viewer.

    Record a run, and view it:

      vo run my_sequence/ -o out/ --rrd out/run.rrd
      vo view out/

    On a machine without a screen, serve a web page and open the printed
    address in a browser (over ssh, forward both printed ports):

      vo view out/ --web

    Exit status: 0 done, 1 error, 2 wrong usage.
    """
    from vo.outputs.recorders.viewer import start_native

    file = find_recording(recording)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # to stop the viewer, too
    if web:
        _serve(file, port, bind, printing)
        return
    viewer = start_native(file)
    if printing.json_output:
        echo_json({"recording": str(file)})
    _wait(viewer)


def _serve(file: Path, port: int, bind: str, printing: options.Printing) -> None:
    from urllib.parse import urlsplit

    from vo.outputs.recorders.file_server import FileServer
    from vo.outputs.recorders.viewer import host_of, start_web

    viewer = start_web(port=port, bind=bind)
    with contextlib.ExitStack() as stack:
        stack.callback(viewer.stop)
        page, _, _ = str(viewer.page).partition("?")
        server = stack.enter_context(FileServer(file, bind, urlsplit(page).port or 0))
        data = f"http://{host_of(bind)}:{server.port}{server.path}"
        with contextlib.suppress(KeyboardInterrupt):  # may come as soon as the address is shown
            print_address(printing, file, f"{page}?url={data}", server.port)
            _wait(viewer)


def print_address(printing: options.Printing, file: Path, address: str, port: int) -> None:
    """Print where a recording is served, with its data on a port."""
    record = {"recording": str(file), "address": address, "data_port": port}
    lines = f"{file} is at {address}\ndata on port {port}; press Ctrl-C to end"
    printing.show(lambda: record, lambda: echo(lines))


def _wait(viewer: ViewerProcess) -> None:
    try:
        with contextlib.suppress(KeyboardInterrupt):
            viewer.wait()
    finally:
        viewer.stop()


def find_recording(path: Path) -> Path:
    """The .rrd file at a path, or the newest one in a folder.

    Raises:
        SourceError: there is none, or it is not an .rrd file.
    """
    from vo.base.errors import SourceError

    file = path
    if path.is_dir():
        found = sorted(path.glob("*.rrd"), key=lambda file: file.stat().st_mtime)
        if not found:
            raise SourceError(
                f"{path} contains no .rrd file; record one: vo run RECORDING -o OUT "
                "--rrd OUT/run.rrd"
            )
        file = found[-1]
    if not file.exists():
        command = shlex.join(["vo", "run", "RECORDING", "-o", "OUT", "--rrd", str(file)])
        raise SourceError(f"{file} does not exist; record it: {command}")
    if not file.is_file():  # opening a pipe would wait
        raise SourceError(f"{file} is not a file; give a file written by vo run --rrd")
    try:
        with file.open("rb") as opened:
            first_bytes = opened.read(len(_MAGIC))
    except OSError as error:
        raise SourceError(f"{file} cannot be read: {error.strerror}") from error
    if first_bytes != _MAGIC:
        what = "is empty" if not first_bytes else "is not an .rrd file"
        raise SourceError(f"{file} {what}; give a file written by vo run --rrd")
    return file
