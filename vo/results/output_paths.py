"""Checks that output files replace neither inputs nor each other."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from vo.errors import OutputError
from vo.results.folder import PARTIAL_FILES, RESULTS


def refuse_to_overwrite(
    inputs: Iterable[Path | None], outputs: Iterable[Path | None], results: Path | None = None
) -> None:
    """Protect the inputs of a run from its outputs.

    Args:
        inputs: recording, calibration; None and missing files are ignored.
        outputs: files to write; None is ignored.
        results: folder of results; if it is inside a recording, its files are not protected.

    Raises:
        OutputError: an output is an input, or a file anywhere in a recording that is a folder.
    """
    read = [Path(os.path.realpath(path)) for path in inputs if path is not None and path.exists()]
    own = None if results is None else Path(os.path.realpath(results))
    for target in outputs:
        if target is None or not target.exists():
            continue
        place = Path(os.path.realpath(target))
        if own in place.parents and own not in read:
            continue
        if any(path.samefile(target) or path in place.parents for path in read):
            raise OutputError(f"{target} is an input and would be replaced; choose another file")


def refuse_to_collide(folder: Path, outputs: Iterable[Path | None]) -> None:
    """Check that the outputs of a run differ from its results and from each other.

    Args:
        folder: folder of the results.
        outputs: other files to write; None is ignored.

    Raises:
        OutputError: two of them are the same file.
    """
    taken = {Path(os.path.realpath(folder / name)) for name in (*RESULTS, *PARTIAL_FILES)}
    for target in (path for path in outputs if path is not None):
        place = Path(os.path.realpath(target))  # also through a loop of links
        if place in taken:
            raise OutputError(f"{target} is already an output of this run; choose another file")
        taken.add(place)
