"""Files of stamps beside images: one column, or with numbers, names or exposure times of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.recordings.formats.stamp_units import StampText, parse_stamps
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Line, Shot, check_increasing, is_image_name, read_lines

Columns = tuple[int, int | None]
"""Columns of the stamp and of the image's name; None without one."""


def shots_from_times(
    times: Path, images: Sequence[Path], faults: list[Fault] | None = None
) -> list[Shot]:
    """Assign stamps in seconds, or integer nanoseconds, to images.

    A line has a stamp; or a stamp and a file name, in any order; or the name or number of an image,
    a stamp and, optionally, an exposure time, as in data sets for photometric calibration (TUM
    monoVO, TUM VI). With names or numbers, lines without an image are not used.
    """
    lines = read_lines(times)
    rows = [text.replace(",", " ").split() for _, text in lines]
    stamp, name = _columns(rows[0], images)
    for line, row in zip(lines, rows, strict=True):
        if len(row) <= max(stamp, name or 0):
            raise SourceError(f"{line.location}: '{line.text}' has fewer columns than the first")
    texts = [StampText(line.location, row[stamp]) for line, row in zip(lines, rows, strict=True)]
    keys = None if name is None else [row[name] for row in rows]
    stamps = parse_stamps(texts, "s", faults)
    shots = [
        Shot(stamps[number], ImageFile(image), lines[number].location)
        for image, number in zip(images, _lines_of_images(times, lines, images, keys), strict=True)
    ]
    check_increasing(shots)
    return shots


def _columns(row: Sequence[str], images: Sequence[Path]) -> Columns:
    if len(row) == 1:
        return 0, None
    if is_image_name(row[1]):
        return 0, 1
    is_named = is_image_name(row[0]) or row[0] in {image.stem for image in images}
    if is_named or row[0].isdigit():
        return 1, 0
    return 0, None  # followed by the exposure time


def _lines_of_images(
    times: Path, lines: Sequence[Line], images: Sequence[Path], keys: Sequence[str] | None
) -> list[int]:
    """The number of the line of each image, by name, or else by order."""
    for key in (_as_written, _as_number):
        if keys is not None:
            numbers = {key(text): number for number, text in enumerate(keys)}
            found = [numbers.get(key(image.name)) for image in images]
            known = [number for number in found if number is not None]
            if len(known) == len(images):
                return known
    if len(lines) != len(images):
        raise SourceError(
            f"{images[0].parent} has {len(images)} images but {times} has {len(lines)} stamps; "
            "there must be one line per image"
        )
    return list(range(len(lines)))


def _as_written(name: str) -> str:
    """The name without folder and suffix; a stamp in a name keeps its decimals."""
    name = name.rpartition("/")[2]
    return Path(name).stem if is_image_name(name) else name


def _as_number(name: str) -> str:
    stem = _as_written(name)
    return stem.lstrip("0") or "0" if stem.isdigit() else stem
