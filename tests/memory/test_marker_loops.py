"""Loops by markers: simulated paths, and a rendered room to which only a marker leads back."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_views import Placed, render
from room_course import ate, run_rounds

from vo.backend.pose_graph import PoseGraph
from vo.formats.trajectory import read_tum
from vo.geometry import sim3
from vo.geometry.similarity import umeyama
from vo.geometry.transforms import inverse, make_transform, so3_exp
from vo.mapping.keyframe import FrameId
from vo.markers.marker_problem import MarkerView
from vo.markers.plane_pose import plane_pose, square_points
from vo.memory.marker_loops import MarkerLoops
from vo.places.records import Loop, Place, PlacedKeyframes, PlaceKey, PlaceLandmarks
from vo.scaling.creation import ScaleOptions
from vo.sources.registry import open_source
from vo.types import Camera, Floats

LENGTH_M = 0.3
CAMERA = Camera(640, 480, 400.0, 400.0, 319.5, 239.5)
LAP, STEP_NS = 100, 300_000_000  # keyframes of a lap of 40 m, and the time between two
RADIUS_M = 40.0 / (2.0 * np.pi)


def _truth(keyframes: int) -> Floats:
    """(n, 4, 4) poses of a camera that goes round and looks ahead; y is down."""
    angle = 2.0 * np.pi * np.arange(keyframes) / LAP
    bob = 0.05 * np.sin(0.7 * np.arange(keyframes))
    position = np.column_stack([RADIUS_M * np.cos(angle), bob, RADIUS_M * np.sin(angle)])
    return np.stack(
        [
            make_transform(so3_exp(np.array([0.0, -a, 0.0])), p)
            for a, p in zip(angle, position, strict=True)
        ]
    )


def _odometry(truth: Floats, rng: np.random.Generator, *, noise: float, is_metric: bool) -> Floats:
    """The path with random errors of each step, and in mono with a scale that drifts."""
    poses, log_scale = [np.eye(4)], 0.0
    for step in inverse(truth[:-1]) @ truth[1:]:
        turn = so3_exp(rng.normal(0.0, 5e-4 * noise, 3))
        log_scale += 0.0 if is_metric else rng.normal(0.0, 0.004 * noise)
        moved = step @ make_transform(turn, rng.normal(0.0, 0.002 * noise, 3))
        moved[:3, 3] *= np.exp(log_scale)
        poses.append(poses[-1] @ moved)
    return np.array(poses)


def _marker(truth: Floats, at: int, aside_m: float = 0.0) -> Floats:
    """world_from_marker of a marker 2.5 m ahead of a keyframe and to its right."""
    facing = so3_exp(np.array([np.pi, 0.0, 0.0])) @ so3_exp(np.array([0.2, 0.3, 0.1]))
    return truth[at] @ make_transform(facing, np.array([0.3 + aside_m, -0.3, 2.5]))


def _view(
    frame: int, number: int, seen: Floats, rng: np.random.Generator, corner_px: float
) -> MarkerView | None:
    points = square_points(LENGTH_M) @ seen[:3, :3].T + seen[:3, 3]
    if points[:, 2].min() < 0.5 or points[:, 2].max() > 4.0:
        return None
    pixels = 400.0 * points[:, :2] / points[:, 2:] + (CAMERA.cx, CAMERA.cy)
    pixels = pixels + rng.normal(0.0, corner_px, (4, 2))
    if pixels.min() < 0 or (pixels > (639, 479)).any():
        return None
    sigma = max(corner_px, 0.02)
    pose = plane_pose(CAMERA, square_points(LENGTH_M), pixels, sigma)
    assert pose is not None
    rays = (pixels - (CAMERA.cx, CAMERA.cy)) / 400.0
    shared = np.full(2, sigma / 400.0), (pose.cam_from_marker,), np.eye(4), LENGTH_M
    return MarkerView(frame, frame * STEP_NS, number, rays, *shared, pose.is_ambiguous)


@dataclass
class Course:
    """A path with markers, and the loops that it gives."""

    truth: Floats
    odometry: Floats
    markers: MarkerLoops
    places: list[Place] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)

    def placed(self) -> PlacedKeyframes:
        graph = PoseGraph()
        for place in self.places:
            graph.add_keyframe(place)
        for loop in self.loops:
            graph.add_loop(loop)
        graph.submit(doubted=self.markers.repeated)
        placed = graph.result()
        self.markers.refuse(placed.rejected)
        return placed

    def error_m(self, poses: Floats) -> float:
        """RMS error of positions after alignment, in mono with a scale."""
        scales = not self.places[0].is_metric
        found = umeyama(poses[:, :3, 3], self.truth[:, :3, 3], with_scale=scales)
        apart = found.transform_poses(poses)[:, :3, 3] - self.truth[:, :3, 3]
        return float(np.sqrt((apart**2).sum(axis=1).mean()))


def _course(
    markers: dict[int, list[Floats]],
    *,
    seed: int = 0,
    keyframes: int = 2 * LAP + 20,
    is_metric: bool = True,
    noise: float = 1.0,
    cut: int | None = None,
    moved_at: int = 10**9,
) -> Course:
    """A course with markers by their ids.

    Args:
        markers: poses of those with each id; the second one replaces the first at `moved_at`.
        seed: of all noise.
        keyframes: number of keyframes.
        is_metric: whether it is a path of two cameras.
        noise: factor on all errors of odometry and of corners, which are 0.1 pixels.
        cut: keyframe at which a new segment begins, None for one segment.
        moved_at: keyframe from which the second pose holds; 0 for both at any time.
    """
    rng = np.random.default_rng(seed)
    truth = _truth(keyframes)
    odometry = _odometry(truth, rng, noise=noise, is_metric=is_metric)
    if cut is not None:
        odometry[cut:] = inverse(odometry[cut]) @ odometry[cut:]
    loops = MarkerLoops(np.eye(4), is_metric=is_metric)
    course = Course(truth, odometry, loops)
    covariance = np.diag(np.r_[np.full(3, 5e-4**2), np.full(3, 2e-3**2)])
    for n in range(keyframes):
        views, ids = [], []
        for number, poses in markers.items():
            shown = poses if moved_at == 0 else [poses[-1] if n >= moved_at else poses[0]]
            for pose in shown:
                view = _view(n, number, inverse(truth[n]) @ pose, rng, 0.1 * noise)
                views += [] if view is None else [view]
                ids += [] if view is None else [number]
        repeated = [number for number in markers if ids.count(number) > 1]
        loops.see(n, [view for view in views if view.id not in repeated], repeated)
        segment = 0 if cut is None or n < cut else 1
        place = _place(n, segment, odometry[n], covariance, is_metric=is_metric)
        course.places.append(place)
        course.loops += loops.add(place)
    course.loops += loops.finish()
    return course


def _place(n: int, segment: int, pose: Floats, covariance: Floats, *, is_metric: bool) -> Place:
    none = np.zeros(0)
    landmarks = PlaceLandmarks(*[none] * 8)  # type: ignore[arg-type]
    frame = FrameId(n, n * STEP_NS, segment)
    image = np.zeros((1, 1), np.uint8)
    return Place(PlaceKey(0, n), frame, is_metric, pose, covariance, none, landmarks, image)


TRUTH = _truth(2 * LAP + 20)
SEVEN, THREE = _marker(TRUTH, 8), _marker(TRUTH, 50)


@pytest.mark.parametrize("is_metric", [True, False])
def test_exact_views_give_exact_loops(is_metric: bool) -> None:
    course = _course({7: [SEVEN]}, noise=0.0, is_metric=is_metric)
    # The third visit is connected with the first and with the second one.
    frames = [(loop.earlier.keyframe, loop.later.keyframe) for loop in course.loops]
    assert [(a // LAP, b // LAP) for a, b in frames] == [(0, 1), (0, 2), (1, 2)]
    for loop in course.loops:
        true = inverse(TRUTH[loop.earlier.keyframe]) @ TRUTH[loop.later.keyframe]
        np.testing.assert_allclose(loop.earlier_from_later, true, atol=1e-6)
        assert loop.scale == pytest.approx(1.0, abs=1e-6)
        assert (loop.marker, loop.inliers >= 4) == (7, True)
    assert course.placed().rejected == ()


@pytest.mark.parametrize(("is_metric", "ratio"), [(True, 0.5), (False, 0.3)])
def test_a_marker_seen_again_takes_the_drift_away(is_metric: bool, ratio: float) -> None:
    before, after = [], []
    for seed in range(6):
        course = _course({7: [SEVEN], 3: [THREE]}, seed=seed, is_metric=is_metric)
        placed = course.placed()
        assert placed.rejected == ()
        before.append(course.error_m(course.odometry))
        after.append(course.error_m(placed.world_from_cam))
    assert np.mean(after) < ratio * np.mean(before)


def test_the_covariance_of_a_loop_holds_its_error() -> None:
    squared = []
    for seed in range(10):
        for loop in _course({7: [SEVEN], 3: [THREE]}, seed=seed).loops:
            true = inverse(TRUTH[loop.earlier.keyframe]) @ TRUTH[loop.later.keyframe]
            error = sim3.local(sim3.inverse(loop.earlier_from_later) @ true)[:6]
            squared.append(error @ np.linalg.solve(loop.covariance[:6, :6], error))
    assert len(squared) >= 30
    assert 0.1 < np.mean(squared) < 7.0  # of six numbers: the drift of the path is overestimated
    assert np.max(squared) < 29.9


def test_a_marker_that_was_moved_closes_no_loop_and_is_named() -> None:
    course = _course({7: [SEVEN, _marker(TRUTH, 8, 1.0)]}, moved_at=60)
    placed = course.placed()
    assert len(placed.rejected) == len(course.loops) == 3  # also the true one
    np.testing.assert_array_equal(placed.world_from_cam, course.odometry)
    (note,) = course.markers.notes
    assert note.startswith("marker 7 closes no loop") and "it was moved" in note


def test_another_marker_closes_its_loops_beside_one_that_was_moved() -> None:
    course = _course({7: [SEVEN, _marker(TRUTH, 8, 1.0)], 3: [THREE]}, moved_at=60)
    placed = course.placed()
    assert {loop.marker for loop in placed.rejected} == {7}
    assert len(course.loops) == 4
    assert course.error_m(placed.world_from_cam) < course.error_m(course.odometry)


def test_two_markers_of_one_id_close_no_loop() -> None:
    course = _course({7: [SEVEN, THREE]}, moved_at=0)
    placed = course.placed()
    assert len(placed.rejected) == len(course.loops) > 3
    np.testing.assert_array_equal(placed.world_from_cam, course.odometry)
    assert len(course.markers.notes) == 1


def test_two_markers_of_one_id_in_one_image_take_its_loops_back() -> None:
    course = _course({7: [SEVEN]})
    assert course.placed().rejected == ()
    course.markers.see(2 * LAP + 19, [], [7])  # a second one appears beside it
    assert len(course.placed().rejected) == len(course.loops) == 3
    assert course.markers.repeated == (7,)


@pytest.mark.parametrize("is_metric", [True, False])
def test_segments_that_see_the_same_marker_become_one_world(is_metric: bool) -> None:
    course = _course({7: [SEVEN]}, is_metric=is_metric, cut=90)
    placed = course.placed()
    assert set(placed.world.tolist()) == {0}
    assert course.error_m(placed.world_from_cam) < 0.3  # m, of a path of 88 m


def test_segments_are_merged_by_three_keyframes_not_by_two() -> None:
    for cut, views, worlds in ((LAP + 9, 3, {0}), (LAP + 10, 2, {0, 1})):
        course = _course({7: [SEVEN]}, cut=cut, keyframes=LAP + 30)
        assert [loop.support for loop in course.loops if loop.later.keyframe == cut] == [views] * 2
        assert set(course.placed().world.tolist()) == worlds


def test_a_marker_is_not_believed_against_the_look_of_places() -> None:
    """One that was moved by less than the drift of the path, which other loops show."""
    course = _course({7: [SEVEN, _marker(TRUTH, 8, 0.6)]}, is_metric=False, moved_at=60)
    by_marker = course.loops[:1]
    course.loops = by_marker
    assert course.placed().rejected == ()
    for earlier in (12, 30, 60):
        later = earlier + LAP
        relation = inverse(TRUTH[earlier]) @ TRUTH[later]
        units = np.linalg.norm(np.diff(course.odometry[:, :3, 3], axis=0), axis=1) / np.linalg.norm(
            np.diff(TRUTH[:, :3, 3], axis=0), axis=1
        )
        relation[:3, 3] *= units[earlier]
        ends = PlaceKey(0, earlier), PlaceKey(0, later)
        scale = float(units[earlier] / units[later])
        sigma = np.diag(np.r_[np.full(3, 2e-3), np.full(3, 0.01), 0.01] ** 2)
        course.loops.append(Loop(*ends, relation, scale, sigma, 100))
    assert [loop.marker for loop in course.placed().rejected] == [7]


BLACK, CHANGED = 112, 124  # first black frame, and the first of the place in negative


@pytest.fixture(scope="module")
def changed_room(rounds: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rounds, with a marker; the camera is covered, and then sees everything in negative."""
    folder = tmp_path_factory.mktemp("changed") / "room"
    shutil.copytree(rounds, folder)
    camera = open_source(rounds, mode="mono").rig.cam0
    truth = read_tum(rounds / "groundtruth.tum")
    angle = 0.75 * np.pi
    side = np.array([np.cos(angle), np.sin(angle), 0.0])
    facing = np.column_stack([[-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0], -side])
    facing[:, 0] = np.cross(facing[:, 1], facing[:, 2])
    world_from_marker = make_transform(facing, 2.2 * side + [0.0, 0.0, 1.55])
    files = sorted((folder / "mav0" / "cam0" / "data").glob("*.png"))
    for n, (path, world_from_cam) in enumerate(zip(files, truth.world_from_cam, strict=True)):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        image = image if n < BLACK else 255 - image if n >= CHANGED else np.zeros_like(image)
        pose = inverse(world_from_cam) @ world_from_marker
        is_seen = pose[2, 3] > 0.4 and pose[:3, 2] @ pose[:3, 3] < -0.05
        if is_seen and not BLACK <= n < CHANGED:
            levels = render(camera, Placed("4X4_50", 7, LENGTH_M, pose), image)
            blurred = cv2.GaussianBlur(levels, (0, 0), 0.5)
            image = np.clip(np.rint(blurred), 0, 255).astype(np.uint8)
        cv2.imwrite(str(path), image)
    return folder


def test_a_marker_leads_back_to_a_place_that_looks_different(
    changed_room: Path, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    options = ScaleOptions(marker_length_m=LENGTH_M)
    summary = run_rounds(changed_room, output, "memory.loops=true", end=172, scale=options)
    assert {(loop["kind"], loop["marker"]) for loop in summary["loops"]} == {("merge", 7)}
    (segment,) = summary["segments"]
    assert segment["frames"] > 140  # the second map begins ten frames after the black ones
    found, truth = read_tum(output / "trajectory.tum"), read_tum(changed_room / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, found.stamps_ns)
    fit = umeyama(found.positions, truth.positions[rows], with_scale=True)
    assert fit.scale == pytest.approx(1.0, abs=0.02)
    assert ate(output, changed_room) < 0.05
