"""SuperGlue: its graph against plain numpy, and optimal transport; no weights are needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learned_cases import BACKENDS, fetch_own_weights, require_backend, saved
from numpy.typing import NDArray

from vo.base.config import MatchingConfig
from vo.engine.features.matching import DescriptorMatcher
from vo.engine.frontend.contracts import FeatureSet
from vo.engine.learned.inference import load
from vo.engine.learned.lightglue import AssignmentMatcher
from vo.engine.learned.superglue import SuperGlue, log_assignment, normalised, superglue_model

pytest.importorskip("onnx")

Array = NDArray[Any]
DIM, HEADS, LAYERS = 16, 4, 4
ENCODER = (3, 8, 12, DIM)


def random_weights() -> dict[str, Array]:
    """Weights in the layout of the authors' files: convolutions of length 1."""
    noise = np.random.default_rng(6)
    weights: dict[str, Array] = {"bin_score": np.array(0.7, np.float32)}

    def convolution(name: str, inputs: int, outputs: int) -> None:
        weights[f"{name}.weight"] = noise.standard_normal((outputs, inputs, 1)) / np.sqrt(inputs)
        weights[f"{name}.bias"] = 0.1 * noise.standard_normal(outputs)

    def perceptron(name: str, channels: tuple[int, ...]) -> None:
        for n, (inputs, outputs) in enumerate(zip(channels, channels[1:], strict=False)):
            convolution(f"{name}.{3 * n}", inputs, outputs)
            if n < len(channels) - 2:
                for part, low, high in (
                    ("weight", 0.5, 1.5),
                    ("bias", -0.2, 0.2),
                    ("running_mean", -0.3, 0.3),
                    ("running_var", 0.5, 2.0),
                ):
                    weights[f"{name}.{3 * n + 1}.{part}"] = noise.uniform(low, high, outputs)
                weights[f"{name}.{3 * n + 1}.num_batches_tracked"] = np.array([5], np.int64)

    perceptron("kenc.encoder", ENCODER)
    for n in range(LAYERS):
        for part in ("attn.merge", "attn.proj.0", "attn.proj.1", "attn.proj.2"):
            convolution(f"gnn.layers.{n}.{part}", DIM, DIM)
        perceptron(f"gnn.layers.{n}.mlp", (2 * DIM, 2 * DIM, DIM))
    convolution("final_proj", DIM, DIM)
    return {
        name: tensor if tensor.dtype == np.int64 else tensor.astype(np.float32)
        for name, tensor in weights.items()
    }


def inputs(*counts: int) -> dict[str, Array]:
    noise = np.random.default_rng(7)
    given = {}
    for side, count in enumerate(counts):
        given[f"kpts{side}"] = noise.uniform(-0.7, 0.7, (1, count, 2)).astype(np.float32)
        given[f"scores{side}"] = noise.uniform(0, 1, (1, count, 1)).astype(np.float32)
        given[f"desc{side}"] = noise.standard_normal((1, count, DIM)).astype(np.float32)
    return given


