"""Viewer to stream a run to: a running one, or one started for the run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import typer

from vo.cli.echo import echo


@contextlib.contextmanager
def live_viewer(connect: str | None, *, spawn: bool, serve: bool) -> Iterator[str | None]:
    """URL of the viewer to stream to, or None. A served page is kept open until Ctrl-C.

    Args:
        connect: HOST:PORT of a running viewer.
        spawn: open a viewer.
        serve: serve a web viewer.

    Raises:
        OutputError: there is no such viewer, or it cannot be started.
        typer.BadParameter: more than one viewer is given.
    """
    if sum((connect is not None, spawn, serve)) > 1:
        raise typer.BadParameter("use only one of --connect, --spawn and --serve")
    if connect is None and not spawn and not serve:
        yield None
        return
    from vo.outputs.recorders.viewer import check_viewer, start_native, start_web, viewer_url

    if connect is not None:
        url = viewer_url(connect)
        check_viewer(url)
        yield url
    elif spawn:
        yield start_native().url
    else:
        viewer = start_web()
        try:
            echo(f"viewer at {viewer.page}", err=True)
            yield viewer.url
            echo(f"viewer still at {viewer.page}; press Ctrl-C to end", err=True)
            with contextlib.suppress(KeyboardInterrupt):
                viewer.wait()
        finally:
            viewer.stop()
