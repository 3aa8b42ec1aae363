"""`features.detector=onnx:FILE`: the documented layout, and files with other ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from learned_cases import BACKENDS, require_backend, textured
from typer.testing import CliRunner

from vo.base.config import load_config
from vo.base.errors import ConfigError, ModelError
from vo.cli.app import app
from vo.engine.features.extractor import make_extractor
from vo.engine.frontend.contracts import FeatureExtractor
from vo.tools.laboratory.methods import make_method

pytest.importorskip("onnx")

XY = np.array([[4.0, 5.0], [20.0, 9.0], [63.0, 40.0], [40.0, 20.0]], np.float32)
SCORES = np.array([0.2, 0.9, 0.5, 0.4], np.float32)
DESCRIPTORS = np.array([[3, 4, 0], [0, 2, 0], [1, 0, 0], [0, 0, 5]], np.float32)


def network(path: Path, channels: int = 1, **changes: Any) -> Path:
    """A network that finds the same four points in each image."""
    from vo.engine.learned.graph import GraphBuilder

    values = {"keypoints": XY[None], "scores": SCORES[None], "descriptors": DESCRIPTORS[None]}
    values |= changes
    graph = GraphBuilder({})
    zero = graph.convolution("image", np.zeros((1, channels, 1, 1), np.float32), None)
    zero = graph.node("ReduceMax", zero, keepdims=0)
    outputs = {}
    for name, value in values.items():
        if value is not None:
            outputs[name] = (graph.node("Add", graph.constant(value), zero), value.shape)
    model = graph.model({"image": (1, channels, "H", "W")}, outputs, "own")
    path.write_bytes(model.SerializeToString())
    return path


def extractor(path: Path, backend: str = "opencv") -> FeatureExtractor:
    settings = [f"features.detector=onnx:{path}", f"features.backend={backend}"]
    return make_extractor(load_config("default", settings).features)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("backend", BACKENDS)
def test_features_of_the_documented_layout(backend: str, channels: int, tmp_path: Path) -> None:
    """Strongest first, inside of the image and of the mask, with descriptors of unit length."""
    require_backend(backend)
    found = extractor(network(tmp_path / "own.onnx", channels), backend)
    assert found.descriptor_format == (3, np.dtype(np.float32))
    features = found.extract(textured((41, 64)))
    np.testing.assert_array_equal(features.xy, XY[[1, 2, 3, 0]])
    np.testing.assert_array_equal(features.response, SCORES[[1, 2, 3, 0]])
    np.testing.assert_allclose(features.descriptor[3], [0.6, 0.8, 0])
    mask = np.full((41, 64), 255, np.uint8)
    mask[9, 20] = 0
    np.testing.assert_array_equal(found.extract(textured((41, 64)), mask).xy, XY[[2, 3, 0]])
    np.testing.assert_array_equal(found.extract(textured((40, 63))).xy, XY[[1, 3, 0]])
    assert len(found.extract(textured((32, 64)))) == 0


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "changes",
    [
        {"scores": None},
        {"keypoints": np.zeros((1, 4, 3), np.float32)},
        {"descriptors": DESCRIPTORS[None, :3]},
        {"descriptors": np.zeros((1, 4, 5000), np.float32)},
        {"scores": np.full((1, 4), np.nan, np.float32)},
        {"keypoints": XY[None] * 1e9},
        {"channels": 2},
    ],
)
def test_other_inputs_and_outputs_are_one_line(
    backend: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    require_backend(backend)
    path = network(tmp_path / "own.onnx", **changes)
    with pytest.raises(ModelError, match=r"own\.onnx has .*expected are") as caught:
        extractor(path, backend)
    assert "\n" not in str(caught.value)


def test_missing_damaged_and_empty_files_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="there is no file"):
        extractor(tmp_path / "nope.onnx")
    whole = network(tmp_path / "own.onnx").read_bytes()
    for content in (b"", b"nothing of this kind", whole[: len(whole) // 2]):
        (tmp_path / "bad.onnx").write_bytes(content)
        with pytest.raises(ModelError, match=r"bad\.onnx"):
            extractor(tmp_path / "bad.onnx")
    with pytest.raises(ConfigError, match="has its own descriptor"):
        settings = [f"features.detector=onnx:{tmp_path}", "features.descriptor=sift"]
        make_extractor(load_config("default", settings).features)
    with pytest.raises(ConfigError, match="or 'onnx:FILE'"):
        load_config("default", ["features.detector=nope"])


def test_a_method_may_name_a_matcher_behind_the_path(tmp_path: Path) -> None:
    path = network(tmp_path / "own.onnx")
    config = load_config("default", [])
    for name in (f"onnx:{path}", f"onnx:{path}/mnn"):
        method = make_method(name, config.features, config.matching)
        matched = method.match(textured((64, 64)), textured((64, 64)))
        np.testing.assert_array_equal(matched.first, matched.second)
        assert len(matched.first) == 4


@pytest.mark.parametrize(("choice", "used"), [([], "mnn"), (["--matcher", "flann"], "flann")])
def test_the_matcher_that_was_used_is_printed(choice: list[str], used: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured((64, 64)))
    image, detector = str(tmp_path / "a.png"), f"onnx:{network(tmp_path / 'own.onnx')}"
    result = CliRunner().invoke(app, ["match", image, image, "--detector", detector, *choice])
    assert f"4 ({used})" in result.stdout, result.stderr


def test_the_command_reports_what_is_wrong(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured((64, 64)))
    words = ["features", str(tmp_path / "a.png"), "--detector"]
    good = CliRunner().invoke(app, [*words, f"onnx:{network(tmp_path / 'own.onnx')}"])
    assert good.exit_code == 0, good.stderr
    bad = CliRunner().invoke(app, [*words, f"onnx:{tmp_path / 'nope.onnx'}"])
    assert bad.exit_code == 1
    assert len(bad.stderr.strip().splitlines()) == 1
