"""Compression of images in threads, a few frames ahead of the writer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_synth.records import Pixels, Shot
from vo.base.types import Floats32

FRAMES_AHEAD = 3
"""Frames in memory besides the one in use."""

JPEG_QUALITY = 92

_THREADS = 4
# Run lengths and one filter: twice as fast as OpenCV's defaults, with smaller files.
_PNG = (
    (cv2.IMWRITE_PNG_COMPRESSION, 1)
    + (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
    + (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB)
)


@dataclass(frozen=True, eq=False)
class EncodedShot:
    """An encoded frame."""

    index: int  # number of the frame, 0…F-1
    data: tuple[bytes | None, ...]  # for each camera the encoded image, or None if dropped
    # for each camera the name of its raw pixel format; empty if dropped
    pixel_formats: tuple[str, ...]
    depth: Floats32 | None  # (H, W) float32 z in cam0, metres, infinite for the sky; or None
    depth_data: bytes | None  # the same, encoded by `encode_depth`, or None


def pixel_format(image: Pixels | None) -> str:
    """Name of the pixel format in ROS and Foxglove; empty for no image."""
    if image is None:
        return ""
    return f"{'mono' if image.ndim == 2 else 'bgr'}{8 if image.dtype == np.uint8 else 16}"


EncodeDepth = Callable[[Floats32], bytes]


def encode(image: Pixels, codec: str) -> bytes:
    """Encode an image as `png` or `jpeg` (8 bits), or `raw`: pixels row by row."""
    if codec == "raw":
        return image.astype(image.dtype.newbyteorder("<"), copy=False).tobytes()
    if codec == "png":
        _, data = cv2.imencode(".png", image, _PNG)
    else:
        _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    return bytes(data)


def encoded_shots(
    shots: Iterable[Shot], codec: str, encode_depth: EncodeDepth | None = None
) -> Generator[EncodedShot, None, None]:
    """Encode frames, in order, while the next ones are rendered.

    At most `FRAMES_AHEAD` frames are taken from `shots` in advance. A caller that stops early
    closes the generator (`contextlib.closing`), which ends the threads.

    `codec`: `png`, `jpeg` or `raw`. `encode_depth`: encoder for `depth_data`; None for no
    `depth_data`.
    """
    waiting: deque[_Job] = deque()
    with ThreadPoolExecutor(_THREADS, thread_name_prefix="encode") as pool:
        for shot in shots:
            waiting.append(_submit(pool, shot, codec, encode_depth))
            if len(waiting) > FRAMES_AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


@dataclass(frozen=True, eq=False)
class _Job:
    """A frame whose images are being encoded."""

    shot: Shot
    images: tuple[Future[bytes] | None, ...]
    depth: Future[bytes] | None

    def result(self) -> EncodedShot:
        return EncodedShot(
            self.shot.index,
            tuple(None if image is None else image.result() for image in self.images),
            tuple(map(pixel_format, self.shot.images)),
            self.shot.depth,
            None if self.depth is None else self.depth.result(),
        )


def _submit(
    pool: ThreadPoolExecutor, shot: Shot, codec: str, encode_depth: EncodeDepth | None
) -> _Job:
    images = tuple(
        None if image is None else pool.submit(encode, image, codec) for image in shot.images
    )
    depth = None
    if encode_depth is not None and shot.depth is not None:
        depth = pool.submit(encode_depth, shot.depth)
    return _Job(shot, images, depth)


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
