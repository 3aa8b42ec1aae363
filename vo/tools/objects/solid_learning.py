"""A solid object from a run around it: points of features of many views, with their poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import InputError
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Camera, Descriptors, Floats, Floats32, Ints, with_image0
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.geometry.epipolar import fundamental_from_motion
from vo.outputs.report.run_folder import RunRecord, read_run
from vo.recordings.sources.source import Recording
from vo.tools.objects.scene_features import compact, evenly_lit, unit_vectors
from vo.tools.objects.solid_points import Observations, best_points, tracks
from vo.tools.objects.stored_objects import Solid
from vo.tools.pairs.sampson import line_errors
from vo.tools.pairs.stitching import undistorted
from vo.tools.reopening import recording_of

_MIN_SPREAD_DEG = 15.0  # of the directions of view
_STEP_DEG = 3.5  # between the views that are used
_MAX_VIEWS = 90
_MAX_FEATURES = 2500  # of a view
_AHEAD = (1, 2, 4, 7)  # views that each one is matched with
_MAX_RATIO = 0.72  # of squared distances of the nearest and the second
_EPIPOLAR_PX = 2.0
_IMAGE_RATIO = 0.4  # of the smaller side of the image: radius of the object by default
_AROUND = 1.8  # radii: points up to there show what the object stands on
_PLANE_RATIO, _PLANE = 0.4, 0.02  # of the points around it, and of the radius: a plane below it
_PLANE_TRIES = 500
_MIN_POINTS = 60
_FEATURES_OF_POINT = 5
_MAX_ROWS = 6000
_EDGE_PERCENT = 1.0  # of the points lie outside of the box at each side


class LearnedSolid(NamedTuple):
    """A solid, and from what it was made."""

    solid: Solid
    views: int
    points: int


def learn_solid(
    folder: Path,
    extractor: FeatureExtractor,
    radius: float | None,
    step: Callable[[str], None] = lambda _: None,
) -> LearnedSolid:
    """The object in the middle of the views of a run, whose recording must be where it was.

    `radius`: of the sphere around where the views cross that contains the object, in the unit of
    the run; by default what most of them show within 0.4 of the smaller side of the image.

    Raises:
        SourceError: the run or its recording is missing or damaged.
        InputError: the views do not show an object from several sides, or it has no texture.
    """
    record = read_run(folder)
    recording = recording_of(record)
    camera = recording.rig.cam0
    frames, world_from_cam = _poses(record, recording.stamps_ns)
    centre = _crossing(world_from_cam)
    away = world_from_cam[:, :3, 3] - centre
    if radius is None:
        half = _IMAGE_RATIO * min(camera.width / camera.fx, camera.height / camera.fy)
        radius = half * float(np.median(np.linalg.norm(away, axis=1)))
    elif not 0.0 < radius < np.inf:
        raise InputError(f"the radius is {radius:g}; give a length above 0")
    chosen = _spread(away)
    frames, poses = frames[chosen], inverse(world_from_cam[chosen])
    images = _images(recording, frames, camera)
    views = []
    for frame, pose in zip(frames.tolist(), poses, strict=True):
        step(f"frame {frame}")
        views.append(_view(next(images), extractor, camera, pose @ np.append(centre, 1.0), radius))
    found = _observations(views, poses, camera)
    points, sigma, kept = best_points(found, poses, camera)
    cameras = inverse(poses)[:, :3, 3]
    made = _on_object(points, sigma, kept, cameras, centre, radius)
    solid = _solid(made, kept, views, cameras, record.unit == "m")
    return LearnedSolid(solid, len(views), len(np.unique(made.point)))


class _View(NamedTuple):
    """Features of a view near the object."""

    xy: Floats32
    descriptor: Descriptors
    vector: Floats32


class _OnObject(NamedTuple):
    """Points in the frame of the world, and the observations that show them."""

    xyz: Floats  # (M, 3) all points
    sigma: Floats  # (M,) in the direction of depth
    point: Ints  # (N,) rows of points
    row: Ints  # (N,) rows of observations
    up: Floats | None  # (3,) normal of the plane that it stands on


def _poses(record: RunRecord, stamps_ns: Ints) -> tuple[Ints, Floats]:
    """Frames of the longest segment, and world_from_cam of each."""
    path = record.trajectory
    segment = record.segment_of(path.stamps_ns)
    number, count = np.unique(segment[segment >= 0], return_counts=True)
    if not len(number):
        raise InputError(f"{record.path} has no path; the object cannot be learned from it")
    rows = np.flatnonzero(segment == number[count.argmax()])
    frames = np.searchsorted(stamps_ns, path.stamps_ns[rows])
    is_there = frames < len(stamps_ns)
    is_there[is_there] &= stamps_ns[frames[is_there]] == path.stamps_ns[rows][is_there]
    return frames[is_there], path.world_from_cam[rows[is_there]]


def _crossing(world_from_cam: Floats) -> Floats:
    """(3,) where the optical axes come nearest to each other."""
    axis = world_from_cam[:, :3, 2]
    spread = np.rad2deg(np.arccos(np.clip((axis @ axis.T).min(initial=1.0), -1.0, 1.0)))
    if spread < _MIN_SPREAD_DEG:
        raise InputError(
            f"the views differ by {spread:.0f}°, at least {_MIN_SPREAD_DEG:.0f}° are needed; walk "
            "around the object, and keep it in the middle of the images"
        )
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    return np.linalg.solve(
        across.sum(axis=0), (across @ world_from_cam[:, :3, 3, None]).sum(axis=0)
    )[:, 0]


def _spread(away: Floats) -> Ints:
    """Rows of views that differ by some degrees from the one before, as seen from the object."""
    ray = away / np.linalg.norm(away, axis=1, keepdims=True)
    step = _STEP_DEG
    while True:
        rows = [0]
        for n in range(1, len(ray)):
            if ray[n] @ ray[rows[-1]] < np.cos(np.deg2rad(step)):
                rows.append(n)
        if len(rows) <= _MAX_VIEWS:
            return np.array(rows)
        step *= 1.5


def _images(recording: Recording, frames: Ints, camera: Camera) -> Iterator[Bytes]:
    wanted = set(frames.tolist())
    for frame in with_image0(recording.frames(int(frames[0]), int(frames[-1]) + 1)):
        if frame.index in wanted:
            yield undistorted(frame.image0, camera)


def _view(
    image: Bytes, extractor: FeatureExtractor, camera: Camera, centre: Floats, radius: float
) -> _View:
    """Features around the object, the strongest ones; `centre` is in the frame of the camera."""
    found = extractor.extract(evenly_lit(image))
    middle = centre[:2] / centre[2] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    reach = _AROUND * radius / centre[2] * camera.fx
    near = np.linalg.norm(found.xy - middle, axis=1) <= (reach if centre[2] > 0 else 0.0)
    rows = np.flatnonzero(near)
    rows = rows[np.argsort(-found.response[rows], kind="stable")[:_MAX_FEATURES]]
    return _View(found.xy[rows], found.descriptor[rows], unit_vectors(found.descriptor[rows]))


def _observations(views: Sequence[_View], poses: Floats, camera: Camera) -> Observations:
    """Features of points that three views or more show."""
    begins = np.cumsum([0, *(len(view.xy) for view in views)])
    pairs = []
    for first in range(len(views)):
        for second in (first + ahead for ahead in _AHEAD if first + ahead < len(views)):
            motion = poses[second] @ inverse(poses[first])
            fundamental = fundamental_from_motion(motion, camera.matrix)
            a, b = _matches(views[first], views[second], fundamental)
            pairs.append((a + begins[first], b + begins[second]))
    point = tracks(begins, pairs)
    rows = np.flatnonzero(point >= 0)
    view = np.searchsorted(begins, rows, "right") - 1
    xy = np.concatenate([each.xy for each in views])[rows].astype(np.float64)
    return Observations(point[rows], view, rows - begins[view], xy)


def _matches(first: _View, second: _View, fundamental: Floats) -> tuple[Ints, Ints]:
    """Rows of both views: mutual nearest neighbours that are clearly nearest, on their lines."""
    if len(first.xy) < 2 or len(second.xy) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    likeness = first.vector @ second.vector.T
    best = likeness.argmax(axis=1)
    back = likeness.argmax(axis=0)
    each = np.arange(len(best))
    most = likeness[each, best]
    likeness[each, best] = -np.inf
    clear = (1.0 - most) <= _MAX_RATIO * (1.0 - likeness.max(axis=1))
    rows = np.flatnonzero(clear & (back[best] == each))
    at = first.xy[rows].astype(np.float64), second.xy[best[rows]].astype(np.float64)
    rows = rows[line_errors(fundamental, *at) <= _EPIPOLAR_PX]
    return rows, best[rows]


def _on_object(
    points: Floats,
    sigma: Floats,
    kept: Observations,
    cameras: Floats,
    centre: Floats,
    radius: float,
) -> _OnObject:
    """The points in the sphere, without those of a plane that goes on around it."""
    rows = np.unique(kept.point)
    away = np.linalg.norm(points[rows] - centre, axis=1)
    inside, around = rows[away <= radius], rows[(away > radius) & (away <= _AROUND * radius)]
    plane = _plane(points[around], radius)
    up = None
    if plane is not None:
        normal, offset = plane
        side = np.sign(np.median(cameras @ normal - offset))
        up = side * normal
        inside = inside[points[inside] @ up - side * offset > _PLANE * radius]
    if len(inside) < _MIN_POINTS:
        raise InputError(
            f"the views show {len(inside)} points of an object, {_MIN_POINTS} are needed; film a "
            "textured object from near, in the middle of the images, or give another radius"
        )
    on_object = np.flatnonzero(np.isin(kept.point, inside))
    return _OnObject(points, sigma, kept.point[on_object], on_object, up)


def _plane(points: Floats, radius: float) -> tuple[Floats, float] | None:
    """Normal (3,) and offset of a plane with many of the points; None if there is none."""
    if len(points) < _MIN_POINTS:
        return None
    rng = np.random.default_rng(0)
    best, most = None, int(_PLANE_RATIO * len(points))
    for _ in range(_PLANE_TRIES):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        size = float(np.linalg.norm(normal))
        if size < 1e-3 * radius**2:
            continue
        normal = normal / size
        count = int(np.count_nonzero(np.abs((points - a) @ normal) <= _PLANE * radius))
        if count > most:
            best, most = (normal, float(normal @ a)), count
    return best


def _solid(
    made: _OnObject, kept: Observations, views: Sequence[_View], cameras: Floats, is_metric: bool
) -> Solid:
    """The points with the features of some of their views, in the frame at their middle."""
    order = np.random.default_rng(0).permutation(len(made.row))
    order = order[np.argsort(made.point[order], kind="stable")]
    starts = np.searchsorted(made.point[order], made.point[order])
    order = order[np.arange(len(order)) - starts < _FEATURES_OF_POINT]
    if len(order) > _MAX_ROWS:  # whole points, those that most views show
        count = np.bincount(made.point)[made.point[order]]
        order = order[np.argsort(-count, kind="stable")[:_MAX_ROWS]]
    rows, point = made.row[order], made.point[order]
    turn = _axes(made.xyz[np.unique(point)], made.up)
    all_points = made.xyz[np.unique(point)] @ turn.T
    box = np.percentile(all_points, (_EDGE_PERCENT, 100.0 - _EDGE_PERCENT), axis=0)
    middle = box.mean(axis=0)
    xyz = made.xyz[point] @ turn.T
    ray = cameras[kept.view[rows]] @ turn.T - xyz
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    pairs = zip(kept.view[rows].tolist(), kept.feature[rows].tolist(), strict=True)
    descriptor = np.array([views[view].descriptor[feature] for view, feature in pairs])
    return Solid(
        (xyz - middle).astype(np.float32),
        ray.astype(np.float32),
        made.sigma[point].astype(np.float32),
        compact(descriptor),
        (box - middle).astype(np.float32),
        is_metric,
    )


def _axes(points: Floats, up: Floats | None) -> Floats:
    """Rotation (3, 3) from the world: y down, x along the longer side; none without a plane."""
    if up is None:
        return np.eye(3)
    x = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    x /= np.linalg.norm(x)
    flat = points @ np.column_stack([x, np.cross(up, x)])
    angle = np.deg2rad(np.arange(180))
    along = np.stack([np.cos(angle), np.sin(angle)])
    low, high = np.percentile(flat @ along, (_EDGE_PERCENT, 100.0 - _EDGE_PERCENT), axis=0)
    length = high - low
    area = length * np.roll(length, -90)
    best = int(np.where(length >= np.roll(length, -90), area, np.inf).argmin())
    x = np.column_stack([x, np.cross(up, x)]) @ along[:, best]
    return np.stack([x, -up, np.cross(x, -up)])
