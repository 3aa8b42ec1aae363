"""Many images, and the pairs of them that are matched."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import ConfigError, SourceError
from vo.base.files.bounded_files import read_text
from vo.recordings.sources.listing import list_images
from vo.recordings.sources.single_image import read_single_image
from vo.tools.pairs.image_pair import ImageFeatures, PairMatcher, PairOptions
from vo.tools.pairs.match_files import MatchFile
from vo.tools.pairs.pair_options import check_cameras, image_mask

_log = logging.getLogger(__name__)
_MAX_PAIRS = 1_000_000


class ImageSet(NamedTuple):
    """Images of a folder, and the pairs to match.

    Attributes:
        names: paths below the folder.
        pairs: numbers of two names each.
    """

    folder: Path
    names: tuple[str, ...]
    pairs: tuple[tuple[int, int], ...]


class PairCounts(NamedTuple):
    """What was found of two images; `model` is None without one."""

    image_a: str
    image_b: str
    matches: int
    inliers: int
    model: str | None


def image_set(
    folder: Path,
    pairs: Path | Sequence[tuple[str, str]] | None = None,
    window: int | None = None,
) -> ImageSet:
    """The images of a folder, and pairs of them: those of a list, or all.

    `pairs`: two names below the folder each, or a text file with them in each line. `window`: of
    all pairs, those at most so many images apart in the order of their names.

    Raises:
        SourceError: the list cannot be read, or there are no images, or too many pairs.
    """
    if pairs is not None:
        listed = _listed(pairs, folder) if isinstance(pairs, Path) else _checked(pairs)
        names = tuple(dict.fromkeys(name for pair in listed for name in pair))
        number = {name: at for at, name in enumerate(names)}
        chosen = dict.fromkeys((number[one], number[other]) for one, other in listed)
        return ImageSet(folder, names, tuple(chosen))
    names = tuple(path.name for path in list_images(folder))
    if len(names) < 2:
        raise SourceError(f"{folder} has one image; give a folder with two or more")
    reach = min(window or len(names), len(names))
    if len(names) * reach > 2 * _MAX_PAIRS:
        raise SourceError(
            f"{folder} has {len(names)} images, too many to match all pairs; give `window` or "
            "`pairs`"
        )
    every = combinations(range(len(names)), 2)
    return ImageSet(folder, names, tuple(pair for pair in every if pair[1] - pair[0] <= reach))


def _checked(pairs: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    for each in pairs:
        if isinstance(each, str) or len(each) != 2 or each[0] == each[1]:
            raise ConfigError(f"`pairs` has {each!r}; give names of two images each, or a file")
    if not pairs:
        raise ConfigError("`pairs` is empty; give names of two images each, or a file")
    return [(str(one), str(other)) for one, other in pairs]


def _listed(path: Path, folder: Path) -> list[tuple[str, str]]:
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise SourceError(f"list of pairs {path}: {error.strerror or error}") from error
    except UnicodeDecodeError:
        raise SourceError(f"list of pairs {path} is no text; give two names in a line") from None
    found = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        names = [name.strip() for name in line.split("\t")] if "\t" in line else line.split()
        if len(names) != 2 or names[0] == names[1]:
            raise SourceError(
                f"{path}:{number} is '{line[:80]}'; give the names of two images of {folder}, with "
                "a space or a tab between them"
            )
        found.append((names[0], names[1]))
    if not found:
        raise SourceError(f"list of pairs {path} has no pairs; give two names in a line")
    return found


def match_set(
    images: ImageSet,
    options: PairOptions,
    files: Sequence[MatchFile] = (),
    step: Callable[[str], None] = lambda _: None,
) -> list[PairCounts]:
    """Match pairs of images, write them to files, and count.

    Images that cannot be read are left out, with a warning. `step`: called with a name before each
    image and each pair.

    Raises:
        SourceError: less than two images can be read.
    """
    matcher = PairMatcher(options)
    features = _features(images, options, matcher, step)
    camera = None if options.cameras is None else options.cameras[0]
    order = {old: new for new, old in enumerate(features)}
    for file in files:
        for number, found in features.items():
            file.add_image(images.names[number], found, camera)
    counts = []
    for first, second in images.pairs:
        names = images.names[first], images.names[second]
        step(f"{names[0]} {names[1]}")
        if first not in order or second not in order:
            continue
        pair = matcher.match(features[first], features[second])
        for file in files:
            file.add_pair(order[first], order[second], pair)
        model = None if pair.fit is None else pair.fit.kind.value
        counts.append(PairCounts(*names, len(pair.matches.query), int(pair.inlier.sum()), model))
    return counts


def _features(
    images: ImageSet, options: PairOptions, matcher: PairMatcher, step: Callable[[str], None]
) -> dict[int, ImageFeatures]:
    """Features of the images that can be read, by their number."""
    features = {}
    for number, name in enumerate(images.names):
        step(name)
        try:
            shot = read_single_image(images.folder / name)
        except SourceError as error:
            _log.warning("%s; left out", error)
            continue
        if options.cameras is not None:
            check_cameras((options.cameras[0],) * 2, (shot.image,) * 2, (name, name))
        mask = image_mask(options.config, shot.image)
        features[number] = matcher.extract(shot.image, mask)
    if len(features) < 2:
        raise SourceError(f"less than two images of {images.folder} can be read")
    return features
