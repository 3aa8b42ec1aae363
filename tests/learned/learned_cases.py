"""Models and images for tests of learned features."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vo.errors import ModelError
from vo.learned.catalog import find_model
from vo.learned.files import require_model
from vo.learned.inference import Inference, load
from vo.types import Bytes

EXPORTED = Path(__file__).resolve().parents[2].parent / "shared" / "models"
BACKENDS = ("opencv", "onnxruntime")


def require_backend(backend: str) -> None:
    """Skip the test where a backend is not installed."""
    if backend == "onnxruntime":
        pytest.importorskip("onnxruntime")


def fetched(name: str) -> Path:
    """The file of a model; the test is skipped if it has not been fetched."""
    try:
        return require_model(find_model(name))
    except ModelError as error:
        pytest.skip(str(error))


def exported(name: str) -> Path:
    """A model that torch has exported; the test is skipped where it is absent."""
    if not (EXPORTED / name).is_file():
        pytest.skip(f"the exported model is not at {EXPORTED}")
    return EXPORTED / name


def saved(model: Any, folder: Path, backend: str = "opencv") -> Inference:
    """A model, written and loaded."""
    path = folder / "model.onnx"
    path.write_bytes(model.SerializeToString())
    return load(path, backend)  # type: ignore[arg-type]


def ten_images(recording: Path, multiple: int = 32) -> list[Bytes]:
    """Ten images of a recording, cut to multiples of a size."""
    files = sorted(recording.rglob("cam0/data/*.png"))[:10]
    assert len(files) == 10
    images = []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        height, width = (n // multiple * multiple for n in image.shape)
        images.append(np.ascontiguousarray(image[:height, :width]).astype(np.uint8))
    return images


def textured(shape: tuple[int, int], seed: int = 0) -> Bytes:
    """An image of smooth noise."""
    noise = np.random.default_rng(seed).random(shape, dtype=np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX)).astype(np.uint8)
