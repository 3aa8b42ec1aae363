"""The recording that `vo calibrate` reads, the search for the board in it, and files to write."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import OutputError
from vo.base.printable import counted

if TYPE_CHECKING:
    from rich.console import Console

    from vo.cli.calibrate_options import Request
    from vo.recordings.sources.sequence import ImageSequence


def check_outputs(inputs: list[Path], output: Path, picture: Path | None) -> None:
    """Check the output paths before minutes of work."""
    from vo.outputs.results.output_paths import refuse_to_overwrite

    refuse_to_overwrite(inputs, [output, picture])
    for path in (output, picture):
        if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
            raise OutputError(f"{path} cannot be written; give a file in an existing folder")
    if picture is not None:
        from vo.tools.drawing import check_plot

        check_plot(picture, "picture")


@contextmanager
def search_progress(console: Console, total: int) -> Iterator[Callable[[int, int], None]]:
    """A callback with the numbers of frames searched and of views."""
    from vo.cli.progress import counting

    with counting(console, "searching for the board", total) as step:
        yield lambda done, found: step(counted(found, "view"), done)


def open_recording(path: Path, request: Request) -> ImageSequence:
    """The recording of the board, without a calibration."""
    from vo.recordings.sources.uncalibrated import open_uncalibrated

    reading = request.reading
    keywords = {name: value for name, value in reading.keywords.items() if name != "calibration"}
    return open_uncalibrated(path, side_by_side=reading.side_by_side, **keywords)
