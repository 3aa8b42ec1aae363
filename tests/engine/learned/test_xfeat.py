"""XFeat: the graph, and keypoints and descriptors from its outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from learned_cases import BACKENDS, exported, fetched, require_backend, ten_images, textured

from vo.base.types import Floats32
from vo.engine.learned.inference import load
from vo.engine.learned.maps import bicubic, bilinear, to_cells
from vo.engine.learned.xfeat import XFEAT_OUTPUTS, XFeatExtractor, maxima, peak_offsets


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


def test_maxima_are_those_of_five_by_five_above_the_threshold() -> None:
    heat = np.zeros((20, 20), np.float32)
    heat[5, 5], heat[5, 7], heat[12, 12], heat[0, 19], heat[18, 3] = 0.9, 0.8, 0.3, 0.2, 0.04
    v, u = maxima(heat)
    assert sorted(zip(v.tolist(), u.tolist(), strict=True)) == [(0, 19), (5, 5), (12, 12)]


def test_peaks_are_found_between_pixels() -> None:
    """A Gaussian's logarithm is a parabola: its peak is found exactly."""
    v, u = np.mgrid[:30, :40]
    heat = np.exp(-((u - 17.3) ** 2 + (v - 11.8) ** 2) / 4.0).astype(np.float32)
    offset = peak_offsets(heat, np.array([12]), np.array([17]))
    np.testing.assert_allclose(offset, [[0.3, -0.2]], atol=1e-3)
    np.testing.assert_array_equal(peak_offsets(heat, np.array([0]), np.array([0])), [[0, 0]])


class OnePeak:
    """Stands for the network: one keypoint, and descriptors that name their cell."""

    description = "a test"

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
