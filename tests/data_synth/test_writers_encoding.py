"""Encoding of images in order, a few frames ahead."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from data_synth.records import Shot
from data_synth.writers.encoding import (
    FRAMES_AHEAD,
    encode,
    encoded_shots,
    float_tiff,
    tum_depth_png,
)


def _shots(count: int, taken: list[int]) -> Iterator[Shot]:
    """Large images before small ones, so that the later ones are ready first."""
    rng = np.random.default_rng(3)
    for index in range(count):
        side = 600 if index % 3 == 0 else 8
        taken.append(index)
        image = rng.integers(0, 256, (side, side), dtype=np.uint8)
        yield Shot(index, (image, None if index == 4 else image.T), None)


def _encoding_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("encode")]


def test_encoded_frames_are_complete_and_in_order() -> None:
    shots = list(_shots(9, []))
    encoded = list(encoded_shots(shots, "png"))
    assert [shot.index for shot in encoded] == list(range(9))
    for shot, result in zip(shots, encoded, strict=True):
        for image, data in zip(shot.images, result.data, strict=True):
            if image is None or data is None:
                assert image is None and data is None and shot.index == 4
                continue
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(pixels, image)
    assert not _encoding_threads()


def test_at_most_a_few_frames_are_taken_in_advance() -> None:
    taken: list[int] = []
    for given, _ in enumerate(encoded_shots(_shots(20, taken), "png"), start=1):
        assert len(taken) == min(given + FRAMES_AHEAD, 20)


def test_stopping_early_ends_the_threads() -> None:
    taken: list[int] = []
    encoded = encoded_shots(_shots(20, taken), "png")
    next(encoded)
    assert _encoding_threads()
    encoded.close()
    assert not _encoding_threads()
    assert len(taken) == 1 + FRAMES_AHEAD


def test_errors_of_the_renderer_propagate() -> None:
    def broken() -> Iterator[Shot]:
        yield from _shots(2, [])
        raise RuntimeError("renderer failed")

    with pytest.raises(RuntimeError, match="renderer failed"):
        list(encoded_shots(broken(), "png"))
    assert not _encoding_threads()


def test_lossless_codecs_are_exact_and_jpeg_is_close() -> None:
    waves = 128 + 100 * np.outer(np.sin(np.arange(48) / 5), np.cos(np.arange(64) / 7))
    image = waves.astype(np.uint8)
    raw, png, jpeg = (encode(image, codec) for codec in ("raw", "png", "jpeg"))
    assert raw == image.tobytes()
    assert encode(image[:, ::2], "raw") == image[:, ::2].copy().tobytes()
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), -1), image)
    lossy = cv2.imdecode(np.frombuffer(jpeg, np.uint8), -1)
    assert jpeg[:2] == b"\xff\xd8" and lossy.shape == image.shape
    assert 0 < np.abs(lossy.astype(int) - image).max() <= 4


def test_png_files_of_black_images_are_small() -> None:
    assert len(encode(np.zeros((480, 752), dtype=np.uint8), "png")) < 5000


def test_depth_as_float_is_exact() -> None:
    depth = np.random.default_rng(0).uniform(0.1, 90.0, (20, 30)).astype(np.float32)
    depth[0] = np.inf
    again = cv2.imdecode(np.frombuffer(float_tiff(depth), np.uint8), cv2.IMREAD_UNCHANGED)
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, depth)


def test_tum_depth_has_5000_units_per_metre_and_0_beyond_its_range() -> None:
    depth = np.array([[0.5, 1.00009, 13.107, 13.1072, 500.0, np.inf]], dtype=np.float32)
    again = cv2.imdecode(np.frombuffer(tum_depth_png(depth), np.uint8), cv2.IMREAD_UNCHANGED)
    assert again.dtype == np.uint16
    assert again.tolist() == [[2500, 5000, 65535, 0, 0, 0]]
