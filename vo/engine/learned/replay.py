"""Runs of a network on an NVIDIA card, whose kernels are recorded once and replayed."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vo.base.types import Floats32

_log = logging.getLogger(__name__)
_MAX_SHAPES = 8  # each keeps arrays on the card
# Of all networks: while kernels are recorded, nothing else may use the card.
_card = threading.Lock()


class Replay:
    """Runs of an ONNX Runtime session as CUDA graphs: one launch instead of one for each kernel.

    A graph works on arrays that stay where they are, so there is one for each combination of shapes
    that is seen twice. The session has the provider option `enable_cuda_graph`.

    Args:
        device: of the arrays, `cuda`; with `cpu` the same without graphs.
    """

    def __init__(self, session: Any, device: str = "cuda") -> None:
        self._session = session
        self._device = device
        self._bound: dict[Any, _Bound | None] = {}
        self._is_possible = True

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Any]:
        """The outputs of these names; from several threads, one at a time."""
        key = *outputs, *((name, value.shape) for name, value in inputs.items())
        with _card:
            bound = self._bound.get(key)
            if bound is not None and self._is_possible:
                return bound.run(inputs)
            results: list[Any] = self._session.run(list(outputs), dict(inputs), _options(-1))
            if key in self._bound and self._is_possible:
                self._bind(key, inputs, dict(zip(outputs, results, strict=True)))
            elif len(self._bound) < _MAX_SHAPES:
                self._bound[key] = None
            return results

    def _bind(self, key: Any, inputs: Mapping[str, Floats32], results: dict[str, Any]) -> None:
        try:
            number = 1 + sum(each is not None for each in self._bound.values())
            bound = _Bound(self._session, inputs, results, self._device, number)
            bound.run(inputs)
            self._bound[key] = bound
        except Exception as error:  # of several kinds, none of them exported
            self._is_possible = False
            _log.warning(
                "each kernel is launched by itself: %s", " ".join(str(error).split())[-160:]
            )


class _Bound:
    """Arrays on the card for inputs and outputs of one shape, and the number of their graph."""

    def __init__(
        self,
        session: Any,
        inputs: Mapping[str, Floats32],
        results: Mapping[str, Any],
        device: str,
        number: int,
    ) -> None:
        import onnxruntime

        self._session = session
        self._are_copied = device != "cpu"
        self._options = _options(number)
        self._binding = session.io_binding()
        make = onnxruntime.OrtValue.ortvalue_from_numpy
        self._inputs = {n: make(np.array(v, order="C"), device, 0) for n, v in inputs.items()}
        self._outputs = {n: make(np.array(v), device, 0) for n, v in results.items()}
        for name, value in self._inputs.items():
            self._binding.bind_ortvalue_input(name, value)
        for name, value in self._outputs.items():
            self._binding.bind_ortvalue_output(name, value)

    def run(self, inputs: Mapping[str, Floats32]) -> list[Any]:
        for name, value in inputs.items():
            self._inputs[name].update_inplace(np.ascontiguousarray(value))
        self._session.run_with_iobinding(self._binding, self._options)
        results = [value.numpy() for value in self._outputs.values()]
        return results if self._are_copied else [np.array(each) for each in results]


def _options(number: int) -> Any:
    """Options of a run by a graph of this number, -1 for none."""
    import onnxruntime

    options = onnxruntime.RunOptions()
    options.add_run_config_entry("gpu_graph_id", str(number))
    return options
