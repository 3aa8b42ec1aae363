"""DISK as an ONNX graph.

Source: Tyszkiewicz et al., "DISK: learning local features with policy gradient", NeurIPS 2020,
section 3 and appendix; a U-Net (Ronneberger et al. 2015) of single convolutions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.engine.learned.graph import GraphBuilder
from vo.engine.learned.torch_archive import Tensor

if TYPE_CHECKING:
    from onnx import ModelProto

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
