"""One file for each image of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from data_synth.records import Shot
from data_synth.writers.encoding import EncodeDepth, encoded_shots
from vo.base.types import Floats32

SUFFIXES = {"png": ".png", "jpeg": ".jpg"}

TUM_DEPTH_FACTOR = 5000.0
"""Units per metre of TUM's depth images."""

_LARGEST_COUNT = 65535


def float_tiff(depth: Floats32) -> bytes:
    """A depth image (H, W) in metres as a float32 TIFF file."""
    # Deflate rather than LZW, which needs extra packages in some readers.
    deflate = (cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_ADOBE_DEFLATE)
    _, data = cv2.imencode(".tiff", depth, deflate)
    return bytes(data)


def tum_depth_png(depth: Floats32) -> bytes:
    """A depth image (H, W) in metres as TUM's 16-bit PNG; 0 where it is too far (13.1 m)."""
    counts = np.round(np.float32(TUM_DEPTH_FACTOR) * depth)
    known = np.where(counts <= _LARGEST_COUNT, counts, 0.0)
    _, data = cv2.imencode(".png", known.astype(np.uint16), (cv2.IMWRITE_PNG_COMPRESSION, 1))
    return bytes(data)


def write_images(
    shots: Iterable[Shot],
    codec: str,
    image_path: Callable[[int, int], Path],
    depth_path: Callable[[int], Path],
    encode_depth: EncodeDepth = float_tiff,
) -> None:
    """Write all images, and the depth images of the frames that cam0 has.

    `codec`: `png` or `jpeg`. `image_path`: path of an image, given the numbers of camera and frame.
    `depth_path`: path of a depth image, given the number of the frame.

    Raises:
        OSError: a file cannot be written.
    """
    with closing(encoded_shots(shots, codec, encode_depth)) as frames:
        for shot in frames:
            for camera, data in enumerate(shot.data):
                if data is not None:
                    image_path(camera, shot.index).write_bytes(data)
            if shot.depth_data is not None and shot.data[0] is not None:
                depth_path(shot.index).write_bytes(shot.depth_data)
