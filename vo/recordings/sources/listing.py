"""Lists of images with their stamps, from folders, tables, and names of files."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterable, Sequence
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.recordings.formats.headings import split_fields
from vo.recordings.formats.stamp_units import (
    NAMES,
    StampText,
    StampUnit,
    median_interval,
    parse_stamps,
)
from vo.recordings.formats.table import table_text
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.images import ImageFile, StoredImage

_log = logging.getLogger(__name__)
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp")
_MAX_CAMERAS = 32
_MISSING = "is missing; it should contain the stamps"
_TIME_IN_NAME = re.compile(r"(\d{10}[_,-]\d{1,9}|\d+(?:\.\d+)?(?:e\+?\d+)?)\D*$")
_DATE_IN_NAME = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)[T_ -]+(\d\d)[:_-]?(\d\d)[:_-]?(\d\d)"
    r"(?:[.,](\d{1,9})|[_-](\d{3}|\d{6}|\d{9}))\D*$"
)
_SPACED_DATE = re.compile(r"^(\d{4}-\d\d-\d\d) (?=\d\d:\d\d:\d\d)", re.MULTILINE)
_SECONDS_AND_REST = re.compile(r"(\d{10})[_,-](\d+)")
_SPLIT_STAMP = re.compile(r"\d{10} \d{1,9}")
_MAX_BACK, _MAX_BACK_RATIO = 3, 0.02  # of counters in names
_MIN_STAMP = 1_000_000_000  # smaller integers are counters, not times


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
    table = _SPACED_DATE.sub(r"\1T", table_text(path, _MISSING))
    texts = [text.strip() for text in table.splitlines()]
    numbered = [(n, text) for n, text in enumerate(texts, start=1) if text and text[0] != "#"]
    if numbered and _is_heading(numbered[0][1]):
        numbered = numbered[1:]
    if not numbered:
        raise SourceError(f"{path} has no data; it must have one line per image")
    name = str(path)
    return [Line(f"{name}:{n}", text) for n, text in numbered]


def _is_heading(text: str) -> bool:
    has_columns = len(split_fields(text)) > 1
    return text.lower().startswith("timestamp") or (has_columns and not re.search(r"\d", text))


def list_images(folder: Path) -> list[Path]:
    """The images of a folder in natural order of their names (frame2 before frame10)."""
    if not folder.is_dir():
        raise SourceError(f"folder {folder} does not exist; it should contain the images")
    with os.scandir(folder) as entries:
        paths = [folder / e.name for e in entries if is_image_name(e.name) and _is_file(e)]
    if not paths:
        raise SourceError(f"folder {folder} has no images ({' '.join(IMAGE_SUFFIXES)})")
    return sorted(paths, key=natural_key)


def _is_file(entry: os.DirEntry[str]) -> bool:
    """Whether it is a file, or a link to one; asks for the status of links alone."""
    return entry.is_file(follow_symlinks=False) or Path(entry).is_file()


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
        parts = text.split(separator) if separator else text.split(None, 1)
        fields = [part.strip() for part in parts[:2]]
        if is_image_name(fields[0]):
            fields.reverse()
        if len(fields) != 2 or not fields[1]:
            raise SourceError(f"{location}: '{text}' is not a stamp and a file name")
        file, name = folder / fields[1], fields[1]
        is_plain = name == os.path.basename(name) != ".."
        files.append(file if is_plain else inside(table.parent, file, location))
        texts.append(StampText(location, fields[0]))
    shots = make_shots(parse_stamps(texts, unit, faults), files, [each.location for each in texts])
    check_existing(files, table)
    return shots


def make_shots(stamps: Iterable[int], files: Iterable[Path], places: Iterable[str]) -> list[Shot]:
    """Images of files with increasing stamps, and where these were read."""
    rows = zip(stamps, files, places, strict=True)
    shots = [Shot(stamp, ImageFile(file), place) for stamp, file, place in rows]
    _check_order_of_names(sorted(shots, key=lambda shot: shot.stamp_ns))
    check_increasing(shots)
    return shots


def _check_order_of_names(shots: Sequence[Shot]) -> None:
    """Refuse stamps that were given to images in the alphabetical order 1, 10, 2 of their names.

    Names that count, in any other order, are doubtful, but a counter may begin again, go down, or
    a few images be late.
    """
    stems = [os.path.splitext(os.path.basename(shot.image.name))[0] for shot in shots]
    if len(set(map(len, stems))) == 1 and stems == sorted(stems):
        return
    words = {re.sub(r"\d+", "#", stem) for stem in stems}
    if len(words) != 1 or words.pop().count("#") != 1:  # several numbers are a time, or parts
        return
    numbers = [int("".join(filter(str.isdigit, stem))) for stem in stems]
    back = [i for i in range(1, len(numbers)) if numbers[i] < numbers[i - 1]]
    is_dense = max(numbers) - min(numbers) < 2 * len(numbers)
    if not back or len(back) == len(numbers) - 1 or not is_dense:
        return
    before, after = stems[back[0] - 1], stems[back[0]]
    message = (
        f"{shots[back[0]].location}: {before} is before {after}: the numbers in the names go back "
        f"{len(back)} times while the stamps increase"
    )
    advice = "give each image the stamp of its exposure"
    if stems == sorted(stems):
        raise SourceError(
            f"{message}: they were given in the alphabetical order of the names; {advice}"
        )
    if len(back) > max(_MAX_BACK, _MAX_BACK_RATIO * len(shots)):
        _log.warning(
            "%s, as if they had been given in another order; %s",
            message,
            advice,
            extra=warning_kind("stamps"),
        )


def check_existing(files: Sequence[Path], table: Path) -> None:
    """Refuse a table if none of its files exists."""
    if not any(file.is_file() for file in files):
        raise SourceError(
            f"none of the {len(files)} images listed in {table} exists; the first is {files[0]}"
        )


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
    return int(median_interval(stamps_ns))


def shots_from_names(
    images: Sequence[Path], stems: Sequence[str] | None = None
) -> list[Shot] | None:
    """Read stamps from file names, or `stems`, that contain a time last; None if they do not.

    Dates have decimals, and numbers with decimals are seconds. Whole numbers from 10^9 are
    nanoseconds, microseconds, milliseconds or seconds: the first unit with a median interval from
    2 ms to 20 s.
    """
    stems = stems or [path.stem for path in images]
    dates = [_DATE_IN_NAME.search(stem) for stem in stems]
    found = [_TIME_IN_NAME.search(stem) for stem in stems]
    texts = [_SECONDS_AND_REST.sub(r"\1.\2", each[1]) for each in found if each is not None]
    if len(images) < 2 or len(texts) < len(images):
        return None
    if all(dates):
        texts, is_seconds = [_date(each) for each in dates if each is not None], True
    else:
        numbers = [Decimal(text) for text in texts]
        is_seconds = any(number != number.to_integral_value() for number in numbers)
        if min(numbers) < _MIN_STAMP and not any("." in text for text in texts):
            return None
    stamps = [StampText(f"file {f}", text) for f, text in zip(images, texts, strict=True)]
    try:
        stamps_ns = parse_stamps(stamps, "s" if is_seconds else "ns", spacing=NAMES)
    except SourceError:
        return None
    if not NAMES.least_ns <= median_interval_ns(stamps_ns) <= NAMES.most_ns:
        return None
    pairs = sorted(zip(stamps_ns, images, strict=True), key=lambda pair: pair[0])
    files = [file for _, file in pairs]
    return make_shots([stamp for stamp, _ in pairs], files, [f"file {file}" for file in files])


def _date(found: re.Match[str]) -> str:
    year, month, day, hour, minute, second, after_point, after_mark = found.groups()
    return f"{year}-{month}-{day}T{hour}:{minute}:{second}.{after_point or after_mark}"


def shots_from_times(
    times: Path, images: Sequence[Path], faults: list[Fault] | None = None
) -> list[Shot]:
    """Assign stamps in seconds, or integer nanoseconds, to images.

    A line has a stamp; or whole seconds and nanoseconds; or a stamp and a file name, in any order;
    or the name or number of an image, a stamp and, optionally, an exposure time, as in data sets
    for photometric calibration (TUM monoVO, TUM VI). With names or numbers, lines without an image
    are not used.
    """
    lines = read_lines(times)
    rows = [text.replace(",", " ").split() for _, text in lines]
    stems = {image.stem for image in images}
    if all(_SPLIT_STAMP.fullmatch(" ".join(row[:2])) and row[0] not in stems for row in rows):
        rows = [[f"{row[0]}.{row[1]:0>9}", *row[2:]] for row in rows]
    stamp, name = _columns(rows[0], images)
    for line, row in zip(lines, rows, strict=True):
        if len(row) <= max(stamp, name or 0):
            raise SourceError(f"{line.location}: '{line.text}' has fewer columns than the first")
    texts = [StampText(line.location, row[stamp]) for line, row in zip(lines, rows, strict=True)]
    keys = None if name is None else [row[name] for row in rows]
    stamps = parse_stamps(texts, "s", faults)
    numbers = _lines_of_images(times, lines, images, keys)
    places = [lines[number].location for number in numbers]
    return make_shots([stamps[number] for number in numbers], images, places)


def _columns(row: Sequence[str], images: Sequence[Path]) -> tuple[int, int | None]:
    """Columns of the stamp and of the image's name; None without one."""
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


def camera_folders(root: Path, pattern: str) -> list[Path]:
    """Folders of the cameras 0, 1 and so on up to the last one that exists, such as `cam{}`."""
    count = max((n for n in range(_MAX_CAMERAS) if (root / pattern.format(n)).is_dir()), default=0)
    return [root / pattern.format(number) for number in range(count + 1)]
