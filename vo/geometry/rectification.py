"""From recorded images to those that the odometry works on, and from its pixels back.

Stereo pairs are rectified whole (rows correspond, no distortion), and so are images of a wide lens:
patches keep their shape and pixels their precision there (a 195 degree lens by hand in a room with
one camera: ATE 0.004 m instead of 0.020 m). Other images of a single camera stay as recorded; only
the positions of features are undistorted, which is cheaper and keeps every pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.errors import CalibrationError
from vo.geometry import cameras
from vo.geometry.distortion import centre_scale
from vo.geometry.projection import Intrinsics
from vo.geometry.transforms import inverse, make_transform
from vo.geometry.vertical_disparity_model import VerticalDisparity
from vo.types import Bytes, Camera, Floats, Floats32, Rig

_Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]
# A place outside every image, for what a lens does not see; OpenCV's maps hold 16 bits.
_OUTSIDE_PX = -10000.0
# Neighbours in a map are less apart than this, unless one of them is outside.
_TORN_PX = 100.0
# The standard deviation of a disparity, 0.4 px, is then one of 1 cm in 2 m and of 6 cm in 5 m
# (fx = 525): about what structured light and time of flight keep to.
VIRTUAL_BASELINE_M = 0.3
# Beyond this angle from the optical axis the ideal pinhole camera stretches pixels too far.
_MAX_RAY = np.tan(np.deg2rad(75.0))


@dataclass(frozen=True, eq=False)
class RectifiedRig:
    """The ideal pinhole cameras that the odometry computes with.

    Attributes:
        fx: focal length along u in pixels.
        fy: focal length along v.
        cx: principal point, u.
        cy: principal point, v.
        baseline_m: distance from the left to the right camera, 0 in mono; where depth is measured,
            that to a right camera that is not there (`VIRTUAL_BASELINE_M`).
        cam0_from_rectified: (4, 4) turns the rectified left camera into the recorded cam0.
        lens: the distorted camera whose images are used as recorded, or None if there is nothing
            to undo; with its error corrected.
        maps: OpenCV's rectification maps of each camera, None for images that are used as is.
        k1_error: k1 of that lens minus its calibrated value.
        disparity_offset_px: what a slightly wrong calibration adds to every disparity.
        disparity_curve_px: what it adds besides at one focal length from the image's middle, with
            the square of the distance, left and right.
        offset_is_yaw: whether the offset is there because the right camera looks sideways.
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
    maps: tuple[_Maps | None, ...] = (None, None)
    k1_error: float = 0.0
    disparity_offset_px: float = 0.0
    disparity_curve_px: float = 0.0
    offset_is_yaw: bool = False

    @property
    def matrix(self) -> Floats:
        """The (3, 3) camera matrix of both working cameras."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def intrinsics(self) -> Intrinsics:
        """fx, fy, cx, cy of both rectified cameras."""
        return Intrinsics(self.fx, self.fy, self.cx, self.cy)

    @property
    def is_stereo(self) -> bool:
        """Whether there is a right camera, or depth that stands for it."""
        return self.baseline_m > 0.0

    def rectify(self, image: Bytes, side: int) -> Bytes:
        """The working image of cam0 (side 0) or cam1 (side 1)."""
        maps = self.maps[side]
        if maps is None:
            return image
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), dtype=np.uint8)

    def rectify_depth(self, depth: Floats32) -> Floats32:
        """Depth at the pixels of the working image: moved, never mixed, as edges are in it."""
        if self.maps[0] is None:
            return depth
        nearest = cv2.remap(depth, self.maps[0][0], None, cv2.INTER_NEAREST)
        return np.asarray(nearest, dtype=np.float32)

    def with_right_corrected(self, errors: VerticalDisparity) -> RectifiedRig:
        """The same rig whose right images are taken from where points are really seen."""
        v, u = np.ogrid[: self.height, : self.width]
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        at_u = (u + errors.horizontal_px(x, y)).astype(np.float32)
        at_v = (v + errors.vertical_px(x, y)).astype(np.float32)
        if self.maps[1] is not None:
            recorded = cv2.convertMaps(*self.maps[1], cv2.CV_32FC1)
            at_u, at_v = (_looked_up(side, at_u, at_v) for side in recorded)
        return replace(self, maps=(self.maps[0], cv2.convertMaps(at_u, at_v, cv2.CV_16SC2)))

    def with_k1_error(self, k1: float) -> RectifiedRig:
        """The same rig with a lens whose k1 is larger by so much than calibrated."""
        return replace(self, lens=_bent(self.lens_or_pinhole, k1 - self.k1_error), k1_error=k1)

    @property
    def lens_or_pinhole(self) -> Camera:
        """The lens; one that distorts nothing where there is none."""
        size = self.width, self.height
        ideal = Camera(*size, *self.intrinsics, "radtan", (0.0, 0.0, 0.0, 0.0))
        return self.lens or ideal

    def disparity_error(self, right_u: Floats) -> Floats:
        """What the calibration adds to disparities of points at columns (N,) on the right."""
        x = (right_u - self.cx) / self.fx
        return np.asarray(self.disparity_offset_px + self.disparity_curve_px * x**2)

    def undistort(self, xy: Floats | Floats32) -> Floats:
        """Ideal pinhole pixels (N, 2) of working-image pixels (N, 2); NaN far off the axis."""
        at = np.asarray(xy, dtype=np.float64)
        if self.lens is None:
            return at
        rays = cameras.normalise(self.lens, at)
        if self.k1_error != 0.0:  # with which it may not reach as far
            beyond = np.isnan(rays).any(axis=1)
            rays[beyond] = cameras.normalise(_bent(self.lens, -self.k1_error), at[beyond])
        rays[np.linalg.norm(rays, axis=1) > _MAX_RAY] = np.nan
        return np.asarray(rays * (self.fx, self.fy) + (self.cx, self.cy))

    def distort(self, xy: Floats) -> Floats:
        """Working-image pixels (N, 2) of ideal pinhole pixels (N, 2)."""
        if self.lens is None:
            return xy
        return cameras.distort(self.lens, (xy - (self.cx, self.cy)) / (self.fx, self.fy))

    def project(self, points: Floats) -> Floats:
        """Ideal pixels (N, 2) of points (N, 3) in the working camera's frame."""
        return np.asarray(points[:, :2] / points[:, 2:] * (self.fx, self.fy) + (self.cx, self.cy))

    def back_project(self, xy: Floats, depth: Floats) -> Floats:
        """Points (N, 3) in the working camera's frame at ideal pixels (N, 2) and depths (N,)."""
        rays = (xy - (self.cx, self.cy)) / (self.fx, self.fy)
        return np.column_stack([rays * depth[:, None], depth])