def reference(weights: dict[str, Array], given: dict[str, Array]) -> Array:
    """SuperGlue as the authors' code computes it, channels first, in double precision."""
    w = {name: tensor.astype(np.float64) for name, tensor in weights.items()}

    def convolution(name: str, x: Array) -> Array:
        return np.asarray(w[f"{name}.weight"][:, :, 0] @ x + w[f"{name}.bias"][:, None])

    def perceptron(name: str, x: Array, layers: int) -> Array:
        for n in range(layers):
            x = convolution(f"{name}.{3 * n}", x)
            if n < layers - 1:
                norm = {
                    part: w[f"{name}.{3 * n + 1}.{part}"][:, None]
                    for part in ("weight", "bias", "running_mean", "running_var")
                }
                x = (x - norm["running_mean"]) / np.sqrt(norm["running_var"] + 1e-5)
                x = np.maximum(x * norm["weight"] + norm["bias"], 0)
        return x

    x = []
    for side in (0, 1):
        position = np.concatenate([given[f"kpts{side}"][0], given[f"scores{side}"][0]], axis=1)
        encoded = perceptron("kenc.encoder", position.T.astype(np.float64), len(ENCODER) - 1)
        x.append(given[f"desc{side}"][0].T + encoded)
    for n in range(LAYERS):
        changes = []
        for side in (0, 1):
            source = x[1 - side] if n % 2 else x[side]
            name = f"gnn.layers.{n}"
            q, k, v = (
                convolution(f"{name}.attn.proj.{part}", each).reshape(DIM // HEADS, HEADS, -1)
                for part, each in enumerate((x[side], source, source))
            )
            scores = np.einsum("dhn,dhm->hnm", q, k) / np.sqrt(DIM // HEADS)
            weight = np.exp(scores - scores.max(axis=2, keepdims=True))
            weight /= weight.sum(axis=2, keepdims=True)
            merged = np.einsum("hnm,dhm->dhn", weight, v).reshape(DIM, -1)
            message = convolution(f"{name}.attn.merge", merged)
            changes.append(perceptron(f"{name}.mlp", np.concatenate([x[side], message]), 2))
        x = [each + change for each, change in zip(x, changes, strict=True)]
    a, b = (convolution("final_proj", each) for each in x)
    return np.asarray(a.T @ b / np.sqrt(DIM))


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_graph_computes_what_the_paper_describes(backend: str, tmp_path: Path) -> None:
    require_backend(backend)
    weights = random_weights()
    network = saved(superglue_model(weights), tmp_path, backend)
    for counts in ((30, 40), (1, 1), (7, 1), (30, 40)):
        given = inputs(*counts)
        similarity, bin_score = network.run(given, ["similarity", "bin_score"])
        assert bin_score.reshape(-1).tolist() == pytest.approx([0.7])
        np.testing.assert_allclose(similarity[0], reference(weights, given), atol=1e-4)


def test_positions_are_relative_to_the_middle_and_the_longer_side() -> None:
    found = normalised(np.array([[320.0, 240.0], [768.0, 240.0], [320.0, 16.0]]), (640, 480))
    np.testing.assert_allclose(found, [[0, 0], [1, 0], [0, -0.5]])


def in_logarithms(similarity: Array, bin_score: float) -> Array:
    """Sinkhorn's iterations as in the authors' code, on logarithms."""

    def log_sum(x: Array, axis: int) -> Array:
        top = x.max(axis=axis, keepdims=True)
        return np.asarray(np.log(np.exp(x - top).sum(axis=axis)) + np.squeeze(top, axis))

    m, n = similarity.shape
    z = np.full((m + 1, n + 1), bin_score)
    z[:m, :n] = similarity
    norm = -np.log(m + n)
    mu, nu = np.full(m + 1, norm), np.full(n + 1, norm)
    mu[-1], nu[-1] = np.log(n) + norm, np.log(m) + norm
    u, v = np.zeros(m + 1), np.zeros(n + 1)
    for _ in range(100):
        u = mu - log_sum(z + v[None], 1)
        v = nu - log_sum(z + u[:, None], 0)
    return np.asarray((z + u[:, None] + v[None] - norm)[:m, :n])


@pytest.mark.parametrize("scale", [0.1, 3.0, 60.0])
@pytest.mark.parametrize("shape", [(1, 1), (5, 9), (40, 30)])
def test_optimal_transport_is_that_of_the_authors(shape: tuple[int, int], scale: float) -> None:
    noise = np.random.default_rng(8)
    similarity = (scale * noise.standard_normal(shape)).astype(np.float32)
    found = log_assignment(similarity, 0.7)
    expected = in_logarithms(similarity.astype(np.float64), 0.7)
    np.testing.assert_allclose(np.exp(found), np.exp(expected), atol=1e-9)
    assert np.exp(found).sum(axis=0).max() <= 1 + 1e-9  # each feature once


def test_clear_pairs_are_matched_and_others_go_to_the_bin() -> None:
    """By hand: with one feature each, both choose the pair or both the bin: 1 / (1 + 1)."""
    similarity = np.full((3, 3), -20.0, np.float32)
    similarity[0, 2] = similarity[1, 0] = 20.0
    probability = np.exp(log_assignment(similarity, 1.0))
    np.testing.assert_allclose(probability, [[0, 0, 1], [1, 0, 0], [0, 0, 0]], atol=0.01)
    alone = np.exp(log_assignment(np.array([[2.0]], np.float32), 2.0))
    np.testing.assert_allclose(alone, [[0.5]])


def features(count: int, *, has_response: bool = True) -> FeatureSet:
    given = inputs(count, count)
    xy = given["kpts0"][0] * 300 + 320
    nothing, octave = np.full(count, np.nan, np.float32), np.zeros(count, np.int32)
    response = given["scores0"][0, :, 0] if has_response else None
    return FeatureSet(xy, octave, nothing, given["desc0"][0], (640, 480), response)


def test_a_file_of_the_user_becomes_a_matcher(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "models"))
    path = fetch_own_weights("superglue", random_weights(), "final_proj.weight", tmp_path)
    near = DescriptorMatcher(MatchingConfig(method="mnn"))
    matcher = AssignmentMatcher(SuperGlue(load(path)), near, 0.0)
    query, train = features(20, has_response=False), features(20)
    found = matcher.match(query, train)
    assert len(found.query) > 0
    assert len(np.unique(found.train)) == len(found.train)
    assert ((found.score >= 0) & (found.score <= 1)).all()
