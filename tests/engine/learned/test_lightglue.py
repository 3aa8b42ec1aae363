"""Matching by LightGlue: positions, assignment, and its place behind the matcher's contract."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from learned_cases import fetched
from typer.testing import CliRunner

from vo.base.config import FeaturesConfig, MatchingConfig
from vo.base.errors import ConfigError, ModelError
from vo.base.types import Floats32
from vo.cli.app import app
from vo.engine.features.matching import DescriptorMatcher, make_matcher
from vo.engine.frontend.contracts import Circles, FeatureSet
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.learned.inference import Inference, load
from vo.engine.learned.lightglue import (
    AssignmentMatcher,
    LightGlue,
    matches_of,
    normalised,
    partners_of,
)
from vo.engine.learned.xfeat import XFeatExtractor

NEAR = DescriptorMatcher(MatchingConfig(method="mnn"))


def light_glue(network: Inference) -> AssignmentMatcher:
    return AssignmentMatcher(LightGlue(network), NEAR, 0.1)


WIDE, HIGH = (640, 480), (300, 400)


def test_positions_are_relative_to_the_middle_and_the_longer_side() -> None:
    xy = np.array([[320, 240], [0, 0], [640, 480], [480, 120]], np.float32)
    np.testing.assert_array_equal(
        normalised(xy, WIDE), [[0, 0], [-1, -0.75], [1, 0.75], [0.5, -0.375]]
    )
    np.testing.assert_array_equal(
        normalised(np.array([[150.0, 200], [300, 0]]), HIGH), [[0, 0], [0.75, -1]]
    )
    assert normalised(xy, WIDE).dtype == np.float32


def test_matches_are_the_most_probable_of_both_and_above_the_threshold() -> None:
    """Row 0 and column 1 choose each other; 1 chooses 1 in vain; 2 is too improbable."""
    probability = np.array(
        [
            [0.1, 0.8, 0.02, 0.0],
            [0.1, 0.5, 0.02, 0.0],
            [0.01, 0.02, 0.0, 0.09],
            [0.6, 0.1, 0.0, 0.05],
        ]
    )
    found = matches_of(partners_of(np.log(np.maximum(probability, 1e-12)).astype(np.float32)), 0.1)
    assert found.query.tolist() == [0, 3]
    assert found.train.tolist() == [1, 0]
    np.testing.assert_allclose(found.score, [0.2, 0.4], atol=1e-6)
    at_threshold = partners_of(np.log(np.array([[0.25]], np.float32)))
    assert len(matches_of(at_threshold, 0.25 + 1e-6).query) == 0
    assert len(matches_of(at_threshold, 0.25 - 1e-6).query) == 1


class Nearest:
    """Stands for the network: features belong together the nearer they lie."""

    description = "a test"
    is_rewritten = False

    def __init__(self) -> None:
        self.calls: list[dict[str, Floats32]] = []

    def run(self, inputs: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        assert list(outputs) == ["log_assignment"]
        self.calls.append(dict(inputs))
        for name in ("kpts0", "kpts1", "desc0", "desc1"):
            assert inputs[name].dtype == np.float32
            assert inputs[name].shape[0] == 1
        away = np.linalg.norm(inputs["kpts0"][0][:, None] - inputs["kpts1"][0][None], axis=2)
        return [(-10 * away[None]).astype(np.float32)]


def features(xy: Any, size: tuple[int, int] | None = WIDE, descriptor: Any = None) -> FeatureSet:
    count = len(xy)
    rows = np.eye(max(count, 4), dtype=np.float32)[:count] if descriptor is None else descriptor
    nothing = np.full(count, np.nan, np.float32)
    return FeatureSet(np.asarray(xy, np.float64), np.zeros(count, np.int32), nothing, rows, size)


def test_the_network_is_given_each_image_in_its_own_size() -> None:
    network = Nearest()
    query = features([[320.0, 240.0], [640.0, 240.0]], WIDE)
    train = features([[300.0, 200.0], [150.0, 200.0]], HIGH)
    found = light_glue(network).match(query, train)
    assert (found.query.tolist(), found.train.tolist()) == ([0], [1])
    np.testing.assert_array_equal(network.calls[0]["kpts0"], [[[0, 0], [1, 0]]])
    np.testing.assert_array_equal(network.calls[0]["kpts1"], [[[0.75, 0], [0, 0]]])


def test_features_without_a_position_are_left_out() -> None:
    network = Nearest()
    query = features([[np.nan, np.nan], [100.0, 100.0], [np.nan, 5.0], [300.0, 100.0]])
    train = features([[301.0, 100.0], [np.nan, np.nan], [99.0, 100.0]])
    found = light_glue(network).match(query, train)
    assert network.calls[0]["kpts0"].shape == (1, 2, 2)
    assert (found.query.tolist(), found.train.tolist()) == ([1, 3], [2, 0])


def test_where_positions_are_unknown_or_predicted_descriptors_decide() -> None:
    network = Nearest()
    matcher = light_glue(network)
    descriptor = np.eye(4, dtype=np.float32)
    xy = np.array([[10.0, 10], [100, 10], [10, 100], [100, 100]])
    query, train = features(xy, descriptor=descriptor), features(xy[::-1], descriptor=descriptor)
    unplaced = FeatureSet(None, query.octave, query.angle, query.descriptor)
    nowhere = features(np.full((4, 2), np.nan))
    for given in (unplaced, nowhere):
        assert matcher.match(given, train).train.tolist() == [0, 1, 2, 3]
    near = matcher.match(query, train, Circles(np.full(4, 50.0)))
    assert near.train.tolist() == [3, 2, 1, 0]  # the same descriptor lies outside of the circle
    wide = matcher.match(query, train, Circles(np.full(4, 200.0)))
    assert wide.train.tolist() == [0, 1, 2, 3]
    assert not network.calls


def test_no_features_are_no_error() -> None:
    matcher = light_glue(Nearest())
    some, none = (
        features([[1.0, 2.0]]),
        features(np.empty((0, 2)), descriptor=np.empty((0, 4), np.float32)),
    )
    for query, train in ((some, none), (none, some), (none, none)):
        assert len(matcher.match(query, train).query) == 0


def test_images_without_a_size_are_refused() -> None:
    with pytest.raises(ValueError, match="no image size"):
        light_glue(Nearest()).match(features([[1.0, 1.0]], None), features([[1.0, 1.0]]))


def test_a_matcher_needs_the_features_that_it_was_trained_with(synthetic_stereo: Path) -> None:
    orb = FeaturesConfig()
    with pytest.raises(ConfigError, match=r"needs features\.detector=xfeat, not 'orb'"):
        make_matcher(MatchingConfig(method="lighterglue"), OrbExtractor(orb), orb)
    with pytest.raises(ConfigError, match="not features of your own"):
        make_matcher(MatchingConfig(method="lighterglue"), OrbExtractor(orb), None)
    image = str(next(synthetic_stereo.rglob("cam0/data/*.png")))
    result = CliRunner().invoke(app, ["match", image, image, "--matcher", "lightglue"])
    assert result.exit_code == 1
    assert "error: matching.method 'lightglue' needs features.detector=" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_missing_model_names_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VO_MODELS", str(tmp_path))
    config = FeaturesConfig(detector="xfeat")
    with pytest.raises(ModelError, match="vo models fetch lighterglue"):
        make_matcher(MatchingConfig(method="lighterglue"), OrbExtractor(config), config)


@pytest.fixture(scope="module")
def lighterglue() -> Path:
    return fetched("lighterglue")


def test_an_image_matches_itself_feature_by_feature(
    lighterglue: Path, synthetic_stereo: Path
) -> None:
    image = cv2.imread(str(next(synthetic_stereo.rglob("cam0/data/*.png"))), 0)
    assert image is not None
    found = XFeatExtractor(load(fetched("xfeat")), 400).extract(image)
    size = (image.shape[1], image.shape[0])
    every = features(found.xy, size, found.descriptor)
    matches = light_glue(load(lighterglue)).match(every, every)
    np.testing.assert_array_equal(matches.query, matches.train)
    assert len(matches.query) > 0.95 * len(found)
    one = features(found.xy[:1], size, found.descriptor[:1])
    alone = light_glue(load(lighterglue)).match(one, one)
    assert (alone.query.tolist(), alone.train.tolist()) == ([0], [0])


@pytest.mark.parametrize("threads", [1, 2])
def test_the_number_of_threads_changes_no_bit(lighterglue: Path, threads: int) -> None:
    noise = np.random.default_rng(5)
    xy = noise.uniform(0, 480, (300, 2))
    descriptor = noise.standard_normal((300, 64)).astype(np.float32)
    descriptor /= np.linalg.norm(descriptor, axis=1, keepdims=True)
    query, train = features(xy, WIDE, descriptor), features(xy + 7.0, WIDE, descriptor)
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(threads)
        found = light_glue(load(lighterglue)).match(query, train)
        cv2.setNumThreads(4)
        again = light_glue(load(lighterglue)).match(query, train)
    finally:
        cv2.setNumThreads(before)
    assert len(found.query) > 150
    for a, b in zip(found, again, strict=True):
        np.testing.assert_array_equal(a, b)


def test_of_streets_that_look_alike_only_one_and_the_same_has_a_model(
    lighterglue: Path, shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the first pair 37 matches fit a model, more than chance gives; none is a certain one."""
    monkeypatch.setenv("VO_MODELS", str(lighterglue.parent))
    options = ["--detector", "xfeat", "--matcher", "lighterglue", "--json"]
    here = str(shared_data / "kitti07_mono_000-099")
    found = []
    for other in (f"{shared_data / 'kitti_raw_stereo_000-099'}:30", f"{here}:30", f"{here}:20"):
        result = CliRunner().invoke(app, ["match", f"{here}:10", other, *options])
        found.append((result.exit_code, json.loads(result.stdout)["failure_reason"]))
    assert found == [(1, "no_consensus"), (0, None), (0, None)]