def rectified_rig(rig: Rig) -> RectifiedRig:
    """Choose the working cameras of a rig, and what it takes to get there.

    Raises:
        CalibrationError: cam1 is not to the right of cam0.
    """
    c = rig.cam0
    if rig.cam1 is None or rig.cam1_from_cam0 is None:
        return _single(c, VIRTUAL_BASELINE_M if rig.has_depth else 0.0)
    _check_baseline(inverse(rig.cam1_from_cam0)[:3, 3])
    if _is_rectified(rig):
        baseline = -float(rig.cam1_from_cam0[0, 3])
        return RectifiedRig(c.width, c.height, c.fx, c.fy, c.cx, c.cy, baseline, np.eye(4))
    return _rectified(c, rig.cam1, rig.cam1_from_cam0)


def _single(c: Camera, baseline: float) -> RectifiedRig:
    if not _is_wide(c):
        lens = c if c.is_distorted else None
        return RectifiedRig(c.width, c.height, c.fx, c.fy, c.cx, c.cy, baseline, np.eye(4), lens)
    fx, fy = _central_focal(c)
    matrix = np.array([[fx, 0.0, c.cx], [0.0, fy, c.cy], [0.0, 0.0, 1.0]])
    maps = (_wide_maps(c, np.eye(3), matrix, (c.width, c.height)), None)
    return RectifiedRig(c.width, c.height, fx, fy, c.cx, c.cy, baseline, np.eye(4), None, maps)


def _bent(lens: Camera, k1: float) -> Camera:
    """A `radtan` lens whose k1 is larger by so much."""
    first, *others = lens.distortion
    return replace(lens, distortion=(first + k1, *others))


def _is_rectified(rig: Rig) -> bool:
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    a, b, motion = rig.cam0, rig.cam1, rig.cam1_from_cam0
    same_matrix = np.allclose((a.fx, a.fy, a.cx, a.cy), (b.fx, b.fy, b.cx, b.cy), atol=0.02)
    same_size = (a.width, a.height) == (b.width, b.height)
    baseline = np.linalg.norm(motion[:3, 3])
    parallel = np.allclose(motion[:3, :3], np.eye(3), atol=2e-5)
    sideways = bool(np.all(np.abs(motion[1:3, 3]) < 1e-4 * baseline))
    undistorted = not a.is_distorted and not b.is_distorted
    return bool(same_matrix and same_size and parallel and sideways and undistorted)


