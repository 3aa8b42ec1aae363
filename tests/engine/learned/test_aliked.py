"""ALIKED: the graph, and keypoints and descriptors from its outputs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from learned_cases import (
    BACKENDS,
    check_extractor,
    exported,
    fetched,
    require_backend,
    saved,
    ten_images,
    textured,
)

from vo.base.types import Bytes, Floats32
from vo.engine.learned.aliked import AlikedExtractor, describe, soft_argmax_offsets
from vo.engine.learned.aliked_graph import ALIKED_OUTPUTS, HEAD, aliked_model, sampled
from vo.engine.learned.inference import load

pytest.importorskip("onnx")

WIDTHS = (8, 16, 32, 64)
DIM = 64


def random_weights(seed: int = 0) -> dict[str, Floats32]:
    """Weights in the layout of the authors' file of ALIKED-t16."""
    noise = np.random.default_rng(seed)

    def normal(*shape: int, scale: float | None = None) -> Floats32:
        inputs = np.prod(shape[1:]) if len(shape) > 1 else 1
        factor = (1.0 / np.sqrt(inputs)) if scale is None else scale
        return (noise.standard_normal(shape) * factor).astype(np.float32)

    weights: dict[str, Floats32] = {}
    before = 3
    for n, width in enumerate(WIDTHS, 1):
        for layer, inputs in ((1, before), (2, width)):
            name = f"block{n}.conv{layer}"
            if n > 2:
                weights[f"{name}.offset_conv.weight"] = normal(18, inputs, 3, 3)
                weights[f"{name}.offset_conv.bias"] = normal(18)
                name += ".regular_conv"
            weights[f"{name}.weight"] = normal(width, inputs, 3, 3)
            norm = f"block{n}.bn{layer}"
            weights[f"{norm}.weight"] = 1 + normal(width, scale=0.1)
            weights[f"{norm}.bias"] = normal(width, scale=0.1)
            weights[f"{norm}.running_mean"] = normal(width, scale=0.1)
            weights[f"{norm}.running_var"] = 1 + np.abs(normal(width, scale=0.1))
        if n > 1:
            weights[f"block{n}.downsample.weight"] = normal(width, before, 1, 1)
            weights[f"block{n}.downsample.bias"] = normal(width, scale=0.1)
        weights[f"conv{n}.weight"] = normal(DIM // 4, width, 1, 1)
        before = width
    for layer, (outputs, inputs, side) in {
        0: (8, DIM, 1),
        2: (4, 8, 3),
        4: (4, 4, 3),
        6: (1, 4, 3),
    }.items():
        weights[f"score_head.{layer}.weight"] = normal(outputs, inputs, side, side, scale=0.4)
    weights["desc_head.agg_weights"] = normal(16, DIM, DIM, scale=0.1)
    weights["desc_head.offset_conv.0.weight"] = normal(32, DIM, 3, 3)
    weights["desc_head.offset_conv.0.bias"] = normal(32)
    weights["desc_head.offset_conv.2.weight"] = normal(32, 32, 1, 1, scale=1.0)
    weights["desc_head.offset_conv.2.bias"] = normal(32)
    weights["desc_head.sf_conv.weight"] = normal(DIM, DIM, 1, 1)
    return weights


def at(values: Floats32, x: float, y: float) -> Floats32:
    """Values of (C, H, W) between pixels, 0 outside."""
    _, height, width = values.shape
    left, top = int(np.floor(x)), int(np.floor(y))
    result = np.zeros(len(values))
    for v, b in ((top, 1 - (y - top)), (top + 1, y - top)):
        for u, a in ((left, 1 - (x - left)), (left + 1, x - left)):
            if 0 <= v < height and 0 <= u < width:
                result += a * b * values[:, v, u]
    return result.astype(np.float32)


@pytest.mark.parametrize("backend", BACKENDS)
def test_taps_of_a_deformable_convolution(backend: str, tmp_path: Path) -> None:
    """Each pixel takes the 3 x 3 around it, each moved by its own offset."""
    require_backend(backend)
    from vo.engine.learned.graph import GraphBuilder

    noise = np.random.default_rng(0)
    x = noise.standard_normal((1, 2, 6, 9)).astype(np.float32)
    offset = (1.5 * noise.standard_normal((1, 18, 6, 9))).astype(np.float32)
    offset[0, 4, 2, 3] = 100.0  # limited to a quarter of the larger side
    graph = GraphBuilder({})
    taps = sampled(graph, "x", "offset")
    shapes = {"x": (1, 2, "h", "w"), "offset": (1, 18, "h", "w")}
    model = graph.model(shapes, {"taps": (taps, (1, 18, "h", "w"))}, "taps")
    (found,) = saved(model, tmp_path, backend).run({"x": x, "offset": offset}, ["taps"])
    limited = offset.clip(-9 / 4, 9 / 4)
    for v in range(6):
        for u in range(9):
            for tap in range(9):
                dy, dx = limited[0, 2 * tap, v, u], limited[0, 2 * tap + 1, v, u]
                expected = at(x[0], u + tap % 3 - 1 + dx, v + tap // 3 - 1 + dy)
                np.testing.assert_allclose(found[0, [tap, 9 + tap], v, u], expected, atol=1e-5)


def test_maxima_are_moved_to_the_mean_of_their_neighbours() -> None:
    """Weights exp(score / 0.1): two equal pixels meet in the middle, a lone one stays."""
    score = np.zeros((20, 30), np.float32)
    score[8, 10] = score[8, 11] = 0.9
    score[15, 20] = 1.0
    offset = soft_argmax_offsets(score, np.array([8, 15]), np.array([10, 20]))
    small = np.exp(-9.0)
    shift = (1 - small) / (2 + 23 * small)  # the columns -2 and 2 cancel
    np.testing.assert_allclose(offset[0], [shift, 0], atol=1e-6)
    np.testing.assert_allclose(offset[1], [0, 0], atol=1e-9)


def test_descriptors_are_those_of_a_plain_computation(tmp_path: Path) -> None:
    """Interpolate all levels to the size of the image, then follow the paper word by word."""
    noise = np.random.default_rng(3)
    width, height = 50, 41  # of an image that was continued to 64 x 64
    levels = [
        noise.standard_normal((16, 64 // n, 64 // n)).astype(np.float32) for n in (1, 2, 8, 32)
    ]
    weights = random_weights()
    inference = saved(aliked_model(weights), tmp_path)
    extractor = AlikedExtractor(inference, 10)
    head = extractor._head
    xy = np.array([[20.3, 17.6], [0.4, 0.2], [48.9, 39.7], [2.0, 30.5]])
    found = describe(tuple(levels), (width, height), xy, head)

    maps = []
    for level in levels:
        rows = np.arange(64) * (level.shape[1] - 1) / 63
        maps.append(np.array([[at(level, x, y) for x in rows] for y in rows]).transpose(2, 0, 1))
    features = np.concatenate(maps)
    features /= np.linalg.norm(features, axis=0)
    features = features[:, :height, :width]
    named = dict(zip(HEAD, head, strict=True))
    for (x, y), descriptor in zip(xy, found, strict=True):
        left, top = min(max(int(x) - 1, 0), width - 4), min(max(int(y) - 1, 0), height - 4)
        patch = features[:, top : top + 3, left : left + 3]
        hidden = selu(np.tensordot(named["head1"], patch, 3) + named["bias1"])
        move = named["head2"][:, :, 0, 0] @ hidden + named["bias2"]
        move = move.clip(-width / 4, width / 4).reshape(2, 16)
        total = np.zeros(DIM)
        for n in range(16):
            sample = at(features, x + move[0, n], y + move[1, n])
            total += selu(named["single"][:, :, 0, 0] @ sample) @ named["mixing"][n]
        np.testing.assert_allclose(descriptor, total / np.linalg.norm(total), atol=1e-4)


def selu(x: Floats32) -> Floats32:
    return np.where(x > 0, 1.0507009873554805 * x, 1.7580993408473766 * (np.exp(x) - 1))


def test_the_score_head_may_be_moved_before_the_interpolation(tmp_path: Path) -> None:
    """The score from the four levels by a plain computation of the head of the paper."""
    weights = random_weights(1)
    image = textured((64, 96)).astype(np.float32)[None, None] / 255
    inference = saved(aliked_model(weights), tmp_path)
    score, *levels = inference.run({"image": image}, ALIKED_OUTPUTS)[: -len(HEAD)]
    rows, columns = np.arange(64), np.arange(96)
    maps = []
    for level in levels:
        _, _, h, w = level.shape
        x = (columns * (w - 1) / 95).astype(np.float32)
        y = (rows * (h - 1) / 63).astype(np.float32)
        at_x, at_y = np.meshgrid(x, y)
        maps += [cv2.remap(c, at_x, at_y, cv2.INTER_LINEAR) for c in level[0]]
    value = np.tensordot(weights["score_head.0.weight"][:, :, 0, 0], np.array(maps), 1)
    for layer in (2, 4, 6):
        kernel, value = weights[f"score_head.{layer}.weight"], selu(value)
        value = np.array(
            [
                sum(
                    cv2.filter2D(v.astype(np.float32), -1, k, borderType=cv2.BORDER_CONSTANT)
                    for v, k in zip(value, each, strict=True)
                )
                for each in kernel
            ]
        )
    # cv2.remap rounds positions to 1/32 of a pixel
    np.testing.assert_allclose(score[0, 0], 1 / (1 + np.exp(-value[0])), atol=0.02)


@pytest.mark.parametrize("backend", BACKENDS)
def test_images_of_any_size_and_masks(backend: str, tmp_path: Path) -> None:
    require_backend(backend)
    extractor = AlikedExtractor(saved(aliked_model(random_weights()), tmp_path, backend), 40)
    # The soft-argmax is limited to the square of the maximum.
    check_extractor(extractor, DIM, min_side=33, max_beyond_mask_px=2)


@pytest.fixture(scope="module")
def expected_features(
    synthetic_stereo: Path,
) -> list[tuple[Bytes, Floats32, Floats32, Floats32]]:
    """Ten images with the keypoints, descriptors and scores of a file that torch has exported."""
    require_backend("onnxruntime")
    theirs = load(exported("aliked-t16.onnx"), "onnxruntime")
    expected = []
    for image in ten_images(synthetic_stereo):
        height, width = image.shape
        given = np.repeat(image[None, None].astype(np.float32) / 255, 3, axis=1)
        names = ["keypoints", "descriptors", "scores"]
        keypoints, descriptors, scores = theirs.run({"image": given}, names)
        xy = (keypoints / 2 + 0.5) * [width - 1, height - 1]
        expected.append((image, xy, descriptors, scores))
    return expected


@pytest.mark.parametrize("backend", BACKENDS)
def test_our_graph_gives_the_features_of_the_authors(
    backend: str, expected_features: list[tuple[Bytes, Floats32, Floats32, Floats32]]
) -> None:
    """The authors' weights, in our graph, against a file that torch has exported."""
    extractor = AlikedExtractor(load(fetched("aliked-t16"), backend), 1024)  # type: ignore[arg-type]
    for image, expected, descriptors, scores in expected_features:
        found = extractor.extract(image)
        distance = np.linalg.norm(found.xy[:, None] - expected[None], axis=2)
        row, nearest = distance.argmin(axis=0), distance.min(axis=0)
        same = nearest < 1e-3
        # Of points with nearly equal scores, the 1024th may be another one.
        assert same.mean() > 0.99
        assert len(set(row[same])) == same.sum()
        assert nearest[same].max() < 2e-4
        np.testing.assert_allclose(found.response[row[same]], scores[same], atol=1e-4)
        # The patch around a position changes where the position passes a whole number.
        same &= (np.abs(expected - np.rint(expected)) > 2e-4).all(axis=1)
        assert same.mean() > 0.98
        np.testing.assert_allclose(found.descriptor[row[same]], descriptors[same], atol=1e-4)
