"""Images of a recording: what they look like, and a sheet of some with frame number and time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.rig_overlap import is_rig
from vo.base.types import Bytes
from vo.engine.frontend.image_faults import blur
from vo.recordings.sources.grey_levels import GreyLevels, find_grey_levels
from vo.recordings.sources.images import StoredImage, is_colour
from vo.tools.drawing import write_picture
from vo.tools.inspection.image_records import ImageStatistics
from vo.tools.inspection.opening import ImageSequence, OpenedRecording
from vo.tools.inspection.rig_picture import draw_rig

_DARK, _BRIGHT = 10, 250
_FAST_THRESHOLD = 12


class ImageReader:
    """Reads images of a camera as 8-bit grey images, and records unreadable ones."""

    def __init__(self, images: Sequence[StoredImage]) -> None:
        self._images = images
        self._levels = GreyLevels(8)
        self.unreadable: dict[int, str] = {}
        if images:
            self._levels = find_grey_levels(images)

    @property
    def bits(self) -> int:
        """Bits per pixel used by the camera."""
        return self._levels.bit_depth

    @property
    def has_colour(self) -> bool:
        """Whether the first readable image is in colour."""
        return is_colour(self._images)

    def read(self, number: int) -> Bytes | None:
        """An image (H, W); None if it is unreadable."""
        try:
            return self._levels.to_8_bits(self._images[number].read(), number)
        except SourceError as error:
            self.unreadable[number] = str(error)
            return None


def evenly_spaced(count: int, wanted: int) -> list[int]:
    """`wanted` evenly spaced numbers from 0 to `count - 1`."""
    if count <= wanted:
        return list(range(count))
    return sorted({round(i) for i in np.linspace(0, count - 1, wanted).tolist()})


def check_images(
    reader: ImageReader, count: int, wanted: int
) -> tuple[list[ImageStatistics], tuple[int, int], list[int]]:
    """Check evenly spaced images of a recording, each compared with the previous one.

    Returns statistics of the checked images, width and height of the first one, and the numbers of
    images of other sizes.
    """
    looks: list[ImageStatistics] = []
    size: tuple[int, int] = (0, 0)
    others: list[int] = []
    last: tuple[int, Bytes | None] = (-1, None)
    for number in evenly_spaced(count, wanted):
        before = last[1] if last[0] == number - 1 else reader.read(number - 1) if number else None
        image = reader.read(number)
        last = (number, image)
        if image is None:
            continue
        size = size if size[0] else (image.shape[1], image.shape[0])
        if (image.shape[1], image.shape[0]) != size:
            others.append(number)
        repeats = None if before is None else bool(np.array_equal(before, image))
        looks.append(_statistics(number, image, repeats))
    return looks, size, others


def _statistics(number: int, image: Bytes, repeats: bool | None) -> ImageStatistics:
    return ImageStatistics(
        frame=number,
        mean_grey=float(image.mean()),
        dark=float((image < _DARK).mean()),
        bright=float((image > _BRIGHT).mean()),
        blur=blur(image),
        corners=len(cv2.FastFeatureDetector.create(_FAST_THRESHOLD).detect(image)),
        repeats=repeats,
    )


def frame_ranges(frames: Sequence[int], checked: Sequence[int]) -> list[tuple[int, int]]:
    """Ranges (first, last) of frames that are consecutive among the checked ones."""
    place = {frame: i for i, frame in enumerate(checked)}
    joined: list[list[int]] = [[frame] for frame in frames[:1]]
    for before, frame in pairwise(frames):
        if place[frame] == place[before] + 1:
            joined[-1].append(frame)
        else:
            joined.append([frame])
    return [(each[0], each[-1]) for each in joined]


_COLUMNS = 6
_IMAGES = 24
_TILE_WIDTH = 320
_LABEL_HEIGHT = 22
_GAP = 4


def write_contact_sheet(path: Path, opened: OpenedRecording) -> None:
    """Write the contact sheet as a PNG file.

    Raises:
        SourceError: no image is readable.
        OutputError: the file cannot be written.
    """
    rows: list[Bytes] = []
    each = max(_COLUMNS, _IMAGES // max(1, len(opened.cameras)) // _COLUMNS * _COLUMNS)
    try:
        for camera in opened.cameras:
            tiles = _tiles(camera, each)
            rows += [_row(tiles[i : i + _COLUMNS]) for i in range(0, len(tiles), _COLUMNS)]
    finally:
        opened.close()
    if not rows:
        raise SourceError(f"{opened.path} contains no readable image")
    if opened.rig is not None and is_rig(opened.rig):
        drawn = draw_rig(opened.rig)
        beside = np.full((drawn.shape[0], rows[0].shape[1] - drawn.shape[1]), 255, np.uint8)
        rows.append(np.hstack([drawn, beside]))
    write_picture(path, np.vstack(rows), ".png")


def _tiles(camera: ImageSequence, wanted: int) -> list[Bytes]:
    reader = ImageReader([shot.image for shot in camera.shots])
    first_ns = camera.shots[0].stamp_ns
    tiles: list[Bytes] = []
    height = 0
    for number in evenly_spaced(len(camera.shots), wanted):
        seconds = 1e-9 * (camera.shots[number].stamp_ns - first_ns)
        image = reader.read(number)
        if image is not None and not height:
            height = round(image.shape[0] * _TILE_WIDTH / image.shape[1])
        tiles.append(
            _tile(image, height or _TILE_WIDTH, f"{camera.name} #{number} {seconds:.2f} s")
        )
    return tiles


def _tile(image: Bytes | None, height: int, label: str) -> Bytes:
    tile = np.full((height + _LABEL_HEIGHT + _GAP, _TILE_WIDTH + _GAP), 255, dtype=np.uint8)
    if image is None:
        tile[:height, :_TILE_WIDTH] = 128
        label += " unreadable"
    else:
        small = cv2.resize(image, (_TILE_WIDTH, height), interpolation=cv2.INTER_AREA)
        tile[:height, :_TILE_WIDTH] = small
    place = (2, height + _LABEL_HEIGHT - 6)
    cv2.putText(tile, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 0, 1, cv2.LINE_AA)
    return tile


def _row(tiles: list[Bytes]) -> Bytes:
    height = max(tile.shape[0] for tile in tiles)
    row = np.full((height, _COLUMNS * (_TILE_WIDTH + _GAP)), 255, dtype=np.uint8)
    for column, tile in enumerate(tiles):
        left = column * (_TILE_WIDTH + _GAP)
        row[: tile.shape[0], left : left + tile.shape[1]] = tile
    return row
