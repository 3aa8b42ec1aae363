"""Rectification: recorded images to the images of ideal pinhole cameras, and pixels back.

Images of stereo pairs are remapped (rows correspond, no distortion), and so are those of wide
lenses, where patches then keep their shape and pixels their precision (195 degree lens, hand-held
in a room, mono: ATE 0.004 m instead of 0.020 m). Other images of a single camera stay as recorded;
only positions of features are undistorted, which is cheaper and keeps every pixel.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.frozen import frozen
from vo.base.geometry import cameras
from vo.base.geometry.pair_rectification import central_focal, check_baseline, is_wide, rectify_pair
from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.rectification_maps import Maps, displaced_maps, wide_maps
from vo.base.geometry.remapping import Remapping
from vo.base.geometry.rig_overlap import overlaps
from vo.base.geometry.transforms import make_transform
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.types import Bytes, Camera, Floats, Floats32, Rig

# Depth is converted to disparity at this baseline. The standard deviation of a disparity, 0.4 px,
# then means 1 cm at 2 m and 6 cm at 5 m (fx = 525), about that of structured light and time of
# flight.
VIRTUAL_BASELINE_M = 0.3
# Beyond 75 degrees from the optical axis a pinhole camera stretches pixels too far.
_MAX_RAY = np.tan(np.deg2rad(75.0))


@frozen(eq=False)
class RectifiedRig:
    """Ideal pinhole cameras, left and right with the same intrinsics, and the way to them.

    Attributes:
        fx: focal length along u in pixels.
        fy: focal length along v.
        baseline_m: distance from the left to the right camera, 0 in mono, `VIRTUAL_BASELINE_M` for
            cameras with depth.
        cam0_from_rectified: (4, 4) rotation from the rectified left camera to the recorded cam0; of
            a pair that was exchanged to cam1, which has the poses.
        lens: the distorted camera, with its error corrected, whose images are used as recorded;
            None without distortion.
        maps: OpenCV's rectification maps of each camera, None for images used as recorded.
        k1_error: corrected k1 of that lens minus its calibrated value.
        disparity_offset_px: error of all disparities.
        disparity_curve_px: further error of disparities, times the squared horizontal distance from
            the principal point in focal lengths.
        offset_is_yaw: whether the offset is due to a yaw of the right camera.
        readout_s: time from the first to the last row of a recorded image; 0 for a global shutter.
        recorded_rows: rows of a recorded image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float
    cam0_from_rectified: Floats
    lens: Camera | None = None
    maps: tuple[Maps | None, ...] = (None, None)
    k1_error: float = 0.0
    disparity_offset_px: float = 0.0
    disparity_curve_px: float = 0.0
    offset_is_yaw: bool = False
    readout_s: float = 0.0
    recorded_rows: int = 0

    @property
    def matrix(self) -> Floats:
        """The (3, 3) camera matrix of both rectified cameras."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def intrinsics(self) -> Intrinsics:
        """fx, fy, cx, cy of both rectified cameras."""
        return Intrinsics(self.fx, self.fy, self.cx, self.cy)

    @property
    def is_metric(self) -> bool:
        """Whether there is a right camera, or depth in its place."""
        return self.baseline_m > 0.0

    def rectify(self, image: Bytes, side: int) -> Bytes:
        """Rectified image of cam0 (side 0) or cam1 (side 1)."""
        remapping = self._remappings[side]
        return image if remapping is None else remapping(image)

    @cached_property
    def _remappings(self) -> tuple[Remapping | None, ...]:
        return tuple(None if maps is None else Remapping(maps) for maps in self.maps)

    def rectify_depth(self, depth: Floats32) -> Floats32:
        """Depth at the pixels of the rectified image; nearest neighbour, because of edges."""
        if self.maps[0] is None:
            return depth
        nearest = cv2.remap(depth, self.maps[0][0], None, cv2.INTER_NEAREST)
        return np.asarray(nearest, dtype=np.float32)

    def with_right_corrected(self, errors: VerticalDisparity) -> RectifiedRig:
        """The same rig with right images remapped to correct `errors`."""
        v, u = np.ogrid[: self.height, : self.width]
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        at_u = (u + errors.horizontal_px(x, y)).astype(np.float32)
        at_v = (v + errors.vertical_px(x, y)).astype(np.float32)
        return replace(self, maps=(self.maps[0], displaced_maps(self.maps[1], at_u, at_v)))

    def with_k1_error(self, k1: float) -> RectifiedRig:
        """The same rig with a lens whose k1 exceeds its calibrated value by `k1`."""
        return replace(self, lens=_with_k1(self.lens_or_pinhole, k1 - self.k1_error), k1_error=k1)

    @property
    def lens_or_pinhole(self) -> Camera:
        """The lens, or a `radtan` lens without distortion."""
        size = self.width, self.height
        ideal = Camera(*size, *self.intrinsics, "radtan", (0.0, 0.0, 0.0, 0.0))
        return self.lens or ideal

    @cached_property
    def _disparity_model(self) -> tuple[float, ...]:
        return self.cx, self.fx, float(self.disparity_offset_px), float(self.disparity_curve_px)

    def disparity_error(self, right_u: Floats) -> Floats:
        """Errors (N,) of disparities at horizontal positions (N,) in the right image, in pixels."""
        x = (right_u - self.cx) / self.fx
        return np.asarray(self.disparity_offset_px + self.disparity_curve_px * x**2)

    def ideal_disparity(self, xy: Floats, right_xy: Floats) -> Floats:
        """Disparities (N,) of left pixels (N, 2) and right ones, their known errors corrected."""
        if self.lens is None:
            return np.asarray(_ideal_disparity(xy, right_xy, *self._disparity_model))
        disparity = xy[:, 0] - right_xy[:, 0] - self.disparity_error(right_xy[:, 0])
        lens = self.undistort(xy) - xy - (self.undistort(right_xy) - right_xy)
        return np.asarray(disparity + lens[:, 0])

    def right_pixels(self, xy: Floats, disparity: Floats) -> Floats:
        """Pixels (N, 2) in the right image, of left ones (N, 2) with ideal disparities (N,)."""
        if self.lens is None:
            return np.asarray(_right_pixels(xy, disparity, *self._disparity_model))
        ideal = self.undistort(xy)
        right_xy = self.distort(np.column_stack([ideal[:, 0] - disparity, ideal[:, 1]]))
        right_xy[:, 0] -= self.disparity_error(right_xy[:, 0])
        return right_xy

    def undistort(self, xy: Floats | Floats32) -> Floats:
        """Undistorted pixels (N, 2) of rectified image pixels (N, 2); NaN beyond 75 degrees."""
        at = np.asarray(xy, dtype=np.float64)
        if self.lens is None:
            return at
        rays = cameras.normalise(self.lens, at)
        x, y = rays.T
        beyond = np.isnan(x) | np.isnan(y)
        if self.k1_error != 0.0 and beyond.any():  # the corrected lens may have a smaller reach
            rays[beyond] = cameras.normalise(_with_k1(self.lens, -self.k1_error), at[beyond])
        rays[np.sqrt(x * x + y * y) > _MAX_RAY] = np.nan
        return np.asarray(rays * (self.fx, self.fy) + (self.cx, self.cy))

    def distort(self, xy: Floats) -> Floats:
        """Rectified image pixels (N, 2) of undistorted pixels (N, 2)."""
        if self.lens is None:
            return xy
        return cameras.distort(self.lens, (xy - (self.cx, self.cy)) / (self.fx, self.fy))

    def project(self, points: Floats) -> Floats:
        """Undistorted pixels (N, 2) of points (N, 3) in the rectified camera's frame."""
        return np.asarray(points[:, :2] / points[:, 2:] * (self.fx, self.fy) + (self.cx, self.cy))

    def back_project(self, xy: Floats, depth: Floats) -> Floats:
        """Points (N, 3) in the rectified camera's frame at undistorted pixels and depths (N,)."""
        rays = (xy - (self.cx, self.cy)) / (self.fx, self.fy)
        return np.column_stack([rays * depth[:, None], depth])


