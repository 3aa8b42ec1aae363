"""SuperPoint features: keypoints and descriptors from the outputs of the network.

Source: DeTone et al., "SuperPoint: self-supervised interest point detection and description", CVPR
workshops 2018; thresholds and suppression as in SuperGlue (Sarlin et al., CVPR 2020), with which
the matchers were trained.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from vo.base.types import Bytes, Floats, Floats32, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    bilinear,
    learned_keypoints,
    masked,
    network_input,
    no_keypoints,
    strongest,
    without_border,
    without_neighbours,
)
from vo.engine.learned.superpoint_graph import SUPERPOINT_OUTPUTS

_MULTIPLE = 8  # of both sides of the network's input
_MIN_SIDE = 16  # two cells, between which descriptors are interpolated
_RADIUS = 4  # of the square in which a keypoint is the maximum
_BORDER = 4  # pixels at the edges of the image without keypoints
_MIN_SCORE = 0.005


class SuperPointExtractor:
    """Detects and describes SuperPoint features, strongest first."""

    scale_factor = 1.0
    suits_mutual_matching = True

    def __init__(self, inference: Inference, count: int) -> None:
        self._inference = inference
        self._count = count
        blank = np.zeros((1, 1, _MIN_SIDE, _MIN_SIDE), np.float32)
        width = inference.run({"image": blank}, SUPERPOINT_OUTPUTS)[1].shape[1]
        self.descriptor_format = DescriptorFormat(width, np.dtype(np.float32))

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        if min(image.shape) < _MIN_SIDE:
            return no_keypoints(self.descriptor_format.width)
        given = network_input(image, _MULTIPLE)
        score, cells = self._inference.run({"image": given}, SUPERPOINT_OUTPUTS)
        height, width = image.shape
        score = np.ascontiguousarray(score[0, 0, :height, :width])
        peaks = without_border(without_neighbours(score, _RADIUS), _BORDER)
        peaks = np.where(peaks > _MIN_SCORE, peaks, np.float32(0.0))
        v, u = strongest(masked(peaks, mask), self._count)
        xy = np.stack([u, v], axis=1).astype(np.float64)
        return learned_keypoints(xy, score[v, u], described_at(cells[0], xy))


def described_at(cells: Floats32, xy: Floats) -> Floats:
    """(N, D) descriptors at pixels (N, 2), bilinear between the cells (D, h, w) around them.

    The authors' code stretches the cells a little: 3.5, the centre of the first cell, is 0, and the
    last pixel, half a cell past the centre of the last cell, is this cell.
    """
    _, rows, columns = cells.shape
    count = np.array([columns, rows])
    at = (xy - (_MULTIPLE - 1) / 2) * (count - 1) / (_MULTIPLE * count - _MULTIPLE / 2 - 0.5)
    return bilinear(cells, at).T
