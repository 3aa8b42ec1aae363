"""XFeat: the graph, and keypoints and descriptors from its outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from learned_cases import BACKENDS, exported, fetched, require_backend, ten_images, textured

from vo.base.types import Floats32
from vo.engine.learned.inference import load
from vo.engine.learned.maps import bicubic, bilinear, masked, parabola_offsets, to_cells
from vo.engine.learned.xfeat import XFEAT_OUTPUTS, XFeatExtractor, ranked_peaks


def test_cells_of_pixels() -> None:
    """The first cell covers pixels 0 to 7: its centre is at 3.5."""
    xy = np.array([[3.5, 3.5], [11.5, 3.5], [0.0, 7.5]])
    np.testing.assert_allclose(to_cells(xy), [[0, 0], [1, 0], [-0.4375, 0.5]])


def test_bilinear_interpolation() -> None:
    values = np.array([[0, 10, 20], [100, 110, 120]], np.float32)
    at = np.array([[0, 0], [0.5, 0], [2, 1], [1.25, 0.5], [-3, -3], [9, 9]])
    np.testing.assert_allclose(bilinear(values, at), [0, 5, 120, 62.5, 0, 120])


def test_bicubic_interpolation() -> None:
    """At whole positions the values themselves; at half ones (-3, 19, 19, -3) / 32."""
    values = np.arange(64, dtype=np.float32).reshape(1, 8, 8) ** 1.5
    at = np.array([[3.0, 4.0], [3.5, 4.0]])
    row = values[0, 4, 2:6].astype(np.float64)
    expected = [values[0, 4, 3], row @ np.array([-3, 19, 19, -3]) / 32]
    np.testing.assert_allclose(bicubic(values, at)[:, 0], expected, rtol=1e-6)
    np.testing.assert_array_equal(bicubic(values, np.array([[-5.0, 3.0], [3.0, 20.0]])), 0)


CERTAIN = np.ones((8, 8), np.float32)


def test_peaks_are_maxima_of_five_by_five_above_the_threshold() -> None:
    heat = np.zeros((20, 20), np.float32)
    heat[5, 5], heat[5, 7], heat[12, 12], heat[0, 19], heat[18, 3] = 0.9, 0.8, 0.3, 0.2, 0.04
    xy, score = ranked_peaks(heat, (20, 20), None, CERTAIN, 9)
    np.testing.assert_array_equal(xy, [[5, 5], [12, 12], [19, 0]])
    np.testing.assert_allclose(score, [0.9, 0.3, 0.2], rtol=1e-6)
    xy, _ = ranked_peaks(heat, (20, 12), None, CERTAIN, 9)
    np.testing.assert_array_equal(xy, [[5, 5]])  # the others lie in the continuation
    assert len(ranked_peaks(heat, (20, 20), None, CERTAIN, 2)[0]) == 2


def test_a_plateau_has_as_many_peaks_as_pixels() -> None:
    xy, _ = ranked_peaks(np.full((9, 7), 0.5, np.float32), (9, 7), None, CERTAIN, 100)
    assert len(np.unique(xy, axis=0)) == 63


def test_peaks_are_found_between_pixels() -> None:
    """A Gaussian's logarithm is a parabola: its peak is found exactly."""
    v, u = np.mgrid[:30, :40]
    heat = np.exp(-((u - 17.3) ** 2 + (v - 11.8) ** 2) / 4.0).astype(np.float32)
    xy, _ = ranked_peaks(heat, heat.shape, None, CERTAIN, 1)
    np.testing.assert_allclose(xy, [[17.3, 11.8]], atol=1e-3)
    edge = np.exp(-(u**2 + v**2) / 4.0).astype(np.float32)
    np.testing.assert_array_equal(ranked_peaks(edge, edge.shape, None, CERTAIN, 1)[0], [[0, 0]])


