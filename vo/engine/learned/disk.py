"""DISK features: keypoints and descriptors from the outputs of the network.

Source: Tyszkiewicz et al., "DISK: learning local features with policy gradient", NeurIPS 2020.
"""

from __future__ import annotations

from concurrent.futures import Executor

import cv2
import numpy as np

from vo.base.types import Bytes, Floats32, Ints, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.disk_graph import DISK_OUTPUTS
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    learned_keypoints,
    masked,
    network_input,
    no_keypoints,
    parabola_offsets,
    strongest,
)

_MULTIPLE = 16  # of both sides of the network's input
_MIN_SIDE = 32  # two pixels in the lowest layer, which instance normalisation needs
_SUPPRESSION_PX = 5  # side of the square in which a keypoint is the maximum
_MIN_HEAT = 0.0


class DiskExtractor:
    """Detects and describes DISK features, strongest first."""

    scale_factor = 1.0
    suits_mutual_matching = True

    def __init__(self, inference: Inference, count: int) -> None:
        self._inference = inference
        self._count = count
        blank = np.zeros((1, 1, _MIN_SIDE, _MIN_SIDE), np.float32)
        width = inference.run({"image": blank}, DISK_OUTPUTS)[-1].size
        self.descriptor_format = DescriptorFormat(width, np.dtype(np.float32))

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        if min(image.shape) < _MIN_SIDE:
            return no_keypoints(self.descriptor_format.width)
        given = network_input(image, _MULTIPLE)
        heat, features, weight, bias = self._inference.run({"image": given}, DISK_OUTPUTS)
        height, width = image.shape
        inner = np.ascontiguousarray(heat[0, 0, :height, :width])
        highest = cv2.dilate(inner, np.ones((_SUPPRESSION_PX,) * 2, np.uint8))
        peaks = np.where((inner == highest) & (inner > _MIN_HEAT), inner, np.float32(0.0))
        v, u = strongest(masked(peaks, mask), self._count)
        xy = np.stack([u, v], axis=1) + parabola_offsets(inner, v, u)
        described = convolved_at(features[0], weight, bias.reshape(-1), v, u)
        return learned_keypoints(xy, inner[v, u], described)


def convolved_at(x: Floats32, weight: Floats32, bias: Floats32, v: Ints, u: Ints) -> Floats32:
    """(N, D) values of a convolution at some pixels, 0 outside of the map.

    Args:
        x: the map (C, H, W).
        weight: (D, C, k, k).
        bias: (D,).
        v: (N,) rows.
        u: (N,) columns.
    """
    side = weight.shape[-1]
    padded = np.pad(x, ((0, 0), (side // 2,) * 2, (side // 2,) * 2))
    result = np.repeat(bias[None], len(v), axis=0).astype(np.float32)
    for j in range(side):
        for i in range(side):
            result += padded[:, v + j, u + i].T @ weight[:, :, j, i].T
    return result
