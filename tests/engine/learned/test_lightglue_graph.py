"""The graphs of LightGlue against plain numpy, and against a file that torch has exported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from learned_cases import BACKENDS, SHARED, exported, fetched, require_backend, saved
from numpy.typing import NDArray

from vo.base.types import Floats32
from vo.engine.frontend.contracts import FeatureSet
from vo.engine.learned.inference import load
from vo.engine.learned.lightglue import (
    LightGlue,
    lightglue_model,
    matches_of,
    normalised,
    padded_model,
    partners_of,
)
from vo.engine.learned.replay import Replay
from vo.engine.learned.xfeat import XFeatExtractor

pytest.importorskip("onnx")

Array = NDArray[Any]
DIM, HEADS, LAYERS, WIDTH = 16, 2, 3, 10


def random_weights(*, old_names: bool = False, projected: bool = True) -> dict[str, Array]:
    """Weights in the layout of the authors' files."""
    noise = np.random.default_rng(3)
    shapes: dict[str, tuple[int, ...]] = {"posenc.Wr.weight": (DIM // HEADS // 2, 2)}

    def layer(name: str, inputs: int, outputs: int) -> None:
        shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (outputs, inputs), (outputs,)

    if projected:
        layer("input_proj", WIDTH, DIM)
    for n in range(LAYERS):
        kinds = ["self_attn", "cross_attn"]
        both = [f"{k}.{n}" if old_names else f"transformers.{n}.{k}" for k in kinds]
        layer(f"{both[0]}.Wqkv", DIM, 3 * DIM)
        layer(f"{both[0]}.out_proj", DIM, DIM)
        for part in ("to_qk", "to_v", "to_out"):
            layer(f"{both[1]}.{part}", DIM, DIM)
        for name in both:
            layer(f"{name}.ffn.0", 2 * DIM, 2 * DIM)
            shapes[f"{name}.ffn.1.weight"] = shapes[f"{name}.ffn.1.bias"] = (2 * DIM,)
            layer(f"{name}.ffn.3", 2 * DIM, DIM)
        layer(f"log_assignment.{n}.matchability", DIM, 1)
        layer(f"log_assignment.{n}.final_proj", DIM, DIM)
    scale = {name: 1 / np.sqrt(shape[-1]) for name, shape in shapes.items()}
    scale["posenc.Wr.weight"] = 2.0
    return {
        name: (scale[name] * noise.standard_normal(shape)).astype(np.float32)
        for name, shape in shapes.items()
    }


def inputs(queries: int, trains: int, width: int = WIDTH) -> dict[str, Floats32]:
    noise = np.random.default_rng(4)
    given = {
        "kpts0": noise.uniform(-1, 1, (1, queries, 2)),
        "kpts1": noise.uniform(-1, 1, (1, trains, 2)),
        "desc0": noise.standard_normal((1, queries, width)),
        "desc1": noise.standard_normal((1, trains, width)),
    }
    return {name: value.astype(np.float32) for name, value in given.items()}


def softmax(x: Array, axis: int = -1) -> Array:
    e = np.exp(x - x.max(axis=axis, keepdims=True))
    return np.asarray(e / e.sum(axis=axis, keepdims=True))


class Reference:
    """LightGlue as the authors' code computes it, feature by feature, in double precision."""

    def __init__(self, weights: dict[str, Array]) -> None:
        self.weights = {name: tensor.astype(np.float64) for name, tensor in weights.items()}

    def linear(self, name: str, x: Array) -> Array:
        return x @ self.weights[f"{name}.weight"].T + self.weights[f"{name}.bias"]

    def ffn(self, name: str, x: Array, message: Array) -> Array:
        from math import erf

        y = self.linear(f"{name}.ffn.0", np.concatenate([x, message], axis=1))
        y = (y - y.mean(axis=1, keepdims=True)) / np.sqrt(y.var(axis=1, keepdims=True) + 1e-5)
        y = y * self.weights[f"{name}.ffn.1.weight"] + self.weights[f"{name}.ffn.1.bias"]
        y = 0.5 * y * (1 + np.vectorize(erf)(y / np.sqrt(2)))
        return x + self.linear(f"{name}.ffn.3", y)

    def rotate(self, x: Array, xy: Array) -> Array:
        """Neighbouring channels of each head by the angle of their frequency."""
        angle = xy @ self.weights["posenc.Wr.weight"].T
        result = np.empty_like(x)
        for head in range(HEADS):
            for n in range(angle.shape[1]):
                at = head * (DIM // HEADS) + 2 * n
                a, b, c, s = x[:, at], x[:, at + 1], np.cos(angle[:, n]), np.sin(angle[:, n])
                result[:, at], result[:, at + 1] = a * c - b * s, b * c + a * s
        return result

    def attend(self, q: Array, k: Array, v: Array) -> Array:
        d = DIM // HEADS
        parts = [slice(h * d, (h + 1) * d) for h in range(HEADS)]
        return np.concatenate(
            [softmax(q[:, p] @ k[:, p].T / np.sqrt(d)) @ v[:, p] for p in parts], axis=1
        )

    def run(self, given: dict[str, Floats32]) -> Array:
        xy = [given[f"kpts{n}"][0].astype(np.float64) for n in (0, 1)]
        x = [given[f"desc{n}"][0].astype(np.float64) for n in (0, 1)]
        if "input_proj.weight" in self.weights:
            x = [self.linear("input_proj", each) for each in x]
        for n in range(LAYERS):
            name = f"transformers.{n}.self_attn"
            for side in (0, 1):
                qkv = self.linear(f"{name}.Wqkv", x[side]).reshape(-1, DIM, 3)
                q, k = (self.rotate(qkv[:, :, part], xy[side]) for part in (0, 1))
                message = self.linear(f"{name}.out_proj", self.attend(q, k, qkv[:, :, 2]))
                x[side] = self.ffn(name, x[side], message)
            name = f"transformers.{n}.cross_attn"
            k0, k1 = (self.linear(f"{name}.to_qk", each) for each in x)
            v0, v1 = (self.linear(f"{name}.to_v", each) for each in x)
            messages = self.attend(k0, k1, v1), self.attend(k1, k0, v0)
            x = [
                self.ffn(name, each, self.linear(f"{name}.to_out", message))
                for each, message in zip(x, messages, strict=True)
            ]
        last = f"log_assignment.{LAYERS - 1}"
        a, b = (self.linear(f"{last}.final_proj", each) / DIM**0.25 for each in x)
        z0, z1 = (1 / (1 + np.exp(-self.linear(f"{last}.matchability", each))) for each in x)
        both = softmax(a @ b.T, 1) * softmax(a @ b.T, 0)
        return np.asarray(np.log(both * z0 * z1.T))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("projected", [True, False])
def test_the_graph_computes_what_the_paper_describes(
    backend: str, projected: bool, tmp_path: Path
) -> None:
    require_backend(backend)
    weights = random_weights(projected=projected)
    network = saved(lightglue_model(weights, HEADS), tmp_path, backend)
    reference = Reference(weights)
    for counts in ((30, 40), (1, 1), (1, 7), (50, 2), (30, 40)):
        given = inputs(*counts, WIDTH if projected else DIM)
        (found,) = network.run(given, ["log_assignment"])
        assert found.shape == (1, *counts)
        np.testing.assert_allclose(found[0], reference.run(given), atol=1e-4)


class OnSizesOfACard:
    """A network as a card runs it, on the CPU."""

    description = "a test"
    is_rewritten = True

    def __init__(self, model: bytes) -> None:
        runtime = pytest.importorskip("onnxruntime")
        session = runtime.InferenceSession(padded_model(model), providers=["CPUExecutionProvider"])
        self._replay = Replay(session, "cpu")
        self.sizes: set[int] = set()

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Any]:
        self.sizes |= {value.shape[1] for name, value in inputs.items() if name[:4] == "kpts"}
        return self._replay.run(inputs, outputs)


def test_inputs_continued_to_fixed_sizes_give_the_same_partners(tmp_path: Path) -> None:
    """As many as there is room for, fewer, and one; each size also with the arrays kept for it."""
    model = lightglue_model(random_weights(), HEADS)
    plain = LightGlue(saved(model, tmp_path, "onnxruntime"))
    card = OnSizesOfACard(model.SerializeToString())
    padded, noise = LightGlue(card), np.random.default_rng(5)
    for counts in ((256, 256), (30, 40), (200, 1), (1, 1), (257, 9), (41, 30), (300, 310)):
        pair = [
            FeatureSet(
                noise.uniform(0, 400, (count, 2)),
                np.zeros(count, np.int32),
                np.zeros(count, np.float32),
                noise.standard_normal((count, WIDTH)).astype(np.float32),
                (640, 480),
            )
            for count in counts
        ]
        expected, found = plain(*pair), padded(*pair)
        np.testing.assert_array_equal(found.train, expected.train)
        np.testing.assert_array_equal(found.query, expected.query)
        np.testing.assert_allclose(found.log_probability, expected.log_probability, atol=1e-4)
        assert (len(found.train), len(found.query)) == counts
    assert card.sizes == {256, 512}


def test_older_names_of_weights_are_known() -> None:
    new = lightglue_model(random_weights(), HEADS)
    old = lightglue_model(random_weights(old_names=True), HEADS)
    assert new.SerializeToString() == old.SerializeToString()


def test_missing_weights_are_named() -> None:
    weights = random_weights()
    del weights["transformers.1.cross_attn.to_v.bias"]
    with pytest.raises(KeyError, match=r"transformers\.1\.cross_attn\.to_v\.bias"):
        lightglue_model(weights, HEADS)


@pytest.fixture(scope="module")
def expected_pairs() -> list[tuple[dict[str, Array], Array, Array]]:
    """Inputs for ten pairs of images, and the pairs and scores of the authors' file."""
    runtime = pytest.importorskip("onnxruntime")
    exported_session = runtime.InferenceSession(str(exported("lighterglue.onnx")))
    extractor = XFeatExtractor(load(fetched("xfeat")), 512)
    expected = []
    for images in image_pairs():
        given = {}
        for n, image in enumerate(images):
            found = extractor.extract(image)
            size = (image.shape[1], image.shape[0])
            given[f"kpts{n}"] = normalised(found.xy, size)[None]
            given[f"desc{n}"] = found.descriptor[None]
        expected.append((given, *exported_session.run(None, given)))
    return expected


def image_pairs() -> Iterator[tuple[Array, Array]]:
    """Ten pairs of images of two recordings."""
    hall = sorted((SHARED / "data/rendered_hall_stereo/mav0/cam0/data").glob("*.png"))
    drive = sorted((SHARED / "data/kitti07_mono_000-099/image_0").glob("*.png"))
    if len(hall) < 160 or len(drive) < 100:
        pytest.skip(f"the recordings are not at {SHARED / 'data'}")
    for files, gap in ((hall, 30), (drive, 5)):
        for first in range(2, 92, 18):
            pair = [cv2.imread(str(files[n]), 0) for n in (first, first + gap)]
            assert pair[0] is not None
            assert pair[1] is not None
            yield pair[0], pair[1]


@pytest.mark.parametrize("backend", BACKENDS)
def test_our_lighterglue_gives_the_matches_of_the_authors(
    backend: str, expected_pairs: list[tuple[dict[str, Array], Array, Array]]
) -> None:
    """Scores differ as much as those of two programs that run the authors' file."""
    ours = load(fetched("lighterglue"), backend)  # type: ignore[arg-type]
    differences = []
    for given, pairs, score in expected_pairs:
        (assignment,) = ours.run(given, ["log_assignment"])
        matches = matches_of(partners_of(assignment[0]), 0.1)
        np.testing.assert_array_equal(np.stack(matches[:2], axis=1), pairs)
        assert len(pairs) > 50
        differences.append(np.abs(1.0 - matches.score - score))
    assert np.concatenate(differences).mean() < 2e-5
    assert np.concatenate(differences).max() < 1e-3