def _rectified(a: Camera, b: Camera, cam1_from_cam0: Floats) -> RectifiedRig:
    size = (a.width, a.height)
    rotation, translation = cam1_from_cam0[:3, :3].copy(), cam1_from_cam0[:3, 3:4].copy()
    if _is_wide(a) or _is_wide(b):
        r0, r1, p0, p1 = _wide_rectification(a, b, rotation, translation)
        maps = (_wide_maps(a, r0, p0, size), _wide_maps(b, r1, p1, size))
    else:
        r0, r1, p0, p1 = cv2.stereoRectify(
            a.matrix,
            np.array(a.distortion),
            b.matrix,
            np.array(b.distortion),
            size,
            rotation,
            translation,
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=0.0,
        )[:4]
        maps = (_narrow_maps(a, r0, p0, size), _narrow_maps(b, r1, p1, size))
    baseline = -float(p1[0, 3] / p1[0, 0])
    fx, fy, cx, cy = float(p0[0, 0]), float(p0[1, 1]), float(p0[0, 2]), float(p0[1, 2])
    cam0_from_rectified = make_transform(r0.T, np.zeros(3))
    return RectifiedRig(
        a.width, a.height, fx, fy, cx, cy, baseline, cam0_from_rectified, None, maps
    )


def _is_wide(camera: Camera) -> bool:
    """Whether the lens is of a model that OpenCV's `stereoRectify` does not know."""
    return camera.distortion_model not in ("none", "radtan")


def _central_focal(camera: Camera) -> tuple[float, float]:
    """Focal lengths of the pinhole camera that shows what is on the axis at the same size."""
    scale = centre_scale(camera)
    return scale * camera.fx, scale * camera.fy


def _wide_rectification(
    a: Camera, b: Camera, rotation: Floats, translation: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Rotate both cameras half-way, then x along the baseline (Fusiello et al., 2000).

    OpenCV's own fisheye version chooses focal lengths that cut the image to a small part; here
    both working cameras keep the mean focal length (on the axis) and principal point of the
    recorded ones: 100 to 120 degrees of a usual fisheye, of which nothing is shrunk.
    """
    half, _ = cv2.Rodrigues(-0.5 * cv2.Rodrigues(rotation)[0])
    along = (half @ translation).reshape(3)
    x = -along / np.linalg.norm(along)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    turn = np.stack([x, y, np.cross(x, y)])
    focal = float(np.mean([*_central_focal(a), *_central_focal(b)]))
    p0 = np.array(
        [
            [focal, 0.0, 0.5 * (a.cx + b.cx), 0.0],
            [0.0, focal, 0.5 * (a.cy + b.cy), 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    p1 = p0.copy()
    p1[0, 3] = -focal * float(np.linalg.norm(translation))
    return turn @ half.T, turn @ half, p0, p1


def _narrow_maps(
    camera: Camera, rotation: Floats, projection: Floats, size: tuple[int, int]
) -> _Maps:
    coefficients = np.array(camera.distortion, dtype=np.float64)
    first, second = cv2.initUndistortRectifyMap(
        camera.matrix, coefficients, rotation, projection[:, :3].copy(), size, cv2.CV_16SC2
    )
    return first, second


def _wide_maps(
    camera: Camera, rotation: Floats, projection: Floats, size: tuple[int, int]
) -> _Maps:
    """Where each working pixel is in the recorded image; outside of it what the lens cannot see."""
    v, u = np.mgrid[: size[1], : size[0]].astype(np.float64)
    pixels = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    rays = pixels @ np.linalg.inv(projection[:, :3]).T @ rotation
    xy = np.nan_to_num(cameras.project(camera, rays), nan=_OUTSIDE_PX)
    bounded = np.clip(xy, _OUTSIDE_PX, -_OUTSIDE_PX).astype(np.float32)
    first, second = cv2.convertMaps(bounded.reshape(size[1], size[0], 2), None, cv2.CV_16SC2)
    return first, second


def _looked_up(values: Floats32, u: Floats32, v: Floats32) -> Floats32:
    """Values of a map between its pixels, and outside of it what lies outside of every image."""

    def looked_up(how: int) -> Floats32:
        found = cv2.remap(values, u, v, how, None, cv2.BORDER_CONSTANT, _OUTSIDE_PX)
        return np.asarray(found, dtype=np.float32)

    between, nearest = looked_up(cv2.INTER_LINEAR), looked_up(cv2.INTER_NEAREST)
    is_torn = np.abs(between - nearest) > _TORN_PX
    return np.where(is_torn, np.float32(_OUTSIDE_PX), between)


def _check_baseline(cam1_in_cam0: Floats) -> None:
    along_x, length = float(cam1_in_cam0[0]), float(np.linalg.norm(cam1_in_cam0))
    if length <= 0.0 or along_x < 0.5 * length:
        raise CalibrationError(
            f"cam1 must be to the right of cam0, but its baseline along x is {along_x:.4g} m of "
            f"{length:.4g} m; swap left and right, or check cam1_from_cam0"
        )
