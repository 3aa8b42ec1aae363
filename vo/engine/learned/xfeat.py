"""XFeat features: keypoints and descriptors from the outputs of the network.

Source: Potje et al., "XFeat: accelerated features for lightweight image matching", CVPR 2024.
"""

from __future__ import annotations

from concurrent.futures import Executor

import cv2
import numpy as np

from vo.base.types import Bytes, Floats, Floats32, Ints, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    MIN_SIDE_OF_32,
    bicubic,
    bilinear,
    learned_keypoints,
    masked,
    network_input,
    no_keypoints,
    parabola_offsets,
    to_cells,
)
from vo.engine.learned.xfeat_graph import XFEAT_OUTPUTS

_MULTIPLE = 32  # of both sides of the network's input
_MIN_HEAT = 0.05
_SUPPRESSION_PX = 5  # side of the square in which a keypoint is the maximum
_WIDTH = 64


class XFeatExtractor:
    """Detects and describes XFeat features, strongest first."""

    descriptor_format = DescriptorFormat(_WIDTH, np.dtype(np.float32))
    scale_factor = 1.0
    suits_mutual_matching = (
        True  # trained for it; a ratio test drops two fifths of the right matches
    )

    def __init__(self, inference: Inference, count: int) -> None:
        self._inference = inference
        self._count = count

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        return self.extract_and_describe(image, np.empty((0, 2)), mask)[0]

    def extract_and_describe(
        self, image: Bytes, xy: Floats, mask: Bytes | None = None
    ) -> tuple[Keypoints, Keypoints]:
        """Features of an image, and given pixels (N, 2) of it as features."""
        if min(image.shape) < MIN_SIDE_OF_32:
            unknown = learned_keypoints(xy, np.zeros(len(xy)), np.zeros((len(xy), _WIDTH)))
            return no_keypoints(_WIDTH), unknown
        given = network_input(image, _MULTIPLE)
        features, heat, reliability = self._inference.run({"image": given}, XFEAT_OUTPUTS)
        height, width = image.shape
        # Before the search for maxima, so that results with masks keep their bits; other networks'
        # maxima are masked after it, so that no slope at the edge of a mask counts as one.
        heat = masked(heat[0, 0, :height, :width], mask)
        v, u = maxima(heat)
        found = np.stack([u, v], axis=1) + peak_offsets(heat, v, u)
        score = heat[v, u] * bilinear(reliability[0, 0], to_cells(found))
        order = np.lexsort((u, v, -score))[: self._count]
        found, score = found[order], score[order]
        return (
            learned_keypoints(found, score, bicubic(features[0], to_cells(found))),
            learned_keypoints(xy, np.zeros(len(xy)), bicubic(features[0], to_cells(xy))),
        )


def maxima(heat: Floats32) -> tuple[Ints, Ints]:
    """Rows and columns of the pixels that are the maximum of the 5 x 5 around them."""
    kernel = np.ones((_SUPPRESSION_PX, _SUPPRESSION_PX), np.uint8)
    highest = cv2.dilate(heat, kernel)
    v, u = np.nonzero((heat == highest) & (heat > _MIN_HEAT))
    return v, u


def peak_offsets(heat: Floats32, v: Ints, u: Ints) -> Floats:
    """(N, 2) x, y from maxima to the vertices of parabolas through them and their neighbours.

    Of the logarithm, whose peaks are nearly parabolas; at most half a pixel, 0 at the border.
    """
    log = np.log(np.maximum(heat, 1e-6)).astype(np.float64)
    return parabola_offsets(log, v, u)
