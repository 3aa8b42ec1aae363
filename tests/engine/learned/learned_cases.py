"""Models and images for tests of learned features."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from torch_files import old_torch_file

from vo.base.errors import ModelError
from vo.base.types import Bytes
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.learned.catalog import find_model
from vo.engine.learned.files import models_folder, require_model, verify
from vo.engine.learned.inference import Inference, load
from vo.tools.models.fetch import fetch

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
EXPORTED = SHARED / "models"
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


def check_extractor(
    extractor: FeatureExtractor, width: int, min_side: int, max_beyond_mask_px: int
) -> None:
    """Check the features of images of several sizes, with and without a mask.

    Args:
        extractor: finds at most 40 features.
        width: of its descriptors.
        min_side: of an image with features.
        max_beyond_mask_px: by which features may move into the mask between pixels.
    """
    assert extractor.descriptor_format == (width, np.dtype(np.float32))
    for shape in ((min_side, min_side + 1), (33, 70), (61, 129)):
        image = textured(shape)
        found = extractor.extract(image)
        assert 0 < len(found) <= 40
        assert (found.xy >= 0).all()
        assert (found.xy <= [shape[1] - 1, shape[0] - 1]).all()
        np.testing.assert_allclose(np.linalg.norm(found.descriptor, axis=1), 1, atol=1e-5)
        assert (np.diff(found.response) <= 0).all()
        again = extractor.extract(image)
        np.testing.assert_array_equal(found.xy, again.xy)
        np.testing.assert_array_equal(found.descriptor, again.descriptor)
        mask = np.full(shape, 255, np.uint8)
        mask[:, : shape[1] // 2] = 0
        kept = extractor.extract(image, mask)
        assert len(kept) > 0
        assert (kept.xy[:, 0] >= shape[1] // 2 - max_beyond_mask_px).all()
        assert len(extractor.extract(image, np.zeros_like(mask))) == 0
    assert extractor.extract(textured((min_side - 1, 200))).descriptor.shape == (0, width)


def fetch_own_weights(name: str, weights: dict[str, Any], first: str, folder: Path) -> Path:
    """Make a model from a file of the user's own, after attempts that must fail.

    Args:
        name: of the model, whose licence has to be accepted.
        weights: in the layout of the authors' file.
        first: name of the first of them that is missed.
        folder: for the files.
    """
    model = find_model(name)
    source, other = folder / model.member, folder / "other.pth"
    source.write_bytes(old_torch_file(weights))
    other.write_bytes(old_torch_file({"a": np.zeros(3, np.float32)}))
    with pytest.raises(ModelError, match="`accept_licence`"):
        fetch(model, str(source))
    with pytest.raises(ModelError, match="`source=FILE`"):
        fetch(model, accept_licence=True)
    with pytest.raises(ModelError, match=re.escape(f"weights of '{name}' lack '{first}'")):
        fetch(model, str(other), accept_licence=True)
    assert not models_folder().exists()
    path = fetch(model, str(source), accept_licence=True)
    assert verify(model) == path
    return path


def textured(shape: tuple[int, int], seed: int = 0) -> Bytes:
    """An image of smooth noise."""
    noise = np.random.default_rng(seed).random(shape, dtype=np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX)).astype(np.uint8)
