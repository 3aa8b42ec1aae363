"""Where a run is shown while it goes on: a viewer that is there, or one that is opened for it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import typer


@contextlib.contextmanager
def live_viewer(connect: str | None, *, spawn: bool, serve: bool) -> Iterator[str | None]:
    """URL of the viewer to stream to, or None; a served one stays until Ctrl-C.

    Raises:
        OutputError: there is no such viewer, or it cannot be started.
    """
    if sum((connect is not None, spawn, serve)) > 1:
        raise typer.BadParameter("give one of --connect, --spawn and --serve")
    if connect is None and not spawn and not serve:
        yield None
        return
    from vo.recording.viewer import check_viewer, start_native, start_web, viewer_url

    if connect is not None:
        url = viewer_url(connect)
        check_viewer(url)
        yield url
    elif spawn:
        yield start_native().url
    else:
        viewer = start_web()
        try:
            typer.echo(f"to be seen at {viewer.page}", err=True)
            yield viewer.url
            typer.echo(f"still to be seen at {viewer.page}; Ctrl-C ends it", err=True)
            with contextlib.suppress(KeyboardInterrupt):
                viewer.wait()
        finally:
            viewer.stop()
