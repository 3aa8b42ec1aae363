"""Contact sheet: evenly spaced images of a recording, with frame number and time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Bytes
from vo.tools.drawing import write_picture
from vo.tools.inspection.images import ImageReader, evenly_spaced
from vo.tools.inspection.opening import ImageSequence, OpenedRecording

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
