"""Where networks are computed: what is asked for and not there is an error."""

from __future__ import annotations

import hashlib
import importlib
import logging
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learned_cases import BACKENDS, require_backend

import vo
from vo.base.config import load_config
from vo.base.errors import ConfigError, ModelError
from vo.base.types import Camera, Rig
from vo.engine.learned import inference
from vo.engine.learned.inference import load, networks_used
from vo.engine.learned.replay import Replay
from vo.engine.odometry import Odometry

pytest.importorskip("onnx")


def providers() -> list[str]:
    found: list[str] = pytest.importorskip("onnxruntime").get_available_providers()
    return found


@pytest.fixture
def doubling(tmp_path: Path) -> Path:
    """A network that adds its input to itself."""
    from vo.engine.learned.graph import GraphBuilder

    graph = GraphBuilder({})
    total = graph.node("Add", "x", "x")
    path = tmp_path / "doubling.onnx"
    path.write_bytes(graph.model({"x": (1, 3)}, {"y": (total, (1, 3))}, "t").SerializeToString())
    return path


def test_opencv_computes_on_the_cpu_alone(doubling: Path) -> None:
    with pytest.raises(ConfigError, match="OpenCV computes on the CPU"):
        load(doubling, "opencv", "cuda")
    with networks_used() as used:
        load(doubling, "auto", "cpu")
    assert [network.device for network in used] == ["cpu"] and "OpenCV" in used[0].runs_in


@pytest.mark.parametrize("device", ["cuda", "tensorrt", "coreml"])
def test_a_device_that_is_not_there_is_one_line(doubling: Path, device: Any) -> None:
    name = inference._PROVIDERS[device]
    if name in providers():
        pytest.skip(f"this machine's ONNX Runtime has {name}")
    with pytest.raises(ConfigError, match=f"features.device is {device}") as caught:
        load(doubling, "auto", device)
    assert "cpu" in str(caught.value) and "\n" not in str(caught.value)


def test_a_device_without_a_network_has_no_effect_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig(Camera(320, 240, 200.0, 200.0, 160.0, 120.0))
    config = load_config(overrides=["features.device=cuda", "threads=1"])
    with closing(Odometry(rig, config)):
        assert "features.device=cuda has no effect" in caplog.text
    caplog.clear()
    vo.features.create("orb", device="cuda")
    assert caplog.text.count("features.device=cuda has no effect") == 1


def test_auto_takes_what_works_and_reports_it(
    doubling: Path, caplog: pytest.LogCaptureFixture
) -> None:
    providers()
    with caplog.at_level(logging.INFO, "vo.engine.learned"), networks_used() as used:
        loaded = load(doubling, "onnxruntime", "auto")
    (y,) = loaded.run({"x": np.array([[1, 2, 3]], np.float32)}, ["y"])
    np.testing.assert_array_equal(y, [[2, 4, 6]])
    (network,) = used
    assert network.model == "doubling"
    assert network.sha256 == hashlib.sha256(doubling.read_bytes()).hexdigest()
    assert caplog.messages == [f"doubling runs in {network.runs_in}"]


@pytest.mark.parametrize("backend", BACKENDS)
def test_inputs_that_a_network_cannot_compute_are_one_line(doubling: Path, backend: Any) -> None:
    require_backend(backend)
    network = load(doubling, backend)
    x = np.zeros((1, 3), np.float32)
    for inputs, outputs in (({"z": x}, ["y"]), ({"x": x}, ["z"])):
        with pytest.raises(ModelError, match=r"doubling\.onnx fails in O.*: .*z") as caught:
            network.run(inputs, outputs)
        assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(network.run({"x": x + 1}, ["y"])[0], [[2, 2, 2]])


def test_runs_with_arrays_that_stay_in_place_give_what_single_runs_give(tmp_path: Path) -> None:
    """Of more shapes than are kept, and results that later runs leave as they are."""
    runtime = pytest.importorskip("onnxruntime")
    from vo.engine.learned.graph import GraphBuilder

    graph = GraphBuilder({})
    total = graph.node("Add", "x", "x")
    model = graph.model({"x": (1, "n")}, {"y": (total, (1, "n"))}, "t").SerializeToString()
    session = runtime.InferenceSession(model, providers=["CPUExecutionProvider"])
    replay = Replay(session, "cpu")
    first = np.zeros((1, 3), np.float32)
    kept = [replay.run({"x": first + n}, ["y"])[0] for n in range(5)]
    assert [y[0, 0] for y in kept] == [0, 2, 4, 6, 8]
    for count in [*range(1, 12)] * 3:
        x = np.arange(count, dtype=np.float32)[None]
        np.testing.assert_array_equal(replay.run({"x": x[:, ::-1]}, ["y"])[0], 2 * x[:, ::-1])


def test_networks_loaded_elsewhere_are_not_counted(doubling: Path) -> None:
    load(doubling)
    with networks_used() as used:
        pass
    assert used == []


def test_speed_on_a_gpu() -> None:
    if "CUDAExecutionProvider" not in providers():
        pytest.skip("this machine's ONNX Runtime has no CUDA")
    measured = importlib.import_module("benchmark_gpu").measure("cuda", pairs=5)
    assert measured["frames_per_s"] > 0 and measured["matches"] > 0


def test_the_benchmark_reports_that_there_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    if "CUDAExecutionProvider" in providers():
        pytest.skip("this machine's ONNX Runtime has CUDA")
    monkeypatch.setattr("sys.argv", ["benchmark_gpu.py"])
    with pytest.raises(SystemExit, match="error: features.device is cuda|error: model"):
        importlib.import_module("benchmark_gpu").main()
