"""SuperPoint: its network as an ONNX graph, and features from its outputs.

Source: DeTone et al., "SuperPoint: self-supervised interest point detection and description", CVPR
workshops 2018; thresholds and suppression as in SuperGlue (Sarlin et al., CVPR 2020), with which
the matchers were trained.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Bytes, Floats, Floats32, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.graph import GraphBuilder, Tensor
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

if TYPE_CHECKING:
    from onnx import ModelProto

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


_CELL = 8  # pixels of the image a side for each cell
SUPERPOINT_OUTPUTS = ("score", "descriptors")


def superpoint_model(weights: dict[str, Tensor]) -> ModelProto:
    """The model, from the weights by their names in the authors' file `superpoint_v1.pth`.

    Input `image`: (1, 1, H, W) grey, H and W multiples of 8. Outputs: `score` (1, 1, H, W)
    probability of a keypoint at each pixel, `descriptors` (1, D, H/8, W/8) of unit length.

    Raises:
        KeyError: a weight is missing.

    Source: the paper, section 3 and figure 3.
    """
    graph = GraphBuilder(weights)
    x = "image"
    for block in range(1, 5):
        if block > 1:
            x = graph.node("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2])
        for part in "ab":
            x = graph.node("Relu", _convolution(graph, f"conv{block}{part}", x))
    cells = _head(graph, "P", x)
    # The last of the 65 channels stands for cells without a keypoint.
    probability = graph.node("Softmax", cells, axis=1)
    first, end, axis = (graph.constant([n], np.int64) for n in (0, _CELL * _CELL, 1))
    probability = graph.node("Slice", probability, first, end, axis)
    score = graph.node("DepthToSpace", probability, blocksize=_CELL)
    descriptors = graph.node("LpNormalization", _head(graph, "D", x), axis=1, p=2)
    width = graph.weight("convDb.weight").shape[0]
    outputs: dict[str, tuple[str, tuple[int | str, ...]]] = {
        "score": (score, (1, 1, "H", "W")),
        "descriptors": (descriptors, (1, width, "h", "w")),
    }
    return graph.model({"image": (1, 1, "H", "W")}, outputs, "superpoint")


def _head(graph: GraphBuilder, name: str, x: str) -> str:
    """Two convolutions: `P` finds keypoints, `D` describes."""
    x = graph.node("Relu", _convolution(graph, f"conv{name}a", x))
    return _convolution(graph, f"conv{name}b", x)


def _convolution(graph: GraphBuilder, name: str, x: str) -> str:
    weight = graph.weight(f"{name}.weight")
    bias = graph.weight(f"{name}.bias")
    return graph.convolution(x, weight, bias, padding=weight.shape[2] // 2)
