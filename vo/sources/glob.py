"""Images that a pattern names: `left/*.png`, `walk_?/frame*.jpg`, `**/*.tif`."""

from __future__ import annotations

import glob
from pathlib import Path

from vo.errors import SourceError
from vo.sources.assembly import Gathered, find_calibration
from vo.sources.folder import times_in, with_stamps
from vo.sources.listing import Shot, is_image_name, natural_key
from vo.sources.pairing import stamped_like
from vo.types import Mode


def gather_glob(pattern: Path, calibration: Path | None, mode: Mode) -> Gathered:
    """List the images that match, by natural order of their names.

    Where the pattern says `left`, images that match it with `right` in that place are those of the
    right camera. Stamps come from the names, or from a times.txt in the folder if it has a line for
    each image, or else are made up at 10 frames per second, with a warning.

    Raises:
        SourceError: no image matches, or two have the same stamp.
        CalibrationError: there is no calibration, or it is wrong.
    """
    images = _matching(str(pattern))
    if not images:
        raise SourceError(f"no image matches {pattern}; put the pattern in quotes, or check it")
    folder = images[0].parent
    left, _ = with_stamps(images, str(pattern), _times(folder, len(images)))
    return Gathered(
        name=folder.resolve().name,
        format="glob",
        left=left,
        right=_right(str(pattern), left),
        calibrate=find_calibration(
            calibration, [folder / "calibration.yaml", folder.parent / "calibration.yaml"]
        ),
        read_truth=lambda _: None,
    )


def _matching(pattern: str) -> list[Path]:
    found = (Path(name) for name in glob.glob(pattern, recursive=True))
    images = [path for path in found if is_image_name(path.name) and path.is_file()]
    return sorted(images, key=lambda path: (natural_key(path.parent), natural_key(path)))


def _times(folder: Path, count: int) -> Path | None:
    """A file with times, unless the pattern takes only some of its images."""
    times = times_in(folder, folder.parent)
    if times is None:
        return None
    lines = [text for text in times.read_text(errors="replace").splitlines() if text.strip()]
    return times if len([text for text in lines if text.lstrip()[0].isdigit()]) == count else None


def _right(pattern: str, left: list[Shot]) -> list[Shot] | None:
    before, word, after = pattern.rpartition("left")
    images = _matching(f"{before}right{after}") if word else []
    return stamped_like(left, images) if images else None