def test_peaks_are_those_of_plain_numpy() -> None:
    """Places and scores bit by bit, with and without a mask and a continuation."""
    noise = np.random.default_rng(2)
    heat = cv2.GaussianBlur(noise.random((96, 128), dtype=np.float32), (0, 0), 1.2)
    heat = np.maximum(heat - 0.45, 0).astype(np.float32)
    reliability = noise.random((12, 16), dtype=np.float32)
    some = (noise.random((96, 128)) > 0.1).astype(np.uint8)
    for shape, mask in (((96, 128), None), ((96, 128), some), ((90, 121), None)):
        inside = masked(heat[: shape[0], : shape[1]], mask)
        is_peak = (inside == cv2.dilate(inside, np.ones((5, 5)))) & (inside > np.float32(0.05))
        v, u = np.nonzero(is_peak)
        logarithm = np.log(np.maximum(inside, 1e-6))
        xy = np.stack([u, v], axis=1) + parabola_offsets(logarithm, v, u)
        score = inside[v, u] * bilinear(reliability, to_cells(xy))
        order = np.lexsort((u, v, -score))[:50]
        found = ranked_peaks(heat, shape, mask, reliability, 50)
        assert len(u) > 100
        np.testing.assert_array_equal(found[0], xy[order])
        np.testing.assert_array_equal(found[1], score[order])


class OnePeak:
    """Stands for the network: one keypoint, and descriptors that name their cell."""

    description = "a test"
    is_rewritten = False

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        _, _, height, width = inputs["image"].shape
        assert (height % 32, width % 32) == (0, 0)
        assert 0 <= inputs["image"].min() <= inputs["image"].max() <= 1
        heat = np.zeros((1, 1, height, width), np.float32)
        heat[0, 0, 19, 27], heat[0, 0, 19, width - 1] = 0.5, 0.9
        feats = np.zeros((1, 64, height // 8, width // 8), np.float32)
        feats[0, 0], feats[0, 1] = np.mgrid[: height // 8, : width // 8].astype(np.float32)
        reliability = np.full((1, 1, height // 8, width // 8), 0.5, np.float32)
        return [{"feats": feats, "heat": heat, "rel": reliability}[name] for name in outputs]


def test_images_of_any_size_are_continued_not_scaled() -> None:
    image = np.full((50, 70), 128, np.uint8)
    found = XFeatExtractor(OnePeak(), 100).extract(image)
    np.testing.assert_allclose(found.xy, [[27, 19]])  # the other one lies in the continuation
    assert found.response.tolist() == [0.25]
    assert np.linalg.norm(found.descriptor[0]) == pytest.approx(1.0, abs=1e-6)
    ratio = float(found.descriptor[0, 1] / found.descriptor[0, 0])
    assert ratio == pytest.approx((27.5 / 8 - 0.5) / (19.5 / 8 - 0.5), rel=1e-2)
    mask = np.zeros_like(image)
    assert len(XFeatExtractor(OnePeak(), 100).extract(image, mask)) == 0
    assert len(XFeatExtractor(OnePeak(), 100).extract(image[:32])) == 0


@pytest.mark.parametrize("shape", [(33, 34), (33, 70), (70, 33)])
def test_the_smallest_images_give_the_same_in_both_backends(shape: tuple[int, int]) -> None:
    """Whatever size the network had before: OpenCV is wrong for a single row of cells."""
    require_backend("onnxruntime")
    opencv, runtime = (XFeatExtractor(load(fetched("xfeat"), b), 100) for b in BACKENDS)  # type: ignore[arg-type]
    opencv.extract(textured((64, 96)))
    expected = runtime.extract(textured(shape))
    assert len(expected) > 5
    for _ in range(2):
        found = opencv.extract(textured(shape))
        np.testing.assert_allclose(found.xy, expected.xy, atol=1e-3)
        np.testing.assert_allclose(found.descriptor, expected.descriptor, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_our_graph_gives_the_outputs_of_the_authors(backend: str, synthetic_stereo: Path) -> None:
    """The authors' weights, in our graph, against a file that torch has exported."""
    require_backend(backend)
    ours, theirs = (load(each, backend) for each in (fetched("xfeat"), exported("xfeat.onnx")))  # type: ignore[arg-type]
    for image in ten_images(synthetic_stereo):
        given = {"image": image[None, None].astype(np.float32) / 255}
        both = ours.run(given, XFEAT_OUTPUTS), theirs.run(given, XFEAT_OUTPUTS)
        for a, b in zip(*both, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-4)