# As `RectifiedRig.disparity_error` in one call for a frame instead of a dozen.
@compiled
def _ideal_disparity(xy, right_xy, cx, fx, offset, curve):  # type: ignore[no-untyped-def]
    disparity = np.empty(len(xy))
    for n in range(len(xy)):
        x = (right_xy[n, 0] - cx) / fx
        disparity[n] = xy[n, 0] - right_xy[n, 0] - (offset + curve * (x * x))
    return disparity


@compiled
def _right_pixels(xy, disparity, cx, fx, offset, curve):  # type: ignore[no-untyped-def]
    right_xy = xy.copy()
    for n in range(len(xy)):
        x = (xy[n, 0] - disparity[n] - cx) / fx
        right_xy[n, 0] -= disparity[n] + (offset + curve * (x * x))
    return right_xy


def rectified_rig(rig: Rig) -> RectifiedRig:
    """Choose rectified cameras for a rig, and compute their maps.

    Raises:
        CalibrationError: the cameras of a pair are at the same place, one in front of the other, or
            have too little of the scene in common.
    """
    rectified = _rectified(rig)
    if rig.is_exchanged and rig.cam1_from_cam0 is not None:
        posed = rig.cam1_from_cam0 @ rectified.cam0_from_rectified
        rectified = replace(rectified, cam0_from_rectified=posed)
    return replace(rectified, readout_s=rig.cam0.readout_s, recorded_rows=rig.cam0.height)


