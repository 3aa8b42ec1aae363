"""Places made of the keyframes of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from windows import blank_keypoints

from vo.base.config import FeaturesConfig, load_config
from vo.base.geometry.transforms import adjoint, inverse, so3_exp
from vo.base.geometry.transforms import make_transform as transform_of
from vo.base.types import Bytes, Floats
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.mapping.keyframe_motion import motion_covariance, motion_covariances
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.memory.place_maker import PlaceMaker
from vo.engine.odometry import Odometry
from vo.engine.places.patch_sampling import sampled_patches
from vo.engine.places.records import PATCH_PX, Place, PlaceKey
from vo.engine.stages import Components
from vo.recordings.sources.registry import open_source


class PlaceStore:
    """Makes a place of each keyframe."""

    def __init__(self, *, is_metric: bool) -> None:
        self.places: list[Place] = []
        self.keyframes: list[Keyframe] = []
        self.landmarks: list[StoredLandmarks] = []
        self.image: Bytes = np.empty((0, 0), np.uint8)  # of the newest
        self._maker = PlaceMaker(3, 1.44, is_metric=is_metric)

    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        of_path = self._maker.follow(keyframe)
        self.places.append(self._maker.make(of_path, keyframe, landmarks(), image))
        self.keyframes.append(keyframe)
        self.landmarks.append(landmarks())
        self.image = image.copy()


@pytest.fixture(scope="module", params=["stereo", "mono"])
def store(synthetic_stereo: Path, request: pytest.FixtureRequest) -> PlaceStore:
    source = open_source(synthetic_stereo, mode=request.param)
    store = PlaceStore(is_metric=source.rig.is_metric)
    settings = ["smoothing.window=3", "smoothing.fixed=1", "keyframes.max_gap_s=0.1"]
    config = load_config("fast", settings)
    odometry = Odometry(source.rig, config, Components(keyframe_store=store))
    for _ in odometry.track_all(source.frames(0, 18)):
        pass
    odometry.finish()
    odometry.close()
    return store


def test_each_keyframe_has_a_place_with_its_landmarks(store: PlaceStore) -> None:
    assert len(store.places) > 4
    for place, keyframe in zip(store.places, store.keyframes, strict=True):
        assert place.key == PlaceKey(3, keyframe.id)
        landmarks, count = place.landmarks, len(place.landmarks.id)
        assert count > 100
        assert np.all(np.diff(landmarks.id) > 0)
        assert landmarks.patch.shape == (count, PATCH_PX, PATCH_PX)
        lengths = {len(value) for value in vars(landmarks).values()}
        assert lengths == {count}
        rows = np.searchsorted(np.sort(keyframe.landmark), landmarks.id)
        expected = keyframe.xy[np.argsort(keyframe.landmark)][rows]
        np.testing.assert_allclose(landmarks.xy, expected, atol=1e-3)
        assert np.all(landmarks.xyz[:, 2] > 0)
        assert 0.0 < np.median(landmarks.sigma) < 0.3
        assert place.thumbnail.shape[0] == 120


def test_motions_have_a_covariance_that_grows_less_than_that_of_the_poses(
    store: PlaceStore,
) -> None:
    assert not store.places[0].covariance.any()
    for place in store.places[1:]:
        assert np.linalg.eigvalsh(place.covariance)[0] > 0.0
    last = store.keyframes[-2]
    assert last.covariance is not None
    assert np.trace(store.places[-2].covariance) < np.trace(last.covariance)


def test_motion_of_independent_steps_has_the_covariance_of_the_last_step() -> None:
    """If `next = before @ motion` with independent errors, that of the motion comes out."""
    rng = np.random.default_rng(0)
    of_before, of_motion = (a @ a.T for a in rng.normal(size=(2, 6, 6)))
    before_from_next = transform_of(so3_exp(np.array([0.1, -0.2, 0.05])), np.array([0.3, 0.1, 2.0]))
    moved = adjoint(inverse(before_from_next))
    before = _keyframe(0, np.eye(4), of_before, {})
    after = _keyframe(
        1, before_from_next, moved @ of_before @ moved.T + of_motion, {0: moved @ of_before}
    )
    np.testing.assert_allclose(motion_covariance(before, after), of_motion, rtol=1e-6, atol=1e-9)


def test_all_motions_at_once_have_the_covariances_of_each() -> None:
    rng = np.random.default_rng(1)
    keyframes = []
    for number in range(6):
        pose = transform_of(so3_exp(0.1 * rng.normal(size=3)), rng.normal(size=3))
        root = rng.normal(size=(6, 6))
        covariance = None if number == 3 else root @ root.T
        cross = {} if number == 2 else {number - 1: 0.1 * rng.normal(size=(6, 6))}
        keyframes.append(_keyframe(number, pose, covariance, cross))
    frame = replace(keyframes[5].frame, segment=1)
    keyframes[5] = replace(keyframes[5], frame=frame)
    expected = [motion_covariance(*pair) for pair in pairwise(keyframes)]
    np.testing.assert_array_equal(motion_covariances(keyframes), expected)
    assert motion_covariances(keyframes[:1]) == motion_covariances([]) == []


def test_a_keyframe_makes_a_place_if_enough_of_its_landmarks_are_new(store: PlaceStore) -> None:
    keyframe, maker = store.keyframes[2], PlaceMaker(3, 1.44, is_metric=True)
    image = np.zeros_like(store.image)
    for _ in range(10):
        assert maker.shows_new(keyframe)
        maker.make(maker.follow(keyframe), keyframe, store.landmarks[2], image)
    ids = keyframe.landmark
    for share, is_new in ((0.0, False), (0.25, False), (0.35, True), (1.0, True)):
        count = round(share * len(ids))
        changed = np.concatenate([ids[count:], ids[:count] + 100_000])
        assert maker.shows_new(replace(keyframe, landmark=changed)) == is_new
    assert maker.shows_new(replace(keyframe, is_doubted=True))
    assert maker.shows_new(replace(keyframe, frame=replace(keyframe.frame, segment=1)))


def test_patches_are_of_the_pyramid_level_of_their_feature() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (60, 80), dtype=np.uint8)
    xy = np.array([[30.0, 20.0], [40.0, 30.0], [0.0, 0.0]])
    found = sampled_patches(image, xy, np.array([0, 1, 0], np.int32), 2.0)
    np.testing.assert_array_equal(found[0], image[14:27, 24:37])
    half = image.reshape(30, 2, 40, 2).mean(axis=(1, 3))
    # Pixel (40, 30) has its centre at (19.75, 14.75) of the image of half the size.
    column = 0.25 * half[:, :-1] + 0.75 * half[:, 1:]
    expected = (0.25 * column[:-1] + 0.75 * column[1:])[8:21, 13:26]
    assert np.abs(found[1] - expected).max() < 2.0
    assert (found[2][:7, :7] == image[0, 0]).all()


def _keyframe(
    number: int, world_from_cam: Floats, covariance: Floats, cross: dict[int, Floats]
) -> Keyframe:
    nothing = np.empty((0, 2))
    return Keyframe(
        number,
        FrameId(number, number, 0),
        0,
        world_from_cam,
        covariance,
        cross,
        blank_keypoints(0),
        lambda: nothing,
        np.empty(0, bool),
        np.empty(0, np.int64),
        nothing,
        nothing,
        np.empty(0),
        np.empty(0),
    )


class OtherKind(PlaceStore):
    """Keyframes whose features are of another kind, as after a rescue, become places as well."""

    def __init__(self) -> None:
        super().__init__(is_metric=False)
        self._describer = OrbExtractor(FeaturesConfig(count=300))
        self._other = PlaceMaker(3, 1.44, is_metric=False, describer=self._describer)
        self.described: list[Place] = []

    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        super().add(keyframe, landmarks, image)
        floats = replace(
            keyframe.keypoints, descriptor=np.zeros((len(keyframe.keypoints.xy), 64), np.float32)
        )
        known = landmarks()
        other = known._replace(descriptor=np.zeros((len(known.id), 64), np.float32))
        changed = replace(keyframe, keypoints=floats)
        of_path = self._other.follow(changed)
        self.described.append(self._other.make(of_path, changed, other, image))


def test_places_have_one_kind_of_descriptors(synthetic_stereo: Path) -> None:
    source = open_source(synthetic_stereo, mode="mono")
    store = OtherKind()
    odometry = Odometry(source.rig, load_config("fast"), Components(keyframe_store=store))
    for _ in odometry.track_all(source.frames(0, 18)):
        pass
    odometry.close()
    assert len(store.described) > 1
    for place, usual in zip(store.described, store.places, strict=True):
        count = len(usual.landmarks.id)
        assert place.descriptor.shape[1] == 32 and place.descriptor.dtype == np.uint8
        assert len(place.descriptor) > 100
        assert place.landmarks.descriptor.shape == (count, 32)
        np.testing.assert_array_equal(place.landmarks.xyz, usual.landmarks.xyz)
        # The same points of the same image: those of the largest level have the same descriptors.
        same = usual.landmarks.octave == 0
        bits = np.unpackbits(place.landmarks.descriptor ^ usual.landmarks.descriptor, axis=1)
        assert np.median(bits[same].sum(axis=1)) < 64
