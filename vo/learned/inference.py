"""Inference of ONNX models on numpy arrays, by OpenCV or ONNX Runtime."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import cv2
import numpy as np

from vo.errors import ConfigError, ModelError
from vo.types import Floats32

Backend = Literal["auto", "opencv", "onnxruntime"]


class Inference(Protocol):
    """A loaded model."""

    @property
    def description(self) -> str:
        """What computes it, and where."""
        ...

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """The outputs of these names; may be called from several threads."""
        ...


class OpenCvInference:
    """OpenCV's dnn module, on the CPU."""

    description = f"OpenCV {cv2.__version__} on the CPU"

    def __init__(self, path: Path) -> None:
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            raise ModelError(f"{path} cannot be loaded by OpenCV: {error.err}") from error
        self._lock = threading.Lock()

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """See `Inference.run`."""
        with self._lock:
            for name, value in inputs.items():
                self._net.setInput(value, name)
            return [np.asarray(each) for each in self._net.forward(list(outputs))]


class OnnxRuntimeInference:
    """ONNX Runtime, with the providers that it has."""

    def __init__(self, path: Path, threads: int) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        providers = onnxruntime.get_available_providers()
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=providers)
        except Exception as error:  # of several kinds, none of them exported
            raise ModelError(f"{path} cannot be loaded by ONNX Runtime: {error}") from error
        used = self._session.get_providers()[0].removesuffix("ExecutionProvider")
        self.description = f"ONNX Runtime {onnxruntime.__version__} on {used}"

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """See `Inference.run`."""
        results: list[Any] = self._session.run(list(outputs), dict(inputs))
        return [np.asarray(each) for each in results]


def load(path: Path, backend: Backend = "auto", threads: int = 0) -> Inference:
    """Load a model.

    Args:
        path: the ONNX file.
        backend: `auto` is OpenCV, which needs no further package.
        threads: of ONNX Runtime, 0 for all cores.

    Raises:
        ConfigError: ONNX Runtime is asked for and not installed.
        ModelError: the file cannot be loaded.
    """
    if backend != "onnxruntime":
        return OpenCvInference(path)
    if importlib.util.find_spec("onnxruntime") is None:
        raise ConfigError(
            "features.backend is onnxruntime, which is not installed: pip install "
            "'visual-odometry[onnxruntime]'"
        )
    return OnnxRuntimeInference(path, threads)
