"""Lists of images with their stamps, from folders and tables."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from vo.errors import SourceError
from vo.formats.trajectory import stamp_ns_from_seconds
from vo.sources.images import ImageFile, StoredImage

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp")

LARGEST_NS = 2**63 - 1


class Line(NamedTuple):
    """A line of a text file and where it stands, for messages."""

    place: str
    text: str


class Shot(NamedTuple):
    """One image of one camera.

    Attributes:
        stamp_ns: when it was taken, in nanoseconds.
        image: where it is and how it is read.
        place: where the stamp was read, for messages.
    """

    stamp_ns: int
    image: StoredImage
    place: str


def read_lines(path: Path) -> list[Line]:
    """The lines that hold data: no blank ones, no comments, no heading that names a timestamp.

    Raises:
        SourceError: the file is missing, not text, or holds no data.
    """
    try:
        texts = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise SourceError(f"{path} is missing; it gives the images their stamps") from error
    except UnicodeDecodeError as error:
        raise SourceError(f"{path} is not text") from error
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
    numbered = ((number, text.strip()) for number, text in enumerate(texts, start=1))
    lines = [Line(f"{path}:{n}", text) for n, text in numbered if text and text[0] != "#"]
    if lines and lines[0].text.lower().startswith("timestamp"):
        lines = lines[1:]
    if not lines:
        raise SourceError(f"{path} holds no data; it must have a line per image")
    return lines


def list_images(folder: Path) -> list[Path]:
    """The images of a folder by natural order of their names (frame2 before frame10).

    Raises:
        SourceError: the folder is missing or holds no image.
    """
    if not folder.is_dir():
        raise SourceError(f"folder {folder} does not exist; images are looked for there")
    paths = [p for p in folder.iterdir() if is_image_name(p.name) and p.is_file()]
    if not paths:
        raise SourceError(f"folder {folder} holds no images ({' '.join(IMAGE_SUFFIXES)})")
    return sorted(paths, key=natural_key)


def is_image_name(name: str) -> bool:
    """Whether a file of that name should hold an image; hidden files should not."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def natural_key(path: Path) -> list[tuple[int, str]]:
    """A key that sorts names with their numbers by value."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if i % 2 else (0, part) for i, part in enumerate(parts)]


def shots_from_table(
    table: Path, folder: Path, separator: str | None, stamp_ns: Callable[[str], int]
) -> list[Shot]:
    """Read lines of a stamp and a file name.

    Args:
        table: the text file.
        folder: what the file names are relative to.
        separator: what stands between stamp and name; None for white space.
        stamp_ns: reads a stamp; raises ValueError where it cannot.

    Raises:
        SourceError: a line cannot be read, time does not go on, or none of the files exists.
    """
    shots, files = [], []
    for place, text in read_lines(table):
        fields = [field.strip() for field in text.split(separator, 1)]
        if len(fields) != 2 or not fields[1]:
            raise SourceError(f"{place}: '{text}' is not a stamp and a file name")
        files.append(folder / fields[1])
        shots.append(Shot(_parse(place, fields[0], stamp_ns), ImageFile(files[-1]), place))
    check_increasing(shots)
    if not any(file.is_file() for file in files):
        raise SourceError(
            f"none of the {len(shots)} images named in {table} exists; the first would be "
            f"{files[0]}"
        )
    return shots


def shots_from_times(times: Path, images: Sequence[Path]) -> list[Shot]:
    """Give each image the stamp of its line: seconds, or nanoseconds if written without a point.

    Raises:
        SourceError: the counts differ, a line cannot be read, or time does not go on.
    """
    stamps = [(_parse(place, text, _seconds_or_ns), place) for place, text in read_lines(times)]
    if len(stamps) != len(images):
        raise SourceError(
            f"{images[0].parent} has {len(images)} images but {times} has {len(stamps)} stamps; "
            "there must be one line per image"
        )
    pairs = zip(stamps, images, strict=True)
    shots = [Shot(stamp_ns, ImageFile(image), place) for (stamp_ns, place), image in pairs]
    check_increasing(shots)
    return shots


def whole_ns(text: str) -> int:
    """A stamp in whole nanoseconds.

    Raises:
        ValueError: the text is something else.
    """
    if not text.isascii() or not text.isdigit():
        raise ValueError(f"'{text}' is not a whole number of nanoseconds")
    return int(text)


def check_increasing(shots: Sequence[Shot]) -> None:
    """Refuse stamps that stand still or go back.

    Raises:
        SourceError: naming the first two.
    """
    for before, after in zip(shots, shots[1:], strict=False):
        if after.stamp_ns <= before.stamp_ns:
            raise SourceError(
                f"{after.place}: stamp {after.stamp_ns} ns does not come after "
                f"{before.stamp_ns} ns of the image before; sort the images by time and remove "
                "repeated ones"
            )


def _parse(place: str, text: str, stamp_ns: Callable[[str], int]) -> int:
    try:
        stamp = stamp_ns(text)
    except ValueError as error:
        raise SourceError(f"{place}: stamp {error}") from error
    if abs(stamp) > LARGEST_NS:
        raise SourceError(f"{place}: stamp {text} is too large for a time")
    return stamp


def _seconds_or_ns(text: str) -> int:
    # Twelve digits of seconds would be 3,000 years and more.
    return int(text) if text.isdigit() and len(text) >= 12 else stamp_ns_from_seconds(text)


def median_interval_ns(stamps_ns: Sequence[int]) -> int:
    """The median time between neighbours in time; 0 where there are fewer than two."""
    ordered = sorted(stamps_ns)
    steps = [b - a for a, b in zip(ordered, ordered[1:], strict=False)]
    return int(statistics.median_low(steps)) if steps else 0
