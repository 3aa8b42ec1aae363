"""Inference of ONNX models on numpy arrays, by OpenCV or ONNX Runtime."""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import cv2
import numpy as np

from vo.base.errors import ConfigError, ModelError
from vo.base.types import Floats32
from vo.engine.learned.replay import Replay

Backend = Literal["auto", "opencv", "onnxruntime"]
Device = Literal["auto", "cpu", "cuda", "tensorrt", "coreml"]

_log = logging.getLogger(__name__)
_PROVIDERS = {
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
# TF32 has 10 bits of mantissa: with XFeat kitti06 has 0.0367 m with it, 0.0297 without.
_PROVIDER_OPTIONS = {"cuda": {"use_tf32": "0", "cudnn_conv_algo_search": "HEURISTIC"}}
_REPLAYED = {"cuda": {**_PROVIDER_OPTIONS["cuda"], "enable_cuda_graph": "1"}}
# TensorRT compiles a network for minutes: only where it is asked for.
_AUTOMATIC = ("cuda", "coreml", "cpu")


class Network(NamedTuple):
    """A network in use, as `summary.json` names it.

    Attributes:
        runs_in: what computes it, and where.
        device: `cpu`, `cuda`, `tensorrt` or `coreml`.
    """

    model: str
    runs_in: str
    device: str
    sha256: str


_used: ContextVar[list[Network] | None] = ContextVar("networks_used", default=None)


class Inference(Protocol):
    """A loaded model.

    Attributes:
        is_rewritten: whether it is what `load`'s `rewrite` has made of the file.
    """

    is_rewritten: bool

    @property
    def description(self) -> str:
        """What computes it, and where."""
        ...

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """The outputs of these names; may be called from several threads.

        Raises:
            ModelError: the network cannot compute these inputs.
        """
        ...


class OpenCvInference:
    """OpenCV's dnn module, on the CPU."""

    description = f"OpenCV {cv2.__version__} on the CPU"
    device = "cpu"
    is_rewritten = False

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            raise ModelError(f"{path} cannot be loaded by OpenCV: {_reason(error)}") from error
        self._lock = threading.Lock()

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """See `Inference.run`."""
        with self._lock:
            try:
                for name, value in inputs.items():
                    self._net.setInput(value, name)
                return [np.asarray(each) for each in self._net.forward(list(outputs))]
            except cv2.error as error:
                raise ModelError(f"{self._path} fails in OpenCV: {_reason(error)}") from error


class OnnxRuntimeInference:
    """ONNX Runtime, on the first device that works.

    `is_fixed`, `rewrite`: see `load`.

    Raises:
        ConfigError: this device is not there, or not usable.
        ModelError: the file cannot be loaded.
    """

    def __init__(
        self,
        path: Path,
        device: Device = "auto",
        is_fixed: bool = False,
        rewrite: Callable[[bytes], bytes] | None = None,
    ) -> None:
        import onnxruntime

        self._path = path
        available = onnxruntime.get_available_providers()
        wanted = _AUTOMATIC if device == "auto" else (device,)
        names = [name for name in wanted if _PROVIDERS[name] in available]
        if not names:
            raise ConfigError(_no_device(device, available))
        content = path.read_bytes()
        self.is_rewritten = rewrite is not None and names[0] == "cuda" and _has_onnx()
        if rewrite is not None and self.is_rewritten:
            content = rewrite(content)
        self._replay: Replay | None = None
        try:
            session = None
            if is_fixed and names[0] == "cuda":
                session = _replayed_session(content, names)
                self._replay = Replay(session) if session is not None else None
            self._session = session or _session(content, names, _PROVIDER_OPTIONS)
        except Exception as error:  # of several kinds, none of them exported
            raise ModelError(
                f"{path} cannot be loaded by ONNX Runtime: {_reason(error)}"
            ) from error
        # A provider whose libraries are missing is left out without an error.
        used = self._session.get_providers()[0]
        if device != "auto" and used != _PROVIDERS[device]:
            raise ConfigError(
                f"features.device is {device}, which ONNX Runtime offers but cannot use: are its "
                "driver and libraries installed? features.device=auto takes what works"
            )
        provider = used.removesuffix("ExecutionProvider")
        self.device = next((d for d, name in _PROVIDERS.items() if name == used), "cpu")
        self.description = f"ONNX Runtime {onnxruntime.__version__} on {provider}"

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """See `Inference.run`."""
        try:
            if self._replay is not None:
                return self._replay.run(inputs, outputs)
            results: list[Any] = self._session.run(list(outputs), dict(inputs))
        except Exception as error:  # of several kinds, none of them exported
            raise ModelError(f"{self._path} fails in ONNX Runtime: {_reason(error)}") from error
        return [np.asarray(each) for each in results]


def _session(content: bytes, devices: Sequence[str], given: Mapping[str, dict[str, str]]) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    # Threads that spin while they wait take as much CPU time again.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    providers = [(_PROVIDERS[name], given.get(name, {})) for name in devices]
    return onnxruntime.InferenceSession(content, options, providers=providers)


def _replayed_session(content: bytes, devices: Sequence[str]) -> Any:
    """A session for `Replay`; None where a part of the network cannot run on the card."""
    try:
        session = _session(content, devices, _REPLAYED)
    except Exception as error:  # of several kinds, none of them exported
        _log.info("without CUDA graphs: %s", _reason(error))
        return None
    return session if session.get_providers()[0] == _PROVIDERS["cuda"] else None


def _has_onnx() -> bool:
    if importlib.util.find_spec("onnx") is not None:
        return True
    _log.warning(
        "without the package onnx a network for matching takes three times as long on the card: "
        "pip install 'visual-odometry[learned]'"
    )
    return False


def load(
    path: Path,
    backend: Backend = "auto",
    device: Device = "auto",
    *,
    is_fixed: bool = True,
    rewrite: Callable[[bytes], bytes] | None = None,
) -> Inference:
    """Load a model.

    Args:
        path: of its file.
        backend: `auto` is OpenCV, which needs no further package, on the CPU, and ONNX Runtime on
            every other device.
        device: where to compute.
        is_fixed: whether the shapes of the inputs decide those of all outputs.
        rewrite: makes of the file what suits an NVIDIA card.

    Raises:
        ConfigError: ONNX Runtime is asked for and not installed, or the device is not there.
        ModelError: the file cannot be loaded.
    """
    on_cpu = device in ("auto", "cpu")
    if backend == "opencv" and not on_cpu:
        raise ConfigError(
            f"features.device is {device}, and OpenCV computes on the CPU: "
            "features.backend=onnxruntime"
        )
    inference: OpenCvInference | OnnxRuntimeInference
    if backend == "opencv" or (backend == "auto" and on_cpu):
        inference = OpenCvInference(path)
    else:
        if importlib.util.find_spec("onnxruntime") is None:
            setting = f"backend is {backend}" if on_cpu else f"device is {device}"
            raise ConfigError(
                f"features.{setting}, which needs ONNX Runtime, and that is not installed: "
                "pip install 'visual-odometry[onnxruntime]'"
            )
        inference = OnnxRuntimeInference(path, device, is_fixed, rewrite)
    _log.info("%s runs in %s", path.stem, inference.description)
    used = _used.get()
    if used is not None:
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        used.append(Network(path.stem, inference.description, inference.device, sha256))
    return inference


def networks_so_far() -> list[Network]:
    """The list of the context, to which networks that are loaded later can be added."""
    networks = _used.get()
    return [] if networks is None else networks


@contextmanager
def networks_used(
    device: Device = "auto", so_far: list[Network] | None = None
) -> Iterator[list[Network]]:
    """The networks that are loaded in this context; a device that none of them uses is said."""
    networks = [] if so_far is None else so_far
    token = _used.set(networks)
    try:
        yield networks
    finally:
        _used.reset(token)
    if device not in ("auto", "cpu") and not networks:
        _log.warning("features.device=%s has no effect on features without a network", device)


def _reason(error: Exception) -> str:
    """The end of a backend's message, which has the cause, as one line."""
    return " ".join(str(error).split())[-160:]


def _no_device(device: Device, available: Sequence[str]) -> str:
    names = [name for name, provider in _PROVIDERS.items() if provider in available]
    package = {"cuda": "onnxruntime-gpu", "tensorrt": "onnxruntime-gpu"}.get(device)
    hint = f"; install {package} in place of onnxruntime" if package else ""
    return (
        f"features.device is {device}, and this ONNX Runtime has {', '.join(names) or 'none'}{hint}"
    )
