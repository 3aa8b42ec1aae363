"""Images to try methods on: files, and frames of recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import ConfigError, SourceError
from vo.base.files.bounded_files import read_text
from vo.base.types import Bytes, Floats, Frame
from vo.recordings.sources.listing import IMAGE_SUFFIXES
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.single_image import read_single_image
from vo.recordings.sources.source import Recording

_MIN_DETERMINANT = 1e-12  # of a homography of norm 1


class GreyImage(NamedTuple):
    """An image, and where features may lie."""

    pixels: Bytes  # (H, W) uint8
    mask: Bytes | None = None  # (H, W) uint8, 0 where it is not to be used; None to use all of it


def is_image(path: Path) -> bool:
    """Whether a path is that of an image, by its suffix."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir() and "*" not in path.name


def read_image(path: Path) -> GreyImage:
    """An image file in grey levels, 16 bits converted as those of a recording.

    Raises:
        SourceError: it is missing, damaged or not an image.
    """
    return GreyImage(read_single_image(path).image)


def open_left_images(
    path: str | Path,
    *,
    format: str | None = None,
    calibration: str | Path | None = None,
    topics: Sequence[str] = (),
) -> Recording:
    """A recording, without the right images of a pair.

    Raises:
        VoError: it cannot be opened.
    """
    source = open_source(path, format=format, calibration=calibration, topics=topics)
    if not source.rig.is_stereo:
        return source
    return open_source(path, format=format, calibration=calibration, topics=topics, mode="mono")


def read_frame(recording: Recording, number: int) -> Frame:
    """A frame of a recording.

    Raises:
        ConfigError: there is no such frame.
        SourceError: it cannot be read.
    """
    if not 0 <= number < len(recording):
        raise ConfigError(
            f"{recording.name} has no frame {number}; frames are 0 to {len(recording) - 1}"
        )
    for frame in recording.frames(number, number + 1):
        return frame
    raise SourceError(f"frame {number} of {recording.name} cannot be read; choose another `frame`")


class PlanePair(NamedTuple):
    """Files of two images of a plane, and the homography from the first to the second."""

    first: Path
    second: Path
    homography: Path


def plane_pairs(folder: Path) -> list[PlanePair]:
    """The pairs of a folder of HPatches: `1.ppm` with each N.ppm of a file `H_1_N`; may be empty.

    Raises:
        SourceError: an image of a pair is missing.
    """
    if not folder.is_dir():
        return []

    def image(number: str) -> Path:
        found = [folder / f"{number}{suffix}" for suffix in IMAGE_SUFFIXES]
        path = next((each for each in found if each.is_file()), None)
        if path is None:
            raise SourceError(f"{folder} has homographies (H_1_2, …), but no image {number}.ppm")
        return path

    files = sorted(folder.glob("H_1_*"))
    return [PlanePair(image("1"), image(path.name[4:]), path) for path in files]


def read_homography(path: Path) -> Floats:
    """A homography (3, 3), second_from_first, as text of three rows, as in HPatches.

    Raises:
        SourceError: the file is missing, has other content, or the matrix has no inverse.
    """
    try:
        words = read_text(path).replace(",", " ").split()
        matrix = np.array(words, dtype=np.float64).reshape(3, 3)
    except OSError as error:
        raise SourceError(f"homography {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise SourceError(
            f"homography {path} is not nine numbers; give three rows of three, which take pixels "
            "of the first image to the second"
        ) from error
    size = float(np.linalg.norm(matrix))
    if not np.isfinite(size) or abs(np.linalg.det(matrix)) <= _MIN_DETERMINANT * size**3:
        raise SourceError(f"homography {path} has no inverse; give one of two images of a plane")
    return matrix
