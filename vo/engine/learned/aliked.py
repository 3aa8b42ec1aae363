"""ALIKED features: keypoints and descriptors from the outputs of the network.

Source: Zhao et al., "ALIKED: a lighter keypoint and descriptor extraction network via deformable
transformation", IEEE Transactions on Instrumentation and Measurement 2023.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bytes, Floats, Floats32, Ints, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.aliked_graph import ALIKED_OUTPUTS, HEAD, POSITIONS
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    MIN_SIDE_OF_32,
    bilinear,
    masked,
    network_input,
    no_keypoints,
    strongest,
    unit_keypoints,
    without_border,
    without_neighbours,
)

_MULTIPLE = 32  # of both sides of the network's input
_RADIUS = 2  # of the square in which a keypoint is the maximum, and is found between pixels
_TEMPERATURE = 0.1  # of the soft-argmax
_SELU_ALPHA, _SELU_SCALE = 1.6732632423543772, 1.0507009873554805


class AlikedExtractor:
    """Detects and describes ALIKED features, strongest first."""

    scale_factor = 1.0
    suits_mutual_matching = True

    def __init__(self, inference: Inference, count: int) -> None:
        self._inference = inference
        self._count = count
        blank = np.zeros((1, 1, 2 * _MULTIPLE, 2 * _MULTIPLE), np.float32)
        self._head = inference.run({"image": blank}, ALIKED_OUTPUTS)[-len(HEAD) :]
        self.descriptor_format = DescriptorFormat(self._head[-1].shape[-1], np.dtype(np.float32))

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        if min(image.shape) < MIN_SIDE_OF_32:
            return no_keypoints(self.descriptor_format.width)
        given = network_input(image, _MULTIPLE)
        score, *levels = self._inference.run({"image": given}, ALIKED_OUTPUTS)[: -len(HEAD)]
        height, width = image.shape
        score = np.ascontiguousarray(score[0, 0, :height, :width])
        peaks = without_border(without_neighbours(score, _RADIUS), _RADIUS)
        v, u = strongest(masked(peaks, mask), self._count)
        xy = np.stack([u, v], axis=1) + soft_argmax_offsets(score, v, u)
        strength = bilinear(score, xy)
        order = np.lexsort((u, v, -strength))
        xy, strength = xy[order], strength[order]
        maps = tuple(np.ascontiguousarray(level[0]) for level in levels)
        return unit_keypoints(xy, strength, describe(maps, (width, height), xy, self._head))


def soft_argmax_offsets(score: Floats32, v: Ints, u: Ints) -> Floats:
    """(N, 2) x, y from maxima to the means of the 5 x 5 around them, weighted by exp(score / T).

    Source: Zhao et al., "ALIKE: accurate and lightweight keypoint detection and descriptor
    extraction", IEEE Transactions on Multimedia 2022, equations 3 and 4.
    """
    steps = np.arange(-_RADIUS, _RADIUS + 1)
    rows, columns = v[:, None, None] + steps[:, None], u[:, None, None] + steps
    around = score[rows, columns].astype(np.float64)
    weight = np.exp((around - around.max(axis=(1, 2), keepdims=True)) / _TEMPERATURE)
    total = weight.sum(axis=(1, 2))
    x = (weight.sum(axis=1) * steps).sum(axis=1) / total
    y = (weight.sum(axis=2) * steps).sum(axis=1) / total
    return np.stack([x, y], axis=1)


def describe(
    levels: tuple[Floats32, ...], size: tuple[int, int], xy: Floats, head: list[Floats32]
) -> Floats32:
    """(N, D) descriptors of unit length: features at positions that the network chooses (SDDH).

    Args:
        levels: four maps (C, h, w).
        size: width and height of the image without padding, pixels.
        xy: (N, 2) pixels.
        head: weights, see `vo.engine.learned.aliked_graph.HEAD`.
    """
    first, first_bias, second, second_bias, single, mixing = head
    if len(xy) == 0:
        return np.empty((0, mixing.shape[-1]), np.float32)
    width, height = size
    patch = _patches(levels, xy, width, height).reshape(len(xy), -1)
    hidden = _selu(patch @ first.reshape(len(first), -1).T + first_bias)
    move = hidden @ second.reshape(len(second), -1).T + second_bias
    limit = np.float32(max(width, height) / 4.0)
    move = np.clip(move, -limit, limit).reshape(len(xy), 2, POSITIONS).transpose(0, 2, 1)
    at = (xy[:, None, :] + move).reshape(-1, 2)
    taken = _features_between(levels, at, width, height)
    taken = _selu(taken @ single.reshape(len(single), -1).T)
    mixed = taken.reshape(len(xy), -1) @ mixing.reshape(-1, mixing.shape[-1])
    length = np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)
    return np.asarray(mixed / length, dtype=np.float32)


def _selu(x: Floats32) -> Floats32:
    """Scaled exponential linear unit (Klambauer et al. 2017)."""
    negative = _SELU_ALPHA * np.expm1(np.minimum(x, 0.0))
    return np.asarray(_SELU_SCALE * (np.maximum(x, 0.0) + negative), dtype=np.float32)


@compiled
def _features_at(levels, x, y, result):  # type: ignore[no-untyped-def]
    """Features (4 C) of a pixel: those of the levels, interpolated to it, as a unit vector."""
    level1, level2, level3, level4 = levels
    channels, height, width = level1.shape
    squared = 0.0
    for c in range(channels):
        value = level1[c, y, x]
        result[c] = value
        squared += value * value
    start = channels
    for level in (level2, level3, level4):
        _, rows, columns = level.shape
        # corner pixels aligned
        fx = x * (columns - 1) / (width - 1)
        fy = y * (rows - 1) / (height - 1)
        left, top = min(int(fx), max(columns - 2, 0)), min(int(fy), max(rows - 2, 0))
        right, bottom = min(left + 1, columns - 1), min(top + 1, rows - 1)
        a, b = fx - left, fy - top
        for c in range(channels):
            upper = level[c, top, left] * (1.0 - a) + level[c, top, right] * a
            lower = level[c, bottom, left] * (1.0 - a) + level[c, bottom, right] * a
            value = upper * (1.0 - b) + lower * b
            result[start + c] = value
            squared += value * value
        start += channels
    length = max(np.sqrt(squared), 1e-12)
    for c in range(start):
        result[c] /= length


@compiled
def _patches(levels, xy, width, height):  # type: ignore[no-untyped-def]
    """(N, 4 C, 3, 3) features of the pixels around each position (N, 2), inside of the image."""
    count = 4 * levels[0].shape[0]
    result = np.empty((len(xy), count, 3, 3), dtype=np.float32)
    one = np.empty(count)
    for n in range(len(xy)):
        left = min(max(int(xy[n, 0]) - 1, 0), width - 4)
        top = min(max(int(xy[n, 1]) - 1, 0), height - 4)
        for j in range(3):
            for i in range(3):
                _features_at(levels, left + i, top + j, one)
                for c in range(count):
                    result[n, c, j, i] = one[c]
    return result


@compiled
def _features_between(levels, at, width, height):  # type: ignore[no-untyped-def]
    """(N, 4 C) features at positions (N, 2) between pixels, bilinear, 0 outside of the image."""
    count = 4 * levels[0].shape[0]
    result = np.zeros((len(at), count), dtype=np.float32)
    one = np.empty(count)
    for n in range(len(at)):
        left, top = int(np.floor(at[n, 0])), int(np.floor(at[n, 1]))
        a, b = at[n, 0] - left, at[n, 1] - top
        for j in range(2):
            for i in range(2):
                x, y = left + i, top + j
                if x < 0 or y < 0 or x >= width or y >= height:
                    continue
                weight = (a if i else 1.0 - a) * (b if j else 1.0 - b)
                _features_at(levels, x, y, one)
                for c in range(count):
                    result[n, c] += weight * one[c]
    return result
