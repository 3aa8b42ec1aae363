"""Features by an ONNX file of the user's own, whose inputs and outputs have the documented layout.

Input `image` (1, 1, H, W) grey or (1, 3, H, W) with equal colours, between 0 and 1, H and W
multiples of 32. Outputs, with or without a first axis of length 1: `keypoints` (N, 2) pixels x and
y, 0 in the middle of the first; `scores` (N,); `descriptors` (N, D), compared by their products.
"""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from vo.base.errors import ModelError
from vo.base.extras import require
from vo.base.types import Bytes, Floats32, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.inference import Backend, Device, Inference, load
from vo.engine.learned.maps import MIN_SIDE_OF_32, learned_keypoints, network_input, no_keypoints

OWN_OUTPUTS = ("keypoints", "scores", "descriptors")
_MULTIPLE = 32  # of both sides of the network's input
_PROBE_SIDE = 64
_MAX_BYTES = 2**30
_MAX_KEYPOINTS, _MAX_WIDTH = 2**20, 2**12


class OwnExtractor:
    """Detects and describes features by a file of the user's own, strongest first.

    Raises:
        ModelError: its outputs are others.
    """

    scale_factor = 1.0
    suits_mutual_matching = True

    def __init__(self, inference: Inference, name: str, channels: int, count: int) -> None:
        self._inference, self._name = inference, name
        self._channels, self._count = channels, count
        # Without texture, networks may find no keypoint, and some then fail.
        probe = np.random.default_rng(0).random((1, 1, _PROBE_SIDE, _PROBE_SIDE), np.float32)
        width = self._run(probe)[2].shape[1]
        self.descriptor_format = DescriptorFormat(width, np.dtype(np.float32))

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        width = self.descriptor_format.width
        if min(image.shape) < MIN_SIDE_OF_32:
            return no_keypoints(width)
        xy, score, descriptor = self._run(network_input(image, _MULTIPLE))
        if descriptor.shape[1] != width:
            raise _refused(
                self._name, f"descriptors of {descriptor.shape[1]} and of {width} numbers"
            )
        nearest = np.rint(xy).astype(np.int64)
        rows = np.flatnonzero(((nearest >= 0) & (nearest < image.shape[::-1])).all(axis=1))
        if mask is not None:
            rows = rows[mask[nearest[rows, 1], nearest[rows, 0]] > 0]
        rows = rows[np.lexsort((xy[rows, 0], xy[rows, 1], -score[rows]))][: self._count]
        return learned_keypoints(xy[rows].astype(np.float64), score[rows], descriptor[rows])

    def _run(self, given: Floats32) -> tuple[Floats32, Floats32, Floats32]:
        """Keypoints (N, 2), scores (N,) and descriptors (N, D), checked."""
        repeated = np.repeat(given, self._channels, axis=1)
        try:
            found = self._inference.run({"image": repeated}, OWN_OUTPUTS)
        except ModelError as error:
            reason = str(error).removeprefix(f"{self._name} ")
            raise _refused(self._name, f"an error with the input 'image': it {reason}") from error
        shapes = ", ".join(f"{n} {a.shape}" for n, a in zip(OWN_OUTPUTS, found, strict=True))
        xy, score, descriptor = (
            a[0] if a.ndim > axes and len(a) == 1 else a
            for a, axes in zip(found, (2, 1, 2), strict=True)
        )
        is_right = (
            xy.ndim == descriptor.ndim == 2
            and xy.shape[1] == 2
            and score.size == len(xy) == len(descriptor) <= _MAX_KEYPOINTS
            and 0 < descriptor.shape[1] <= _MAX_WIDTH
        )
        if not is_right:
            raise _refused(self._name, f"the outputs {shapes}")
        if not all(np.isfinite(a).all() for a in (xy, score, descriptor)):
            raise _refused(self._name, "outputs that are not finite")
        if np.abs(xy).max(initial=0) > max(given.shape) * 2:
            raise _refused(self._name, "keypoints far outside of the image")
        return xy, score.reshape(-1), descriptor


def _refused(name: str, what: str) -> ModelError:
    return ModelError(
        f"{name} has {what}; expected are the input 'image' (1, 1 or 3, H, W) and the outputs "
        "'keypoints' (N, 2), 'scores' (N,) and 'descriptors' (N, D) (docs/learned.md)"
    )


def _declared_channels(path: Path) -> int:
    """Channels of the input that a file declares.

    OpenCV computes something for any number of channels, and so they are read before.
    """
    import onnx

    try:
        graph = onnx.load(str(path), load_external_data=False).graph
    except Exception as error:  # of several kinds
        reason = " ".join(str(error).split())[:160]
        raise ModelError(f"{path} is no ONNX file, or damaged: {reason}") from error
    weights = {each.name for each in graph.initializer}
    inputs = {each.name: each.type.tensor_type for each in graph.input if each.name not in weights}
    shapes = {name: [size.dim_value for size in kind.shape.dim] for name, kind in inputs.items()}
    shape = shapes.get("image", [])
    if len(inputs) != 1 or len(shape) != 4 or shape[1] not in (1, 3):
        found = ", ".join(f"'{name}' {tuple(size)}" for name, size in shapes.items())
        raise _refused(str(path), f"the inputs {found[:200] or 'none'}")
    names = [each.name for each in graph.output]
    if not set(OWN_OUTPUTS) <= set(names):
        raise _refused(str(path), f"the outputs {', '.join(names)[:200] or 'none'}")
    return shape[1]


def load_own_network(path: Path, backend: Backend, device: Device, count: int) -> OwnExtractor:
    """The extractor of a file.

    Raises:
        ConfigError: the backend or device is not there.
        MissingExtraError: the package `onnx` is not installed.
        ModelError: the file is missing, too large, damaged, or has other inputs or outputs.
    """
    require("onnx", extra="learned", what="model files")
    if not path.is_file():
        raise ModelError(f"there is no file {path}; features.detector=onnx:FILE names an ONNX file")
    if path.stat().st_size > _MAX_BYTES:
        raise ModelError(f"{path} has {path.stat().st_size} bytes; at most {_MAX_BYTES}")
    channels = _declared_channels(path)
    return OwnExtractor(load(path, backend, device, is_fixed=False), str(path), channels, count)
