"""DISK: its graph against plain numpy, and keypoints and descriptors from its outputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from learned_cases import BACKENDS, check_extractor, fetched, require_backend, saved, textured

from vo.base.types import Floats, Floats32
from vo.engine.learned.disk import DISK_OUTPUTS, DiskExtractor, convolved_at, disk_model
from vo.engine.learned.inference import load
from vo.engine.learned.maps import parabola_offsets, strongest

pytest.importorskip("onnx")

DOWN, UP, DIM = (4, 6, 8, 8, 8), (8, 8, 8, 17), 16


def random_weights() -> dict[str, Floats32]:
    """Weights in the layout of the authors' file, narrower."""
    noise = np.random.default_rng(3)
    weights: dict[str, Floats32] = {}

    def layer(name: str, inputs: int, outputs: int, *, is_first: bool = False) -> None:
        if not is_first:
            weights[f"{name}.1.weight"] = noise.uniform(0.1, 0.5, inputs).astype(np.float32)
        shape = (outputs, inputs, 5, 5)
        scale = 1 / np.sqrt(25 * inputs)
        weights[f"{name}.3.weight"] = (scale * noise.standard_normal(shape)).astype(np.float32)
        weights[f"{name}.3.bias"] = (0.1 * noise.standard_normal(outputs)).astype(np.float32)

    for n, (inputs, outputs) in enumerate(zip((3, *DOWN), DOWN, strict=False)):
        layer(f"extractor.unet.path_down.{n}.1", inputs, outputs, is_first=n == 0)
    for n, (below, beside, outputs) in enumerate(
        zip((DOWN[-1], *UP), DOWN[-2::-1], UP, strict=False)
    ):
        layer(f"extractor.unet.path_up.{n}.conv", below + beside, outputs)
    return weights


def convolution(x: Floats, weight: Floats32, bias: Floats32) -> Floats:
    padded = np.pad(x, ((0, 0), (2, 2), (2, 2)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5), axis=(1, 2))
    return np.asarray(np.einsum("chwij,dcij->dhw", windows, weight) + bias[:, None, None])


def gate(x: Floats, slope: Floats32) -> Floats:
    x = x - x.mean(axis=(1, 2), keepdims=True)
    x = x / np.sqrt((x * x).mean(axis=(1, 2), keepdims=True) + 1e-5)
    return np.asarray(np.where(x > 0, x, x * slope[:, None, None]))


def halved(x: Floats) -> Floats:
    return np.asarray((x[:, ::2, ::2] + x[:, 1::2, ::2] + x[:, ::2, 1::2] + x[:, 1::2, 1::2]) / 4)


def doubled(x: Floats) -> Floats:
    """Pixels of twice the number lie a quarter of a pixel beside the old ones."""
    for axis in (1, 2):
        x = np.moveaxis(x, axis, 0)
        before, after = np.concatenate([x[:1], x[:-1]]), np.concatenate([x[1:], x[-1:]])
        both = np.stack([0.75 * x + 0.25 * before, 0.75 * x + 0.25 * after], axis=1)
        x = np.moveaxis(both.reshape(-1, *x.shape[1:]), 0, axis)
    return x


def reference(weights: dict[str, Floats32], image: Floats) -> Floats:
    """(D + 1, H, W), with all three colours and the last convolution on the whole image."""

    def layer(name: str, x: Floats) -> Floats:
        if f"{name}.1.weight" in weights:
            x = gate(x, weights[f"{name}.1.weight"])
        return convolution(x, weights[f"{name}.3.weight"], weights[f"{name}.3.bias"])

    levels = [layer("extractor.unet.path_down.0.1", np.repeat(image[None], 3, axis=0))]
    for n in range(1, len(DOWN)):
        levels.append(layer(f"extractor.unet.path_down.{n}.1", halved(levels[-1])))
    x = levels.pop()
    for n in range(len(UP)):
        x = layer(f"extractor.unet.path_up.{n}.conv", np.concatenate([doubled(x), levels.pop()]))
    return x


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_graph_is_the_network(backend: str, tmp_path: Path) -> None:
    require_backend(backend)
    weights = random_weights()
    inference = saved(disk_model(weights), tmp_path, backend)
    image = textured((48, 64)).astype(np.float32) / 255
    heat, features, weight, bias = inference.run({"image": image[None, None]}, DISK_OUTPUTS)
    expected = reference(weights, image.astype(np.float64))
    np.testing.assert_allclose(heat[0, 0], expected[-1], atol=1e-4)
    v, u = (a.reshape(-1) for a in np.indices(image.shape))
    described = convolved_at(features[0], weight, bias.reshape(-1), v, u)
    np.testing.assert_allclose(described.T.reshape(DIM, 48, 64), expected[:-1], atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_images_of_any_size_and_masks(backend: str, tmp_path: Path) -> None:
    require_backend(backend)
    extractor = DiskExtractor(saved(disk_model(random_weights()), tmp_path, backend), 40)
    check_extractor(extractor, DIM, min_side=32, max_beyond_mask_px=1)


def test_peaks_are_found_between_pixels() -> None:
    """A parabola with its vertex at (3.25, 2.6)."""
    y, x = np.mgrid[:6, :8]
    values = 5.0 - (x - 3.25) ** 2 - 2.0 * (y - 2.6) ** 2
    v, u = strongest(values, 1)
    assert (v.tolist(), u.tolist()) == ([3], [3])
    np.testing.assert_allclose(parabola_offsets(values, v, u), [[0.25, -0.4]], atol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_weights_of_the_authors_match_a_shifted_image(backend: str) -> None:
    require_backend(backend)
    extractor = DiskExtractor(load(fetched("disk"), backend), 300)  # type: ignore[arg-type]
    large = textured((208, 272))
    first, second = (
        extractor.extract(large[y : y + 192, x : x + 256]) for x, y in ((0, 0), (9, 6))
    )
    similarity = first.descriptor @ second.descriptor.T
    forth, back = similarity.argmax(axis=1), similarity.argmax(axis=0)
    rows = np.flatnonzero(back[forth] == np.arange(len(first)))
    error = np.linalg.norm(first.xy[rows] - second.xy[forth[rows]] - [9, 6], axis=1)
    assert len(rows) > 80
    assert (error < 1.5).mean() > 0.8
