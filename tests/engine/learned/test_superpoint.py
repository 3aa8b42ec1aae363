"""SuperPoint: its graph against plain numpy on random weights, keypoints, descriptors, licence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from learned_cases import (
    BACKENDS,
    check_extractor,
    fetch_own_weights,
    require_backend,
    saved,
    textured,
)

from vo.base.types import Floats, Floats32
from vo.engine.learned.inference import load
from vo.engine.learned.superpoint import (
    SUPERPOINT_OUTPUTS,
    SuperPointExtractor,
    described_at,
    superpoint_model,
)

pytest.importorskip("onnx")

DIM = 12


def random_weights() -> dict[str, Floats32]:
    """Weights in the layout of the authors' file, narrower."""
    noise = np.random.default_rng(4)
    weights: dict[str, Floats32] = {}
    layers = [("1a", 1, 4, 3), ("1b", 4, 4, 3), ("2a", 4, 6, 3), ("2b", 6, 6, 3), ("3a", 6, 8, 3)]
    layers += [("3b", 8, 8, 3), ("4a", 8, 8, 3), ("4b", 8, 8, 3), ("Pa", 8, 10, 3)]
    layers += [("Pb", 10, 65, 1), ("Da", 8, 10, 3), ("Db", 10, DIM, 1)]
    for name, inputs, outputs, side in layers:
        shape, scale = (outputs, inputs, side, side), np.sqrt(2 / (inputs * side * side))
        weight = scale * noise.standard_normal(shape)
        weights[f"conv{name}.weight"] = weight.astype(np.float32)
        weights[f"conv{name}.bias"] = (0.2 * noise.standard_normal(outputs)).astype(np.float32)
    return weights


def reference(weights: dict[str, Floats32], image: Floats) -> tuple[Floats, Floats]:
    """Scores (H, W) and descriptors (D, H/8, W/8) in double precision."""

    def convolution(name: str, x: Floats) -> Floats:
        weight, bias = weights[f"conv{name}.weight"], weights[f"conv{name}.bias"]
        side = weight.shape[2]
        padded = np.pad(x, ((0, 0), (side // 2,) * 2, (side // 2,) * 2))
        windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(1, 2))
        return np.asarray(np.einsum("chwij,dcij->dhw", windows, weight) + bias[:, None, None])

    x = image[None]
    for block in "1234":
        if block != "1":
            c, h, w = x.shape
            x = x.reshape(c, h // 2, 2, w // 2, 2).max(axis=(2, 4))
        for part in "ab":
            x = np.maximum(convolution(block + part, x), 0)
    cells = np.exp(convolution("Pb", np.maximum(convolution("Pa", x), 0)))
    cells = (cells / cells.sum(axis=0))[:64]
    _, h, w = cells.shape
    score = cells.reshape(8, 8, h, w).transpose(2, 0, 3, 1).reshape(8 * h, 8 * w)
    described = convolution("Db", np.maximum(convolution("Da", x), 0))
    return score, described / np.linalg.norm(described, axis=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_graph_is_the_network(backend: str, tmp_path: Path) -> None:
    require_backend(backend)
    weights = random_weights()
    inference = saved(superpoint_model(weights), tmp_path, backend)
    for shape in ((24, 40), (64, 48)):
        image = textured(shape).astype(np.float32) / 255
        found = inference.run({"image": image[None, None]}, SUPERPOINT_OUTPUTS)
        score, described = reference(weights, image.astype(np.float64))
        np.testing.assert_allclose(found[0][0, 0], score, atol=1e-5)
        np.testing.assert_allclose(found[1][0], described, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_images_of_any_size_and_masks(backend: str, tmp_path: Path) -> None:
    require_backend(backend)
    model = superpoint_model(random_weights())
    extractor = SuperPointExtractor(saved(model, tmp_path, backend), 40)
    check_extractor(extractor, DIM, min_side=16, max_beyond_mask_px=0)
    for shape in ((16, 17), (33, 70), (61, 129)):
        found = extractor.extract(textured(shape))
        assert (found.xy >= 4).all()
        assert (found.xy < [shape[1] - 4, shape[0] - 4]).all()
        gap = np.abs(found.xy[:, None] - found.xy[None]).max(axis=2) + 9 * np.eye(len(found))
        assert gap.min() > 4


def test_descriptors_between_cells() -> None:
    """By hand, 4 x 3 cells with their own column and row as descriptors.

    3.5 is the first cell; 31 and 23, the last pixels, the last one; in between in proportion.
    """
    row, column = np.mgrid[:3, :4]
    cells = np.stack([column, row]).astype(np.float32)
    xy = np.array([[3.5, 3.5], [31.0, 23.0], [17.25, 13.25], [0.0, 0.0]])
    np.testing.assert_allclose(described_at(cells, xy), [[0, 0], [3, 2], [1.5, 1], [0, 0]])


def test_a_file_of_the_user_is_needed_and_the_licence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "models"))
    path = fetch_own_weights("superpoint", random_weights(), "conv1a.weight", tmp_path)
    assert len(SuperPointExtractor(load(path), 50).extract(textured((64, 64)))) > 0
