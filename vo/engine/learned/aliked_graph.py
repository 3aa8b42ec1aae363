"""ALIKED as an ONNX graph.

Source: Zhao et al., "ALIKED: a lighter keypoint and descriptor extraction network via deformable
transformation", IEEE Transactions on Instrumentation and Measurement 2023, figure 2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.engine.learned.graph import GraphBuilder, Tensor

if TYPE_CHECKING:
    from onnx import ModelProto

POSITIONS = 16  # at which features are sampled for a descriptor
_TAPS = 9  # of a kernel of 3 x 3
SCALES = (1, 2, 8, 32)  # pixels of the image a side for each cell of the four levels
HEAD = ("head1", "bias1", "head2", "bias2", "single", "mixing")
"""Outputs that do not depend on the image: weights of the head that describes keypoints."""
# OpenCV computes either all outputs of a network or none.
ALIKED_OUTPUTS = ("score", *(f"level{n + 1}" for n in range(len(SCALES))), *HEAD)
_HEAD_WEIGHTS = (
    "offset_conv.0.weight",
    "offset_conv.0.bias",
    "offset_conv.2.weight",
    "offset_conv.2.bias",
    "sf_conv.weight",
    "agg_weights",
)


def aliked_model(weights: dict[str, Tensor]) -> ModelProto:
    """The model, from the weights by their names in the authors' file.

    Input `image`: (1, 1, H, W) grey, H and W multiples of 32 (the network takes colours; those of
    a grey image are equal, so the first convolution has their sum). Outputs: `score` (1, 1, H, W),
    and `level1` to `level4` (1, C, H/n, W/n) with n = 1, 2, 8 and 32: interpolated to the size of
    the image and concatenated, these are the features that descriptors are made of (`heads`).

    Raises:
        KeyError: a weight is missing.
    """
    graph = GraphBuilder(weights)
    x = _convolution(graph, "block1", 1, "image", is_grey=True)
    x1 = _selu(graph, _convolution(graph, "block1", 2, _selu(graph, x)))
    x2 = _block(graph, "block2", _pooled(graph, x1, 2))
    x3 = _block(graph, "block3", _pooled(graph, x2, 4), is_deformable=True)
    x4 = _block(graph, "block4", _pooled(graph, x3, 4), is_deformable=True)
    levels = [
        _selu(graph, graph.convolution(x, graph.weight(f"conv{n}.weight"), None))
        for n, x in enumerate((x1, x2, x3, x4), 1)
    ]
    sizes = [("H", "W"), ("h2", "w2"), ("h8", "w8"), ("h32", "w32")]
    channels = graph.weight("conv1.weight").shape[0]
    outputs = {"score": (_score(graph, levels), (1, 1, "H", "W"))}
    for n, (level, size) in enumerate(zip(levels, sizes, strict=True), 1):
        outputs[f"level{n}"] = (level, (1, channels, *size))
    for name, source in zip(HEAD, _HEAD_WEIGHTS, strict=True):
        weight = graph.weight(f"desc_head.{source}")
        outputs[name] = (graph.constant(weight), weight.shape)
    return graph.model({"image": (1, 1, "H", "W")}, outputs, "aliked")


def _score(graph: GraphBuilder, levels: list[str]) -> str:
    """(1, 1, H, W) probabilities of a keypoint.

    The first convolution is of single pixels, and so it is done before the interpolation, which
    gives the same with an eighth of the channels.
    """
    first = graph.weight("score_head.0.weight")
    width = first.shape[1] // len(levels)
    parts = []
    for n, (level, scale) in enumerate(zip(levels, SCALES, strict=True)):
        part = graph.convolution(level, first[:, n * width : (n + 1) * width], None)
        parts.append(_enlarged(graph, part, scale))
    x = _sum(graph, parts)
    for layer in (2, 4, 6):
        weight = graph.weight(f"score_head.{layer}.weight")
        x = graph.convolution(_selu(graph, x), weight, None, padding=1)
    return graph.node("Sigmoid", x)


def _block(graph: GraphBuilder, name: str, x: str, *, is_deformable: bool = False) -> str:
    """Two convolutions, and a third of single pixels beside them."""
    y = _convolution(graph, name, 1, x, is_deformable=is_deformable)
    y = _convolution(graph, name, 2, _selu(graph, y), is_deformable=is_deformable)
    beside = graph.convolution(
        x, graph.weight(f"{name}.downsample.weight"), graph.weight(f"{name}.downsample.bias")
    )
    return _selu(graph, graph.node("Add", y, beside))


def _convolution(
    graph: GraphBuilder,
    block: str,
    number: int,
    x: str,
    *,
    is_grey: bool = False,
    is_deformable: bool = False,
) -> str:
    """A convolution of 3 x 3 with the batch normalisation after it."""
    layer, norm = f"{block}.conv{number}", f"{block}.bn{number}"
    weight = graph.weight(f"{layer}.regular_conv.weight" if is_deformable else f"{layer}.weight")
    kernel, bias = graph.normalised(
        weight,
        graph.weight(f"{norm}.running_mean"),
        graph.weight(f"{norm}.running_var"),
        (graph.weight(f"{norm}.weight"), graph.weight(f"{norm}.bias")),
    )
    if not is_deformable:
        kernel = kernel.sum(axis=1, keepdims=True, dtype=np.float32) if is_grey else kernel
        return graph.convolution(x, kernel, bias, padding=1)
    offset = graph.convolution(
        x,
        graph.weight(f"{layer}.offset_conv.weight"),
        graph.weight(f"{layer}.offset_conv.bias"),
        padding=1,
    )
    single = kernel.reshape(len(kernel), -1, 1, 1)
    return graph.convolution(sampled(graph, x, offset), single, bias)


def sampled(graph: GraphBuilder, x: str, offset: str) -> str:
    """(1, 9 C, h, w): the nine values that a deformable convolution weights, C by C.

    Source: Dai et al., "Deformable convolutional networks", ICCV 2017, equation 2. Each output
    pixel takes the 3 x 3 around it, each moved by an offset of at most a quarter of the larger
    side: 0 outside, bilinear between pixels.

    Args:
        graph: the graph.
        x: (1, C, h, w).
        offset: (1, 18, h, w), y and x of each tap.
    """
    height, width = (_size(graph, x, axis) for axis in (2, 3))
    limit = graph.node("Mul", graph.node("Max", height, width), graph.constant(0.25))
    limited = graph.node("Max", graph.node("Min", offset, limit), graph.node("Neg", limit))
    each = graph.node("Concat", _integers(graph, [_TAPS, 2]), _shape(graph, x, 2, 4), axis=0)
    moves = graph.node("Reshape", limited, each)
    tap = np.arange(_TAPS)
    x_grid = _positions(graph, moves, 1, width, (tap % 3 - 1, [1, 1, 1, -1]))
    y_grid = _positions(graph, moves, 0, height, (tap // 3 - 1, [1, 1, -1, 1]))
    grid = graph.node("Transpose", graph.node("Concat", x_grid, y_grid, axis=1), perm=[0, 2, 3, 1])
    rows = graph.node(
        "Concat", _integers(graph, [1, -1]), _shape(graph, x, 3, 4), _integers(graph, [2]), axis=0
    )
    taken = graph.node(
        "GridSample",
        x,
        graph.node("Reshape", grid, rows),
        mode="bilinear",
        padding_mode="zeros",
        align_corners=0,
    )
    together = graph.node("Concat", _integers(graph, [1, -1]), _shape(graph, x, 2, 4), axis=0)
    return graph.node("Reshape", taken, together)


def _positions(
    graph: GraphBuilder, moves: str, axis: int, size: str, tap: tuple[Tensor, list[int]]
) -> str:
    """(9, 1, h, w) x or y of the taps, -1 and 1 at the edges of the corner pixels.

    Args:
        graph: the graph.
        moves: (9, 2, h, w) offsets of the taps, pixels.
        axis: which of the two offsets.
        size: width or height.
        tap: step of each tap from the centre, and the shape of a row or column of pixels.
    """
    steps, form = tap
    ramp = graph.node("Range", graph.constant(0.0), size, graph.constant(1.0))
    at = graph.node("Reshape", ramp, _integers(graph, form))
    at = graph.node("Add", at, graph.constant(steps.reshape(_TAPS, 1, 1, 1)))
    at = graph.node("Add", at, graph.node("Gather", moves, _integers(graph, [axis]), axis=1))
    doubled = graph.node("Add", graph.node("Add", at, at), graph.constant(1.0))
    return graph.node("Sub", graph.node("Div", doubled, size), graph.constant(1.0))


def _integers(graph: GraphBuilder, values: list[int]) -> str:
    return graph.constant(values, np.int64)


def _shape(graph: GraphBuilder, x: str, first: int, end: int) -> str:
    return graph.node(
        "Slice", graph.node("Shape", x), _integers(graph, [first]), _integers(graph, [end])
    )


def _size(graph: GraphBuilder, x: str, axis: int) -> str:
    """Size of an axis as a floating-point number."""
    shape = graph.node("Cast", graph.node("Shape", x), to=1)
    return graph.node("Gather", shape, graph.constant(axis, np.int64), axis=0)


def _pooled(graph: GraphBuilder, x: str, side: int) -> str:
    return graph.node("AveragePool", x, kernel_shape=[side] * 2, strides=[side] * 2)


def _enlarged(graph: GraphBuilder, x: str, factor: int) -> str:
    """Bilinear interpolation to a multiple of the size, centres of the corner pixels aligned."""
    if factor == 1:
        return x
    scales = graph.constant([1.0, 1.0, factor, factor])
    return graph.node(
        "Resize", x, "", scales, mode="linear", coordinate_transformation_mode="align_corners"
    )


def _selu(graph: GraphBuilder, x: str) -> str:
    return graph.node("Selu", x)


def _sum(graph: GraphBuilder, parts: list[str]) -> str:
    total = parts[0]
    for part in parts[1:]:
        total = graph.node("Add", total, part)
    return total
