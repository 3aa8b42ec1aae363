"""Depths of keyframes on disk, until all are fused."""

from __future__ import annotations

import shutil
from functools import lru_cache
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.files.complete_file import complete_file, writing
from vo.base.types import Floats32
from vo.tools.dense.depth import DepthMap

_STEPS_PER_SIGMA = 8  # of inverse depths as they are stored
_STEPS_PER_DOUBLING = 16  # of standard deviations
_MAX = 65535
_HELD = 12  # depths in memory: those that are compared at a time


class DepthStore:
    """Depths of keyframes on disk, 16 bits each, so that a broken-off run can go on.

    `folder`: what another version or another run has left there is removed.
    """

    def __init__(self, folder: Path, fingerprint: str) -> None:
        self._folder = folder
        self.load = lru_cache(_HELD)(self._load)
        stamp = folder / "of"
        with writing(folder):
            if folder.is_dir() and not (stamp.is_file() and stamp.read_text() == fingerprint):
                shutil.rmtree(folder)
            folder.mkdir(exist_ok=True)
            stamp.write_text(fingerprint)

    def has(self, row: int) -> bool:
        """Whether the depth of a keyframe is there."""
        return self._path(row).is_file()

    def save(self, row: int, depth: DepthMap) -> None:
        """Store the depth of a keyframe."""
        least = float(depth.sigma.min())
        step = max(least / _STEPS_PER_SIGMA, float(depth.inverse.max()) / _MAX)
        whole = np.rint(depth.inverse / np.float32(step)).astype(np.uint16)
        errors = np.rint(_STEPS_PER_DOUBLING * np.log2(depth.sigma / np.float32(least)))
        sigma = np.minimum(errors, 255).astype(np.uint8)
        pictures = (cv2.imencode(".png", each)[1] for each in (whole, sigma))
        path = self._path(row)
        with writing(path), complete_file(path) as file:
            np.savez(file, *pictures, step=step, least=least)

    def _load(self, row: int) -> DepthMap:
        """The depth of a keyframe, not to be changed.

        Raises:
            SourceError: the file is damaged.
        """
        path = self._path(row)
        try:
            with np.load(path) as data:
                step, least = np.float32(data["step"]), np.float32(data["least"])
                whole, errors = (
                    np.asarray(cv2.imdecode(data[name], cv2.IMREAD_UNCHANGED))
                    for name in ("arr_0", "arr_1")
                )
                sigmas = least * np.exp2(np.arange(256, dtype=np.float32) / _STEPS_PER_DOUBLING)
                return DepthMap(whole * step, sigmas[errors])
        except (OSError, ValueError, KeyError, EOFError, TypeError, cv2.error) as error:
            raise SourceError(f"{path} is damaged; remove {self._folder} and run again") from error

    def save_confirmed(self, row: int, inverse: Floats32) -> None:
        """Keep inverse depths (H, W) of a keyframe that others confirm, for this call only."""
        path = self._path(row).with_suffix(".npy")
        data = BytesIO()  # NumPy does not say why it cannot write to a file
        np.save(data, inverse)
        with writing(path):
            path.write_bytes(data.getvalue())

    def load_confirmed(self, row: int) -> Floats32:
        """What was kept of a keyframe."""
        return np.asarray(np.load(self._path(row).with_suffix(".npy")), np.float32)

    def remove(self) -> None:
        """Remove everything."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, row: int) -> Path:
        return self._folder / f"{row:06d}.npz"
