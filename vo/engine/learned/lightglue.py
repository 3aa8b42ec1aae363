"""Matches of two sets of features by a network, and LightGlue and LighterGlue as ONNX graphs.

Source: Lindenberger et al., "LightGlue: local feature matching at light speed", ICCV 2023, section
3; LighterGlue is a smaller one for XFeat (Potje et al., CVPR 2024). All layers are computed and no
point is left out on the way (the paper's section 3.3 describes both as options).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.types import Floats, Floats32, Ints
from vo.engine.frontend.contracts import FeatureSet, Matcher, Matches, SearchRegion
from vo.engine.learned.graph import (
    GraphBuilder,
    Tensor,
    attention,
    from_heads,
    gelu,
    layer_normalised,
    linear,
    named_linear,
    to_heads,
)
from vo.engine.learned.inference import Inference

if TYPE_CHECKING:
    from onnx import ModelProto

MIN_PROBABILITY = 0.1  # the authors' threshold

_SIZE_STEP = 256  # of the numbers of features that networks on a card are given
_NEVER = -1e30  # logarithm of the weight of features that are not there: its exponential is 0


class Partners(NamedTuple):
    """Most probable partners of the features of two images, N and M.

    Attributes:
        train: (N,) row of the second image for each feature of the first.
        log_probability: (N,) logarithm of the probability that they belong together.
        query: (M,) row of the first image for each feature of the second.
    """

    train: Ints
    log_probability: Floats | Floats32
    query: Ints


Assignment = Callable[[FeatureSet, FeatureSet], Partners]
"""Partners of features that all have positions, and of which there are some.

Raises ValueError where it is not given what it needs.
"""


def normalised(xy: Floats | Floats32, size: tuple[int, int]) -> Floats32:
    """Positions (N, 2), 0 in the middle of an image (width, height), 1 at half its longer side."""
    return ((xy - np.divide(size, 2.0)) / (max(size) / 2.0)).astype(np.float32)


def partners_of(log_assignment: Floats | Floats32) -> Partners:
    """Partners by the logarithms (N, M) of the probability of each pair."""
    train = log_assignment.argmax(axis=1)
    highest = log_assignment[np.arange(len(train)), train]
    return Partners(train, highest, log_assignment.argmax(axis=0))


def matches_of(partners: Partners, min_probability: float) -> Matches:
    """Pairs that are each other's partners; scores are 1 - probability."""
    train = partners.train
    probability = np.exp(partners.log_probability.astype(np.float64))
    is_mutual = partners.query[train] == np.arange(len(train))
    good = np.flatnonzero(is_mutual & (probability > min_probability))
    return Matches(good, train[good], 1.0 - probability[good])


class LightGlue:
    """The assignment of LightGlue and LighterGlue, see `Assignment`.

    Args:
        network: the model, or what `padded_model` makes of it.
    """

    def __init__(self, network: Inference) -> None:
        self._network = network

    def __call__(self, query: FeatureSet, train: FeatureSet) -> Partners:
        """See `Assignment`."""
        if self._network.is_rewritten:
            size = -max(len(query), len(train)) // _SIZE_STEP * -_SIZE_STEP
            given = _padded_inputs(query, 0, size) | _padded_inputs(train, 1, size)
            row, highest, back = self._network.run(given, ["train", "highest", "query"])
            n, m = len(query), len(train)
            return Partners(row[0, :n].astype(int), highest[0, :n], back[0, :m].astype(int))
        given = _inputs(query, 0) | _inputs(train, 1)
        (log_assignment,) = self._network.run(given, ["log_assignment"])
        return partners_of(log_assignment[0])


