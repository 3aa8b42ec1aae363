"""Simulated laps of a camera past markers, with loops by them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from room_course import LENGTH_M

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse, make_transform, so3_exp
from vo.base.types import Camera, Floats
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.mapping.keyframe import FrameId
from vo.engine.markers.marker_problem import MarkerView, square_points
from vo.engine.memory.marker_loops import MarkerLoops
from vo.engine.places.records import Loop, PathKeyframe, PlaceKey, RegisteredKeyframes
from vo.tools.markers.plane_pose import plane_pose

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


def marker_at(truth: Floats, at: int, aside_m: float = 0.0) -> Floats:
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
    places: list[PathKeyframe] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)
    before: Course | None = None

    def placed(self) -> RegisteredKeyframes:
        graph = PoseGraph()
        if self.before is not None:
            placed = self.before.placed()
            graph.add_map(placed, is_metric=self.before.places[0].is_metric)
        for place in self.places:
            graph.add_keyframe(place)
        graph.submit(self.loops, doubted=self.markers.repeated)
        placed = graph.result()
        self.markers.refuse(placed.rejected)
        return placed

    def error_m(self, poses: Floats) -> float:
        """RMS error of positions after alignment, in mono with a scale."""
        scales = not self.places[0].is_metric
        found = umeyama(poses[:, :3, 3], self.truth[:, :3, 3], with_scale=scales)
        apart = found.transform_poses(poses)[:, :3, 3] - self.truth[:, :3, 3]
        return float(np.sqrt((apart**2).sum(axis=1).mean()))


def simulate(
    markers: dict[int, list[Floats]],
    *,
    seed: int = 0,
    keyframes: int = 2 * LAP + 20,
    is_metric: bool = True,
    noise: float = 1.0,
    cut: int | None = None,
    moved_at: int = 10**9,
    length_m: float = LENGTH_M,
    dictionary: str = "4X4_50",
    before: Course | None = None,
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
        length_m: side of the markers that the run is given.
        dictionary: theirs.
        before: the session before, whose map is loaded.
    """
    rng = np.random.default_rng(seed)
    truth = _truth(keyframes)
    odometry = _odometry(truth, rng, noise=noise, is_metric=is_metric)
    if cut is not None:
        odometry[cut:] = inverse(odometry[cut]) @ odometry[cut:]
    loaded = []
    if before is not None:
        frames = {place.key: place.frame for place in before.places}
        loaded = [(each, frames[each.key]) for each in before.markers.known]
    loops = MarkerLoops(np.eye(4), loaded, is_metric=is_metric)
    course = Course(truth, odometry, loops, before=before)
    covariance = np.diag(np.r_[np.full(3, 5e-4**2), np.full(3, 2e-3**2)])
    for n in range(keyframes):
        views, ids = [], []
        for number, poses in markers.items():
            shown = poses if moved_at == 0 else [poses[-1] if n >= moved_at else poses[0]]
            for pose in shown:
                view = _view(n, number, inverse(truth[n]) @ pose, rng, 0.1 * noise)
                if view is not None:
                    views.append(view._replace(length_m=length_m, dictionary=dictionary))
                ids += [] if view is None else [number]
        repeated = [number for number in markers if ids.count(number) > 1]
        loops.see(n, [view for view in views if view.id not in repeated], repeated)
        segment = 0 if cut is None or n < cut else 1
        key = PlaceKey(0 if before is None else 1, n)
        frame = FrameId(n, n * STEP_NS, segment)
        place = PathKeyframe(key, frame, is_metric, odometry[n], covariance)
        course.places.append(place)
        course.loops += loops.add(place)
    course.loops += loops.finish()
    return course


TRUTH = _truth(2 * LAP + 20)
SEVEN, THREE = marker_at(TRUTH, 8), marker_at(TRUTH, 50)
