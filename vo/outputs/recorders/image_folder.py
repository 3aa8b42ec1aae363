"""Images of keyframes as files, in colour where the recording is in colour."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.files.bounded_files import read_bytes
from vo.base.types import Bytes

_COLOUR_DIMENSIONS = 3
_MAX_BYTES = 512 * 2**20


class ImageFolder:
    """Writes images under their names in the recording.

    `folder`: must exist; files of the same name are replaced.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: set[str] = set()

    def add(self, frame_index: int, path: Path | None, image: Bytes, *, is_recorded: bool) -> str:
        """Write the image of a frame; its file name, without white space.

        `frame_index`: number of the frame. `path`: file of its recorded image, None without one.
        `is_recorded`: whether `image` equals the recorded image, so that a colour image can be
        copied instead.

        Raises:
            OSError: the file cannot be written, or the folder is that of the recording.
        """
        if path is not None and path.parent.resolve() == self._folder.resolve():
            raise OSError(f"{self._folder} contains the images of the recording")
        # A link may lead to a file that is no part of the recording: only its pixels are written.
        may_copy = is_recorded and path is not None and not path.is_symlink()
        recorded = _in_colour(path) if may_copy and path is not None else None
        suffix = ".png" if recorded is None else recorded.suffix
        stem = "frame" if path is None else re.sub(r"\s", "_", path.stem)
        name = f"{stem}{suffix}"
        if path is None or name in self._names:
            name = f"{stem}_{frame_index:06d}{suffix}"
        self._names.add(name)
        if recorded is None:
            (self._folder / name).write_bytes(_png(image))
        else:
            shutil.copyfile(recorded, self._folder / name)
        return name


def _in_colour(path: Path) -> Path | None:
    """The file, if it is a readable colour image of 8 bits."""
    try:
        data = np.frombuffer(read_bytes(path, _MAX_BYTES), dtype=np.uint8)
        image: NDArray[np.generic] | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error):
        return None
    if image is None or image.ndim != _COLOUR_DIMENSIONS or image.dtype != np.uint8:
        return None
    return path


def _png(image: Bytes) -> bytes:
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done
    return bytes(data.tobytes())