class AssignmentMatcher:
    """Matches two images by a network; see `vo.engine.frontend.contracts.Matcher`.

    Within a search region, and where positions are not known, `near` matches by descriptors alone:
    the network compares how features lie to each other in whole images. Ratio and orientations
    are not used.
    """

    def __init__(self, assignment: Assignment, near: Matcher, min_probability: float) -> None:
        self._assignment = assignment
        self._near = near
        self._min_probability = min_probability

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        """One-to-one matches, see `vo.engine.frontend.contracts.Matcher`.

        Raises:
            ValueError: the size of an image is missing, or descriptors have another layout.
        """
        q, t = _placed(query), _placed(train)
        if region is not None or len(q) == 0 or len(t) == 0:
            return self._near.match(
                query, train, region, ratio=ratio, check_rotation=check_rotation
            )
        found = self._assignment(query.select(q), train.select(t))
        matches = matches_of(found, self._min_probability)
        return Matches(q[matches.query], t[matches.train], matches.score)


def _placed(features: FeatureSet) -> Ints:
    """Rows of the features with known positions."""
    if features.xy is None:
        return np.empty(0, np.int64)
    return np.flatnonzero(np.isfinite(features.xy).all(axis=1))


def _inputs(features: FeatureSet, side: int) -> dict[str, Floats32]:
    """Inputs of the network for one of the two images."""
    if features.size is None or features.xy is None:
        raise ValueError("features have no image size; matching by a network needs it")
    return {
        f"kpts{side}": normalised(features.xy, features.size)[None],
        f"desc{side}": np.ascontiguousarray(features.descriptor, np.float32)[None],
    }


def _padded_inputs(features: FeatureSet, side: int, size: int) -> dict[str, Floats32]:
    """Inputs of `padded_model`'s network, with zeros up to a number of features."""
    missing = ((0, 0), (0, size - len(features)), (0, 0))
    padded = {name: np.pad(value, missing) for name, value in _inputs(features, side).items()}
    absent = np.where(np.arange(size) < len(features), 0.0, _NEVER).astype(np.float32)
    return padded | {f"absent{side}": absent[None, None]}


def padded_model(content: bytes) -> bytes:
    """A model of this module for inputs that are continued to sizes which do not change.

    Further inputs `absent0` and `absent1` (1, 1, N or M) are added to the logarithms of all weights
    of features: 0, and `_NEVER` for those that are not there. Outputs, instead of the assignment,
    are `train`, `highest` and `query`, see `Partners`, so that little is read back from a card.
    """
    import onnx
    from onnx import TensorProto, helper

    model = onnx.load_model_from_string(content)
    nodes, asked = [], ("absent0", "absent1", "absent1", "absent0")
    attentions = 0
    for node in model.graph.node:
        if node.op_type in ("Softmax", "LogSoftmax"):
            absent = asked[attentions % len(asked)]  # self-attention of both, then cross-attention
            attentions += node.op_type == "Softmax"
            if node.op_type == "LogSoftmax":
                axis = node.attribute[0].i
                absent = "absent1" if axis == 2 else "absent0_by_row"
            total = f"{node.input[0]}_{absent}"
            nodes.append(helper.make_node("Add", [node.input[0], absent], [total]))
            node.input[0] = total
        nodes.append(node)
    by_row = helper.make_node("Transpose", ["absent0"], ["absent0_by_row"], perm=[0, 2, 1])
    found = [
        helper.make_node("ArgMax", ["log_assignment"], ["train"], axis=2, keepdims=0),
        helper.make_node("ReduceMax", ["log_assignment"], ["highest"], axes=[2], keepdims=0),
        helper.make_node("ArgMax", ["log_assignment"], ["query"], axis=1, keepdims=0),
    ]
    del model.graph.node[:], model.graph.output[:]
    model.graph.node.extend([by_row, *nodes, *found])
    for name, kind, size in (
        ("train", TensorProto.INT64, "n"),
        ("highest", TensorProto.FLOAT, "n"),
        ("query", TensorProto.INT64, "m"),
    ):
        model.graph.output.append(helper.make_tensor_value_info(name, kind, (1, size)))
    for side, size in enumerate("nm"):
        name, shape = f"absent{side}", (1, 1, size)
        model.graph.input.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
    return bytes(model.SerializeToString())


class _Encoding(NamedTuple):
    """Cosines and sines (1, 1, N, pairs) of a rotary encoding of positions."""

    cosine: str
    sine: str
    pairs: int


