"""Images of several cameras in one folder, told apart by their names and what they contain."""

from __future__ import annotations

import fnmatch
import glob
import logging
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError
from vo.base.frozen import frozen
from vo.base.printable import counted
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.series_content import compare_series

_log = logging.getLogger(__name__)

_TOKENS = re.compile(r"\d+|[^\W\d_]+|[\W_]+")
_CAMERA = re.compile(
    r"cam|camera|c|image|img|view|infra|ir|sensor|eye|lens|channel|ch|stream", re.I
)
_DEPTH = re.compile(r"depth|depthmap|disp|disparity|d|z", re.I)
_BESIDE = re.compile(
    r"masks?|conf(?:idence)?|seg(?:mentation)?|semantics?|labels?|normals?|flow", re.I
)
_DATE = re.compile(r"\d{4}-?(?:0\d|1[0-2])-?[0-3]\d[T_ -]+[0-2]\d[-:_]?[0-5]\d")
_MAX_CAMERAS = 8
_MIN_IMAGES = 3  # of series whose names say nothing
_MIN_COMMON = 0.8  # ratio of numbers that both series have
_MIN_STAMP = 10**9
_MIN_OVERLAP = 0.5  # of times, ratio of the shorter series


class _Named(NamedTuple):
    """An image; the words and separators in its name, and the numbers between them."""

    path: Path
    words: tuple[str, ...]
    numbers: tuple[int, ...]
    stem: str


@frozen()
class Series:
    """Images of one camera, in their order.

    Attributes:
        words: those in its names that names of the other cameras lack.
        stems: the names, without the number of the camera.
        keys: the numbers in the names, those of images of the same moment being equal.
    """

    images: tuple[Path, ...]
    words: tuple[str, ...]
    stems: tuple[str, ...]
    keys: tuple[tuple[int, ...], ...]

    @property
    def side(self) -> str:
        """`left`, `right` or empty, as the names say."""
        for side in ("left", "right"):
            letter = side[0]
            for word in self.words:
                low = word.lower()
                if (
                    side in low
                    or low == letter
                    or (word[:-1].islower() and word[-1] == letter.upper())
                ):
                    return side
        return ""

    def is_named(self, words: re.Pattern[str]) -> bool:
        """Whether a word of its names is one of these."""
        return any(words.fullmatch(word) for word in self.words)

    @property
    def has_16_bits(self) -> bool:
        """Whether the first readable image is grey with 16 bits, as depth is stored."""
        for path in self.images:
            try:
                pixels = ImageFile(path).read(colour=True)
            except SourceError:
                continue
            return pixels.dtype == np.uint16 and pixels.ndim == 2
        return False


class Cameras(NamedTuple):
    """The series of a folder by their roles."""

    left: Series
    right: Series | None = None
    depth: Series | None = None


def find_cameras(images: Sequence[Path]) -> Cameras:
    """Tell images of several cameras apart.

    Raises:
        SourceError: there are several, and neither names nor contents say their roles.
    """
    found = _simultaneous(_split(images))
    if len(found) == 1:
        whole = next(iter(_series([_named(images)], None)))
        return Cameras(whole)
    used = [each for each in found if not each.is_named(_BESIDE)]
    for each in found:
        if each not in used:
            _log.warning("%s and %d more: not used", each.images[0], len(each.images) - 1)
    if len(used) == 1:
        return Cameras(used[0])
    if len(used) == 2:
        for one, other in (used, used[::-1]):
            if other.side == "right" and one.side != "right" and not one.is_named(_DEPTH):
                return Cameras(one, right=other)
        depth = [each for each in used if each.is_named(_DEPTH)] or used
        deep = [each for each in depth if each.has_16_bits]
        if len(deep) == 1:
            return Cameras(next(each for each in used if each is not deep[0]), depth=deep[0])
    raise SourceError(_which(used, images))


def _split(images: Sequence[Path]) -> list[Series]:
    """Series by the words in the names, or else by the number of the camera."""
    named = _named(images)
    groups: dict[tuple[str, ...], list[_Named]] = {}
    for each in named:
        groups.setdefault(each.words, []).append(each)
    if len(groups) > 1:
        return _series(groups.values(), None)
    if len({each.stem for each in named}) < len(named):  # of files with several suffixes
        suffixes = sorted({each.path.suffix for each in named})
        return _series([[e for e in named if e.path.suffix == suffix] for suffix in suffixes], None)
    words = named[0].words
    is_date = _DATE.search(named[0].stem) is not None
    for place in range(len(named[0].numbers)):
        values = {each.numbers[place] for each in named}
        if 2 <= len(values) <= _MAX_CAMERAS:  # such as serial numbers
            by_value = [[e for e in named if e.numbers[place] == value] for value in sorted(values)]
            found = _series(by_value, place)
            if _is_camera(words, place) or (not is_date and _are_alike(found, images)):
                return found
    return _series([named], None)


