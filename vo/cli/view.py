"""`vo view`: look at a recording."""

from __future__ import annotations

import contextlib
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vo.recording.viewer import ViewerProcess

_MAGIC = b"RRF"  # what every .rrd file begins with
_LOCALHOST = "127.0.0.1"


def view_command(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="Folder of a run that was recorded with --rrd, or an .rrd file."
        ),
    ],
    web: Annotated[
        bool, typer.Option("--web", help="Serve it for a browser instead of opening a window.")
    ] = False,
    port: Annotated[
        int,
        typer.Option(
            min=0,
            max=65535,
            metavar="PORT",
            help="Where to serve the page.",
            show_default="a free one",
        ),
    ] = 0,
    bind: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Address to serve on; 0.0.0.0 lets other machines see it."
        ),
    ] = _LOCALHOST,
) -> None:
    """Look at a run in the rerun viewer.

    Record a run, and look at it:

      vo run my_sequence/ -o out/ --rrd out/run.rrd
      vo view out/

    On a machine without a screen, serve it and open the printed address
    in a browser (over ssh: forward both ports that are named):

      vo view out/ --web

    Exit status: 0 done, 1 error, 2 wrong use.
    """
    from vo.recording.viewer import start_native

    file = find_recording(recording)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the viewer must end with us
    if web:
        _serve(file, port, bind)
    else:
        _wait(start_native(file))


def _serve(file: Path, port: int, bind: str) -> None:
    from vo.recording.file_server import NAME, FileServer
    from vo.recording.viewer import host_of, start_web

    with FileServer(file, bind) as server:
        viewer = start_web(port=port, bind=bind)
        page, _, _ = str(viewer.page).partition("?")
        data = f"http://{host_of(bind)}:{server.port}/{NAME}"
        typer.echo(f"{file} is at {page}?url={data}")
        typer.echo(f"the data come from port {server.port}; Ctrl-C ends both")
        _wait(viewer)


def _wait(viewer: ViewerProcess) -> None:
    try:
        with contextlib.suppress(KeyboardInterrupt):
            viewer.wait()
    finally:
        viewer.stop()


def find_recording(path: Path) -> Path:
    """The recording meant by a path: itself, or the newest one in a folder.

    Raises:
        SourceError: there is none, or it is not one.
    """
    from vo.errors import SourceError

    file = path
    if path.is_dir():
        found = sorted(path.glob("*.rrd"), key=lambda file: file.stat().st_mtime)
        if not found:
            raise SourceError(
                f"{path} holds no .rrd file; make one with vo run SOURCE -o {path} "
                f"--rrd {path / 'run.rrd'}"
            )
        file = found[-1]
    if not file.exists():
        raise SourceError(f"{file} does not exist; vo run … --rrd {file} would make it")
    try:
        with file.open("rb") as opened:
            begins = opened.read(len(_MAGIC))
    except OSError as error:
        raise SourceError(f"{file} cannot be read: {error.strerror}") from error
    if begins != _MAGIC:
        what = "is empty" if not begins else "is not an .rrd file"
        raise SourceError(f"{file} {what}; give a file that vo run wrote with --rrd")
    return file