def _rectified(rig: Rig) -> RectifiedRig:
    c = rig.cam0
    if rig.cam1 is None or rig.cam1_from_cam0 is None:
        return _single(c, VIRTUAL_BASELINE_M if rig.has_depth else 0.0)
    check_baseline(rig.cam1_from_cam0)
    if _is_rectified(rig):
        baseline = -float(rig.cam1_from_cam0[0, 3])
        return RectifiedRig(c.width, c.height, c.fx, c.fy, c.cx, c.cy, baseline, np.eye(4))
    pair = rectify_pair(c, rig.cam1, rig.cam1_from_cam0)
    (fx, _, cx), (_, fy, cy), _ = pair.matrix.tolist()
    cam0_from_rectified = make_transform(pair.rectified_from_cam[0].T, np.zeros(3))
    return RectifiedRig(
        *pair.size, fx, fy, cx, cy, pair.baseline_m, cam0_from_rectified, None, pair.maps
    )


def _single(c: Camera, baseline: float) -> RectifiedRig:
    if not is_wide(c):
        lens = c if c.is_distorted else None
        return RectifiedRig(c.width, c.height, c.fx, c.fy, c.cx, c.cy, baseline, np.eye(4), lens)
    fx, fy = central_focal(c)
    matrix = np.array([[fx, 0.0, c.cx], [0.0, fy, c.cy], [0.0, 0.0, 1.0]])
    maps = (wide_maps(c, np.eye(3), matrix, (c.width, c.height)), None)
    return RectifiedRig(c.width, c.height, fx, fy, c.cx, c.cy, baseline, np.eye(4), None, maps)


def _with_k1(lens: Camera, k1: float) -> Camera:
    """A `radtan` lens with `k1` added to its own."""
    first, *others = lens.distortion
    return replace(lens, distortion=(first + k1, *others))


def _is_rectified(rig: Rig) -> bool:
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    a, b, motion = rig.cam0, rig.cam1, rig.cam1_from_cam0
    same_matrix = np.allclose((a.fx, a.fy, a.cx, a.cy), (b.fx, b.fy, b.cx, b.cy), atol=0.02)
    same_size = (a.width, a.height) == (b.width, b.height)
    baseline = np.linalg.norm(motion[:3, 3])
    is_right = bool(motion[0, 3] < 0.0)
    parallel = np.allclose(motion[:3, :3], np.eye(3), atol=2e-5)
    sideways = bool(np.all(np.abs(motion[1:3, 3]) < 1e-4 * baseline))
    undistorted = not a.is_distorted and not b.is_distorted
    return bool(same_matrix and same_size and parallel and sideways and is_right and undistorted)


def rectified_projections(rig: Rig) -> list[tuple[Floats, Floats]]:
    """For each camera, rectified_from_cam (3, 3) and projection (3, 4) of the rectified camera.

    These are R and P of calibration messages of ROS and Foxglove. Cameras of a larger rig, or of a
    pair that sees nothing in common, are not rectified.

    Raises:
        CalibrationError: the pair cannot be rectified.
    """
    if rig.cam1_from_cam0 is None or rig.further or not overlaps(rig):
        return [(np.eye(3), np.column_stack([c.matrix, np.zeros(3)])) for c in rig.cameras]
    rectified = rectified_rig(rig)
    left_rotation = rectified.cam0_from_rectified[:3, :3].T
    left = np.column_stack([rectified.matrix, np.zeros(3)])
    right = left.copy()
    right[0, 3] = -rectified.fx * rectified.baseline_m
    return [(left_rotation, left), (left_rotation @ rig.cam1_from_cam0[:3, :3].T, right)]