def _are_alike(series: Sequence[Series], images: Sequence[Path]) -> bool:
    """Whether series whose names don't say so are of several cameras, as the images show.

    Raises:
        SourceError: the images don't show it either.
    """
    lengths = [len(each.images) for each in series]
    if min(lengths) < max(_MIN_IMAGES, _MIN_COMMON * max(lengths)):
        return False
    if not _is_beside(series[1], series[0]):
        return False
    seen = compare_series(series[0].images, series[1].images)
    if seen is None:
        raise SourceError(
            f"{_which(series, images)}; if all images are of one camera, add times.txt with the "
            "time of each in seconds, a line per image"
        )
    return seen


def _is_camera(words: tuple[str, ...], place: int) -> bool:
    """Whether a number, counted in a name, follows a word for a camera, perhaps after a mark."""
    at = [i for i, word in enumerate(words) if word == "#"][place]
    before = [word for word in words[max(at - 2, 0) : at] if word[0].isalpha()]
    return bool(before) and _CAMERA.fullmatch(before[-1]) is not None


def _named(images: Sequence[Path]) -> list[_Named]:
    found = []
    for path in images:
        tokens = _TOKENS.findall(path.stem)
        numbers = tuple(int(token) for token in tokens if token.isdecimal())
        words = tuple("#" if token.isdecimal() else token for token in tokens)
        found.append(_Named(path, words, numbers, path.stem))
    return found


def _series(groups: Iterable[Sequence[_Named]], place: int | None) -> list[Series]:
    """Series of groups, whose names differ in their words or in the number of a place."""
    groups = list(groups)
    common = set.intersection(*(set(group[0].words) for group in groups))
    found = []
    for number, group in enumerate(groups):
        own = tuple(w for w in group[0].words if w not in common and w[0].isalpha())
        if place is not None and len(groups) == 2:
            own = (("left", "right")[number],)
        keys = [tuple(n for i, n in enumerate(e.numbers) if i != place) for e in group]
        stems = [e.stem if place is None else _without(e.stem, place) for e in group]
        paths = tuple(each.path for each in group)
        found.append(Series(paths, own, tuple(stems), tuple(keys)))
    return found


def _without(stem: str, place: int) -> str:
    """A name without one of its numbers."""
    found = list(re.finditer(r"\d+", stem))[place]
    return stem[: found.start()] + stem[found.end() :]


def _simultaneous(series: Sequence[Series]) -> list[Series]:
    """Those that show the same moments as the longest one; it alone if there are none."""
    longest = max(series, key=lambda each: len(each.images))
    if len(series) == 1 or len(series) > _MAX_CAMERAS:
        return [longest]
    return [each for each in series if each is longest or _is_beside(each, longest)]


def _is_beside(series: Series, longest: Series) -> bool:
    says = series.side or series.is_named(_DEPTH) or series.is_named(_BESIDE)
    if len(series.images) < _MIN_IMAGES and not says:
        return False
    if len(set(series.keys) & set(longest.keys)) >= _MIN_COMMON * len(series.keys):
        return True
    one, other = ([key[-1] for key in each.keys if key] for each in (series, longest))
    if not one or not other or min(*one, *other) < _MIN_STAMP:
        return False
    common = min(max(one), max(other)) - max(min(one), min(other))
    return common >= _MIN_OVERLAP * min(max(one) - min(one), max(other) - min(other)) > 0


def _which(series: Sequence[Series], images: Sequence[Path]) -> str:
    """The message that lists the series, with the pattern of each."""
    patterns = [_pattern(each, images) for each in series]
    listed = ", ".join(
        f"'{pattern}' ({counted(len(each.images), 'image')})"
        for pattern, each in zip(patterns, series, strict=True)
    )
    return (
        f"{images[0].parent} has images of {len(series)} cameras; give one of them by its pattern "
        f"in place of the folder, in quotes: {listed}; a pair is read from folders left and right, "
        "or from names with left and right"
    )


def _pattern(series: Series, images: Sequence[Path]) -> str:
    """A pattern that the images of a series match, and no other of the folder."""
    first, wanted = series.images[0], {path.name for path in series.images}
    parts = re.split(r"(\d+)", glob.escape(first.stem))
    others = [re.split(r"(\d+)", glob.escape(path.stem)) for path in series.images]
    constant = {n for n, same in enumerate(zip(*others, strict=False)) if len(set(same)) == 1}
    for kept in (set[int](), constant):
        for text in ("*", "[0-9]*", ""):
            pattern = "".join(
                part if n in kept or not part.isdecimal() else text or "[0-9]" * len(part)
                for n, part in enumerate(parts)
            )
            pattern += first.suffix
            if {p.name for p in images if fnmatch.fnmatchcase(p.name, pattern)} == wanted:
                return str(Path(glob.escape(str(first.parent))) / pattern)
    return str(first.parent)