def lightglue_model(weights: dict[str, Tensor], heads: int = 4) -> ModelProto:
    """The model, from the weights by their names in the authors' file.

    Inputs `kpts0` (1, N, 2) and `kpts1` (1, M, 2) positions, 0 in the middle of the image and 1 at
    half its longer side, `desc0` and `desc1` (1, N or M, C) descriptors. Output `log_assignment`
    (1, N, M) logarithm of the probability that two features belong together (equation 8).

    Args:
        weights: of the matcher; names of older files are known, too.
        heads: of each attention layer.

    Raises:
        KeyError: a weight is missing.
    """
    weights = _renamed(weights)
    graph = GraphBuilder(weights)
    layers = sum(name.endswith("self_attn.Wqkv.weight") for name in weights)
    channels = graph.weight("posenc.Wr.weight").shape[0] * 2 * heads
    encodings = [_encoding(graph, f"kpts{side}") for side in (0, 1)]
    x = [f"desc{side}" for side in (0, 1)]
    width = channels
    if "input_proj.weight" in weights:
        width = graph.weight("input_proj.weight").shape[1]
        x = [named_linear(graph, "input_proj", each) for each in x]
    for number in range(layers):
        layer = f"transformers.{number}"
        x = [
            _self_attention(graph, f"{layer}.self_attn", each, encoding, heads)
            for each, encoding in zip(x, encodings, strict=True)
        ]
        x = _cross_attention(graph, f"{layer}.cross_attn", x, heads)
    inputs: dict[str, tuple[int | str, ...]] = {
        "kpts0": (1, "n", 2),
        "kpts1": (1, "m", 2),
        "desc0": (1, "n", width),
        "desc1": (1, "m", width),
    }
    assignment = _log_assignment(graph, f"log_assignment.{layers - 1}", x)
    return graph.model(inputs, {"log_assignment": (assignment, (1, "n", "m"))}, "lightglue")


def lighterglue_model(weights: dict[str, Tensor]) -> ModelProto:
    """LighterGlue, see `lightglue_model`; its file also contains XFeat, which is left out."""
    prefix = "matcher."
    own = {k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)}
    return lightglue_model(own, heads=1)


