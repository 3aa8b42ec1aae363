"""Lists of images with their stamps, from folders and tables."""

from __future__ import annotations

import os
import re
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.files.bounded_files import read_table_text
from vo.recordings.formats.stamp_units import StampText, StampUnit, parse_stamps
from vo.recordings.sources.images import ImageFile, StoredImage

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp")


class Line(NamedTuple):
    """A line of a text file, and its location (`FILE:NUMBER`) for messages."""

    location: str
    text: str


class Shot(NamedTuple):
    """One image of one camera.

    Attributes:
        stamp_ns: time of exposure, in nanoseconds.
        location: where the stamp was read, for messages.
    """

    stamp_ns: int
    image: StoredImage
    location: str


def read_lines(path: Path) -> list[Line]:
    """Read the data lines of a file, without blank lines, comments and a heading of columns."""
    texts = [text.strip() for text in _read_text(path).splitlines()]
    numbered = [(n, text) for n, text in enumerate(texts, start=1) if text and text[0] != "#"]
    name = str(path)
    return [Line(f"{name}:{n}", text) for n, text in numbered[_first(path, numbered) :]]


def read_data(path: Path) -> list[str]:
    """The same without the places of the lines, in a fifth of the time."""
    texts = [text for text in map(str.strip, _read_text(path).splitlines()) if text]
    data = [text for text in texts if text[0] != "#"]
    return data[_first(path, [(0, text) for text in data[:2]]) :]


def _read_text(path: Path) -> str:
    try:
        return read_table_text(path)
    except FileNotFoundError as error:
        raise SourceError(f"{path} is missing; it should contain the stamps") from error
    except UnicodeDecodeError as error:
        raise SourceError(f"{path} is not text") from error
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error


def _first(path: Path, lines: list[tuple[int, str]]) -> int:
    """Number of headings of columns before the data."""
    heading = int(bool(lines) and lines[0][1].lower().startswith("timestamp"))
    if len(lines) == heading:
        raise SourceError(f"{path} has no data; it must have one line per image")
    return heading


def list_images(folder: Path) -> list[Path]:
    """The images of a folder in natural order of their names (frame2 before frame10)."""
    if not folder.is_dir():
        raise SourceError(f"folder {folder} does not exist; it should contain the images")
    paths = [p for p in folder.iterdir() if is_image_name(p.name) and p.is_file()]
    if not paths:
        raise SourceError(f"folder {folder} has no images ({' '.join(IMAGE_SUFFIXES)})")
    return sorted(paths, key=natural_key)


def is_image_name(name: str) -> bool:
    """Whether a file name is that of an image; hidden files are excluded."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def natural_key(path: Path) -> list[tuple[int, str]]:
    """A sort key that compares numbers in names by value."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if i % 2 else (0, part) for i, part in enumerate(parts)]


def shots_from_table(
    table: Path,
    folder: Path,
    separator: str | None,
    unit: StampUnit,
    faults: list[Fault] | None = None,
) -> list[Shot]:
    """Read a table with a stamp and a file name per line.

    `folder`: folder that the file names are relative to.
    """
    texts, files = [], []
    for location, text in read_lines(table):
        fields = [field.strip() for field in text.split(separator, 1)]
        if len(fields) != 2 or not fields[1]:
            raise SourceError(f"{location}: '{text}' is not a stamp and a file name")
        files.append(inside(table.parent, folder / fields[1], location))
        texts.append(StampText(location, fields[0]))
    stamps = parse_stamps(texts, unit, faults)
    shots = [
        Shot(stamp, ImageFile(file), text.location)
        for stamp, file, text in zip(stamps, files, texts, strict=True)
    ]
    check_increasing(shots)
    if not any(file.is_file() for file in files):
        raise SourceError(
            f"none of the {len(shots)} images listed in {table} exists; the first is {files[0]}"
        )
    return shots


def inside(root: Path, file: Path, location: str) -> Path:
    """The file, unless its name leads out of a folder; images are copied into exports."""
    folder, absolute = os.path.abspath(root), os.path.abspath(file)
    if absolute != folder and not absolute.startswith(os.path.join(folder, "")):
        raise SourceError(
            f"{location}: {file} is outside of the recording; images are read from {root} only"
        )
    return file


def check_increasing(shots: Sequence[Shot]) -> None:
    """Check that stamps increase."""
    for before, after in zip(shots, shots[1:], strict=False):
        if after.stamp_ns <= before.stamp_ns:
            raise SourceError(
                f"{after.location}: stamp {after.stamp_ns} ns is not after {before.stamp_ns} ns "
                "of the previous image; sort the images by time and remove repeated ones"
            )


def median_interval_ns(stamps_ns: Sequence[int]) -> int:
    """Median interval between consecutive stamps; 0 for fewer than two."""
    ordered = sorted(stamps_ns)
    steps = [b - a for a, b in zip(ordered, ordered[1:], strict=False)]
    return int(statistics.median_low(steps)) if steps else 0
