"""DISK: its network as an ONNX graph, and features from its outputs.

Source: Tyszkiewicz et al., "DISK: learning local features with policy gradient", NeurIPS 2020.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import TYPE_CHECKING

import cv2
import numpy as np

from vo.base.types import Bytes, Floats32, Ints, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.graph import GraphBuilder, Tensor
from vo.engine.learned.inference import Inference
from vo.engine.learned.maps import (
    learned_keypoints,
    masked,
    network_input,
    no_keypoints,
    parabola_offsets,
    strongest,
)

if TYPE_CHECKING:
    from onnx import ModelProto

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


_EPSILON = 1e-5  # of torch's instance normalisation
DISK_OUTPUTS = ("heat", "features", "weight", "bias")


def disk_model(weights: dict[str, Tensor]) -> ModelProto:
    """The model, from the weights by their names in the authors' file.

    Input `image`: (1, 1, H, W) grey, H and W multiples of 16 (the network takes colours; those of
    a grey image are equal, so the first convolution has their sum). Outputs: `heat` (1, 1, H, W)
    logarithms of probabilities, up to a term; `features` (1, C, H, W), and `weight` (D, C, 5, 5)
    and `bias` (D,) of the convolution that makes descriptors of them: computed at the keypoints
    only, it takes a small part of the time.

    Raises:
        KeyError: a weight is missing.

    Source: the paper, section 3 and appendix; a U-Net (Ronneberger et al. 2015) of single
        convolutions.
    """
    graph = GraphBuilder(weights)
    down, up = (_count(weights, f"extractor.unet.path_{way}") for way in ("down", "up"))
    weight, bias = _layer(graph, "extractor.unet.path_down.0.1")
    grey = weight.sum(axis=1, keepdims=True, dtype=np.float32)
    levels = [_convolution(graph, "image", grey, bias)]
    for n in range(1, down):
        name = f"extractor.unet.path_down.{n}.1"
        x = graph.node("AveragePool", levels[-1], kernel_shape=[2, 2], strides=[2, 2])
        levels.append(_convolution(graph, _gate(graph, name, x), *_layer(graph, name)))
    x = levels.pop()
    for n in range(up):
        name = f"extractor.unet.path_up.{n}.conv"
        x = _gate(graph, name, graph.node("Concat", _doubled(graph, x), levels.pop(), axis=1))
        if n < up - 1:
            x = _convolution(graph, x, *_layer(graph, name))
    weight, bias = _layer(graph, f"extractor.unet.path_up.{up - 1}.conv")
    heat = _convolution(graph, x, weight[-1:], bias[-1:])
    outputs: dict[str, tuple[str, tuple[int | str, ...]]] = {
        "heat": (heat, (1, 1, "H", "W")),
        "features": (x, (1, weight.shape[1], "H", "W")),
        "weight": (graph.constant(weight[:-1]), weight[:-1].shape),
        "bias": (graph.constant(bias[:-1]), bias[:-1].shape),
    }
    return graph.model({"image": (1, 1, "H", "W")}, outputs, "disk")


def _count(weights: dict[str, Tensor], prefix: str) -> int:
    """Blocks of one of the two ways through the network."""
    found = {n[len(prefix) + 1 :].split(".")[0] for n in weights if n.startswith(f"{prefix}.")}
    if not found:
        raise KeyError(prefix)
    return len(found)


def _layer(graph: GraphBuilder, name: str) -> tuple[Tensor, Tensor]:
    return graph.weight(f"{name}.3.weight"), graph.weight(f"{name}.3.bias")


def _convolution(graph: GraphBuilder, x: str, weight: Tensor, bias: Tensor) -> str:
    return graph.convolution(x, weight, bias, padding=weight.shape[2] // 2)


def _gate(graph: GraphBuilder, name: str, x: str) -> str:
    """Instance normalisation and PReLU."""
    slope = graph.weight(f"{name}.1.weight")
    ones, zeros = np.ones(len(slope)), np.zeros(len(slope))
    x = graph.node(
        "InstanceNormalization",
        x,
        graph.constant(ones),
        graph.constant(zeros),
        epsilon=_EPSILON,
    )
    return graph.node("PRelu", x, graph.constant(slope.reshape(-1, 1, 1)))


def _doubled(graph: GraphBuilder, x: str) -> str:
    """Bilinear interpolation to twice the size, edges of the corner pixels aligned."""
    scales = graph.constant([1.0, 1.0, 2.0, 2.0])
    return graph.node(
        "Resize", x, "", scales, mode="linear", coordinate_transformation_mode="half_pixel"
    )
