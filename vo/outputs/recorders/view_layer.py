"""The images with features and matches."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse, make_transform, quat_xyzw_from_rotation
from vo.base.records.snapshot import FeatureState, View
from vo.base.types import Bools, Bytes, Estimate, Floats, Floats32
from vo.outputs.recorders import entities
from vo.outputs.recorders.reconstruction import dimmed
from vo.outputs.recorders.recorder import ImageChoice
from vo.outputs.recorders.timelines import Batch, Moment, Strips

_LEFT_QUALITY, _RIGHT_QUALITY = 60, 50  # of JPEG
_MAX_LINES = 150  # of each kind: more would hide the image
_MAX_EPIPOLAR = 20
_MIN_RADIUS, _MAX_RADIUS, _STEPS = 1.2, 3.6, 4  # ui points, by reprojection error
_LARGE_ERROR_PX = 3.0  # of the largest radius


class ViewLayer:
    """Logs images, features and matches of each frame.

    In rerun, (0, 0) is the corner of the top-left pixel, in this project its centre; hence the
    offsets of half a pixel.

    `scale`: size of the recorded images relative to those of the run. `has_right`: whether there
    are images of a right camera.
    """

    def __init__(self, batch: Batch, images: ImageChoice, *, has_right: bool) -> None:
        self._batch = batch
        self._images = images
        self._has_right = has_right
        self.scale = 0.5 if images == "half" else 1.0
        self._cameras_known = False
        self._previous_pose: Floats | None = None

    def log_styles(self) -> None:
        """Log the colours and sizes that never change."""
        for order, (name, colour) in enumerate(entities.FEATURE_COLOURS.items()):
            style = rr.Points2D.from_fields(colors=[colour], draw_order=20.0 + order)
            self._batch.log_static(f"{entities.FEATURES}/{name}", style)
        new = rr.Points2D.from_fields(radii=rr.Radius.ui_points(_MIN_RADIUS))
        self._batch.log_static(f"{entities.FEATURES}/{entities.NEW}", new)
        for entity, colour in (
            (entities.MATCHES, entities.YELLOW),
            (entities.STEREO_MATCHES, entities.YELLOW),
            (entities.EPIPOLAR, entities.ORANGE),
        ):
            thin = rr.Radius.ui_points(0.6)
            lines = rr.LineStrips2D.from_fields(colors=[colour], radii=thin, draw_order=10.0)
            self._batch.log_static(entity, lines)

    def add(self, moment: Moment, estimate: Estimate, view: View) -> None:
        """Add the images of a frame, with its features and matches."""
        if not self._cameras_known:
            self._cameras_known = True
            self._log_cameras(view)
        left, right = dimmed(view.image0, view.masks[0]), view.image1
        right = None if right is None else dimmed(right, view.masks[1])
        self._add_image(moment, entities.LEFT_IMAGE, left, _LEFT_QUALITY)
        self._add_image(moment, entities.RIGHT_IMAGE, right, _RIGHT_QUALITY)
        for each in view.further:
            entity = f"{entities.CAM0}/{each.name}/image"
            self._add_image(moment, entity, each.image, _RIGHT_QUALITY)
        self._add_features(moment, view)
        self._add_matches(moment, view)
        self._add_epipolar(moment, view, estimate.world_from_cam0)

    def _log_cameras(self, view: View) -> None:
        """Log the constant poses of both rectified cameras relative to cam0."""
        cam0_from_left = np.eye(4) if view.cam0_from_image0 is None else view.cam0_from_image0
        self._log_camera(entities.LEFT, cam0_from_left, view)
        for each in view.further:
            self._log_camera(f"{entities.CAM0}/{each.name}", each.cam0_from_image, view)
        if self._has_right and not view.further:
            left_from_right = make_transform(np.eye(3), np.array([view.baseline_m, 0.0, 0.0]))
            self._log_camera(entities.RIGHT, cam0_from_left @ left_from_right, view)

    def _log_camera(self, entity: str, cam0_from_camera: Floats, view: View) -> None:
        transform = rr.Transform3D(
            translation=cam0_from_camera[:3, 3],
            quaternion=rr.Quaternion(xyzw=quat_xyzw_from_rotation(cam0_from_camera[:3, :3])),
        )
        height, width = (int(side * self.scale) for side in view.image0.shape)
        matrix = view.camera_matrix
        pinhole = rr.Pinhole(
            focal_length=self.scale * np.array([matrix[0, 0], matrix[1, 1]]),
            principal_point=self.scale * (matrix[:2, 2] + 0.5),
            resolution=[width, height],
            camera_xyz=rr.ViewCoordinates.RDF,
        )
        self._batch.log_static(entity, transform)
        self._batch.log_static(entity, pinhole)

    def _add_image(self, moment: Moment, entity: str, image: Bytes | None, quality: int) -> None:
        if self._images == "none" or image is None:
            return
        scaled = _halved(image) if self._images == "half" else image
        _, jpeg = cv2.imencode(".jpg", scaled, [cv2.IMWRITE_JPEG_QUALITY, quality])
        fields = {"blob": [jpeg.tobytes()], "media_type": ["image/jpeg"]}
        self._batch.add(moment, entity, rr.EncodedImage, **fields)

    def _add_features(self, moment: Moment, view: View) -> None:
        xy = self._to_pixels(view.xy)
        radii = _radii(view)
        for name, chosen in _by_state(view).items():
            fields = {"positions": xy[chosen]}
            if name != entities.NEW:
                fields["radii"] = radii[chosen]
            self._batch.add(moment, f"{entities.FEATURES}/{name}", rr.Points2D, **fields)

    def _add_matches(self, moment: Moment, view: View) -> None:
        tracked = view.feature_state == FeatureState.TRACKED
        moved = _rows_of(tracked & ~np.isnan(view.previous_xy[:, 0]))
        self._add_lines(moment, entities.MATCHES, view.previous_xy[moved], view.xy[moved])
        if view.image1 is None or view.right_u is None:
            return
        both = _rows_of(tracked & ~np.isnan(view.right_u))
        right_xy = np.column_stack([view.right_u[both], view.xy[both, 1]])
        self._add_lines(moment, entities.STEREO_MATCHES, view.xy[both], right_xy)

    def _add_epipolar(self, moment: Moment, view: View, pose: Floats | None) -> None:
        before, self._previous_pose = self._previous_pose, pose
        if before is None or pose is None:
            return
        moved = _rows_of(~np.isnan(view.previous_xy[:, 0]), _MAX_EPIPOLAR)
        lines = epipolar_lines(view, view.previous_xy[moved], before, pose)
        strips = Strips.of_equal_size(self._to_pixels(lines))
        self._batch.add(moment, entities.EPIPOLAR, rr.LineStrips2D, strips=strips)

    def _add_lines(self, moment: Moment, entity: str, start: Floats32, end: Floats32) -> None:
        strips = Strips.of_equal_size(self._to_pixels(np.stack([start, end], axis=1)))
        self._batch.add(moment, entity, rr.LineStrips2D, strips=strips)

    def _to_pixels(self, xy: Floats | Floats32) -> Floats32:
        """Pixels of the recorded image, rounded to 1/16 px to save space."""
        return np.asarray(np.round((xy + 0.5) * (16 * self.scale)) / 16, dtype=np.float32)


def _by_state(view: View) -> dict[str, Bools]:
    """Features by the way they are drawn; `LANDMARK` was not tracked in the previous frame."""
    tracked = view.feature_state == FeatureState.TRACKED
    seen_before = ~np.isnan(view.previous_xy[:, 0])
    return {
        entities.NEW: view.feature_state == FeatureState.NEW,
        entities.TRACKED: tracked & seen_before,
        entities.LANDMARK: tracked & ~seen_before,
        entities.REJECTED: view.feature_state == FeatureState.REJECTED,
    }


def _radii(view: View) -> Floats32:
    """Radii (N,) that grow with the reprojection error; negative means ui points."""
    if view.error_px is None:
        return np.full(len(view.xy), -_MIN_RADIUS, np.float32)
    ratio = np.fmin(np.fmax(view.error_px / _LARGE_ERROR_PX, 0.0), 1.0)  # 0 for NaN
    step = np.round(ratio * _STEPS) / _STEPS
    return np.asarray(-(_MIN_RADIUS + (_MAX_RADIUS - _MIN_RADIUS) * step), dtype=np.float32)


def _rows_of(mask: Bools, max_count: int = _MAX_LINES) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Rows of a mask, a uniform subset if there are too many."""
    rows = np.flatnonzero(mask)
    if len(rows) <= max_count:
        return rows
    return rows[np.arange(max_count) * (len(rows) - 1) // (max_count - 1)]


def _halved(image: Bytes) -> Bytes:
    """The image at half the size, by 2x2 means; an odd last row or column is left out."""
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
    halved = cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(halved, dtype=np.uint8)


_MIN_DEPTH_IN_STEPS = 4.0  # depths from this multiple of the camera's step to infinity
_POINTS_ON_CURVE = 6


def epipolar_lines(
    view: View, previous_xy: Floats32, world_from_previous: Floats, world_from_cam0: Floats
) -> Floats:
    """Epipolar lines of pixels of the last frame, in this frame's image0.

    `previous_xy`: (n, 2) pixels in the last frame's image0. `world_from_previous`: (4, 4) of cam0
    in the last frame. `world_from_cam0`: (4, 4) of cam0 in this frame.

    Returns (n, k, 2) pixels: ends of a line, or points on a curve with lens distortion. Points
    behind the camera have no line; without camera motion there are no lines.
    """
    cam0_from_image0 = np.eye(4) if view.cam0_from_image0 is None else view.cam0_from_image0
    world_from_image0 = world_from_cam0 @ cam0_from_image0
    now_from_previous = inverse(world_from_image0) @ world_from_previous @ cam0_from_image0
    step = float(np.linalg.norm(now_from_previous[:3, 3]))
    count = 2 if view.lens is None else _POINTS_ON_CURVE
    if step < 1e-9:
        return np.empty((0, count, 2))
    matrix = view.camera_matrix
    focal, centre = np.diag(matrix)[:2], matrix[:2, 2]
    if view.lens is None:
        plane = (previous_xy - centre) / focal
    else:
        plane = cameras.normalise(view.lens, np.asarray(previous_xy, dtype=np.float64))
    rays = np.column_stack([plane, np.ones(len(plane))])
    inverse_depths = np.arange(count) / ((count - 1) * _MIN_DEPTH_IN_STEPS * step)
    # Homogeneous points (ray, 1 / depth), so that infinite depth needs no special case.
    rotated = rays @ now_from_previous[:3, :3].T
    points = rotated[:, None] + inverse_depths[:, None] * now_from_previous[:3, 3]
    valid = (points[:, :, 2] > 1e-3).all(axis=1) & np.isfinite(points).all(axis=(1, 2))
    projected = points[valid, :, :2] / points[valid, :, 2:]
    if view.lens is None:
        return np.asarray(projected * focal + centre)
    return cameras.distort(view.lens, projected.reshape(-1, 2)).reshape(projected.shape)