def _renamed(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Weights by the names of newer files: older ones have `self_attn.0` for layer 0."""
    renamed = {}
    for name, tensor in weights.items():
        kind, _, rest = name.partition(".")
        if kind in ("self_attn", "cross_attn"):
            number, _, rest = rest.partition(".")
            name = f"transformers.{number}.{kind}.{rest}"
        renamed[name] = tensor
    return renamed


def _encoding(graph: GraphBuilder, positions: str) -> _Encoding:
    """Rotary encoding of positions (1, N, 2) (section 3.1)."""
    frequency = np.ascontiguousarray(graph.weight("posenc.Wr.weight").T)
    angle = graph.node("MatMul", positions, graph.constant(frequency))
    angle = graph.node("Unsqueeze", angle, graph.constant([1], np.int64))
    return _Encoding(graph.node("Cos", angle), graph.node("Sin", angle), frequency.shape[1])


def _self_attention(graph: GraphBuilder, name: str, x: str, encoding: _Encoding, heads: int) -> str:
    """`x` with what it gets from features of the same image (equations 2 to 5)."""
    query, key, value = (
        to_heads(graph, linear(graph, x, *layer), heads)
        for layer in _projections(graph, name, heads)
    )
    context = attention(
        graph, _rotated(graph, query, encoding), _rotated(graph, key, encoding), value
    )
    return _updated(
        graph, name, x, named_linear(graph, f"{name}.out_proj", from_heads(graph, context))
    )


def _projections(graph: GraphBuilder, name: str, heads: int) -> list[tuple[Tensor, Tensor]]:
    """Weight and bias of queries, keys and values, ordered by head.

    The file has query, key and value side by side for each channel, and the two numbers that are
    rotated together as well. Here the first ones of these come before all second ones. Queries
    include the scale of the products, the root of the number of channels of a head.
    """
    weight, bias = graph.weight(f"{name}.Wqkv.weight"), graph.weight(f"{name}.Wqkv.bias")
    channels = weight.shape[1]
    depth = channels // heads
    parts = np.concatenate([weight, bias[:, None]], axis=1).reshape(heads, depth, 3, channels + 1)
    rotated = [*range(0, depth, 2), *range(1, depth, 2)]
    query, key, value = parts[:, rotated, 0], parts[:, rotated, 1], parts[:, :, 2]
    query = query / np.sqrt(np.float64(depth))
    flat = (each.reshape(channels, channels + 1) for each in (query, key, value))
    return [(each[:, :-1], each[:, -1]) for each in flat]


def _rotated(graph: GraphBuilder, x: str, encoding: _Encoding) -> str:
    """Pairs of channels (1, heads, N, d), those of the first and second half, rotated."""
    at = [graph.constant([n * encoding.pairs], np.int64) for n in range(3)]
    last = graph.constant([-1], np.int64)
    first, second = (graph.node("Slice", x, at[n], at[n + 1], last) for n in (0, 1))
    cosine, sine = encoding.cosine, encoding.sine
    turned = graph.node("Sub", graph.node("Mul", first, cosine), graph.node("Mul", second, sine))
    other = graph.node("Add", graph.node("Mul", second, cosine), graph.node("Mul", first, sine))
    return graph.node("Concat", turned, other, axis=-1)


def _cross_attention(graph: GraphBuilder, name: str, x: list[str], heads: int) -> list[str]:
    """Both with what they get from features of the other image (equation 6)."""
    weight, bias = graph.weight(f"{name}.to_qk.weight"), graph.weight(f"{name}.to_qk.bias")
    scale = np.sqrt(np.sqrt(np.float64(weight.shape[0] // heads)))
    key = [to_heads(graph, linear(graph, each, weight / scale, bias / scale), heads) for each in x]
    value = [to_heads(graph, named_linear(graph, f"{name}.to_v", each), heads) for each in x]
    messages = [attention(graph, key[side], key[1 - side], value[1 - side]) for side in (0, 1)]
    messages = [
        named_linear(graph, f"{name}.to_out", from_heads(graph, message)) for message in messages
    ]
    return [_updated(graph, name, each, m) for each, m in zip(x, messages, strict=True)]


def _updated(graph: GraphBuilder, name: str, x: str, message: str) -> str:
    """`x` with the output of the feed-forward layers for it and a message (equation 1)."""
    y = named_linear(graph, f"{name}.ffn.0", graph.node("Concat", x, message, axis=-1))
    y = gelu(graph, layer_normalised(graph, f"{name}.ffn.1", y))
    return graph.node("Add", x, named_linear(graph, f"{name}.ffn.3", y))


def _log_assignment(graph: GraphBuilder, name: str, x: list[str]) -> str:
    """Logarithm of the assignment (1, N, M) (equations 7 and 8)."""
    weight, bias = (
        graph.weight(f"{name}.final_proj.weight"),
        graph.weight(f"{name}.final_proj.bias"),
    )
    scale = np.sqrt(np.sqrt(np.float64(weight.shape[0])))
    a, b = (linear(graph, each, weight / scale, bias / scale) for each in x)
    similarity = graph.node("MatMul", a, graph.node("Transpose", b, perm=[0, 2, 1]))
    both = graph.node(
        "Add",
        graph.node("LogSoftmax", similarity, axis=2),
        graph.node("LogSoftmax", similarity, axis=1),
    )
    rows, columns = (_log_sigmoid(graph, named_linear(graph, f"{name}.matchability", e)) for e in x)
    both = graph.node("Add", both, rows)
    return graph.node("Add", both, graph.node("Transpose", columns, perm=[0, 2, 1]))


def _log_sigmoid(graph: GraphBuilder, x: str) -> str:
    return graph.node("Neg", graph.node("Softplus", graph.node("Neg", x)))
