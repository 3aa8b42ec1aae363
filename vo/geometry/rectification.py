"""Rectification: recorded images to the images of ideal pinhole cameras, and pixels back.

Images of stereo pairs are remapped (rows correspond, no distortion), and so are those of wide
lenses, where patches then keep their shape and pixels their precision (195 degree lens, hand-held
in a room, mono: ATE 0.004 m instead of 0.020 m). Other images of a single camera stay as recorded;
only positions of features are undistorted, which is cheaper and keeps every pixel.
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
# A pixel outside of every image, for rays that a lens does not see; OpenCV's maps have 16 bits.
_OUTSIDE_PX = -10000.0
# Maximum distance of neighbours in a map, unless one of them is outside of the image.
_TORN_PX = 100.0
# Depth is converted to disparity at this baseline. The standard deviation of a disparity, 0.4 px,
# then means 1 cm at 2 m and 6 cm at 5 m (fx = 525), about that of structured light and time of
# flight.
VIRTUAL_BASELINE_M = 0.3
# Beyond 75 degrees from the optical axis a pinhole camera stretches pixels too far.
_MAX_RAY = np.tan(np.deg2rad(75.0))


@dataclass(frozen=True, eq=False)
class RectifiedRig:
    """Ideal pinhole cameras, left and right with the same intrinsics, and the way to them.

    Attributes:
        fx: focal length along u in pixels.
        fy: focal length along v.
        cx: principal point, u.
        cy: principal point, v.
        baseline_m: distance from the left to the right camera, 0 in mono, `VIRTUAL_BASELINE_M` for
            cameras with depth.
        cam0_from_rectified: (4, 4) rotation from the rectified left camera to the recorded cam0.
        lens: the distorted camera, with its error corrected, whose images are used as recorded;
            None without distortion.
        maps: OpenCV's rectification maps of each camera, None for images used as recorded.
        k1_error: corrected k1 of that lens minus its calibrated value.
        disparity_offset_px: error of all disparities.
        disparity_curve_px: further error of disparities, times the squared horizontal distance from
            the principal point in focal lengths.
        offset_is_yaw: whether the offset is due to a yaw of the right camera.
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
        """The (3, 3) camera matrix of both rectified cameras."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def intrinsics(self) -> Intrinsics:
        """fx, fy, cx, cy of both rectified cameras."""
        return Intrinsics(self.fx, self.fy, self.cx, self.cy)

    @property
    def is_stereo(self) -> bool:
        """Whether there is a right camera, or depth in its place."""
        return self.baseline_m > 0.0

    def rectify(self, image: Bytes, side: int) -> Bytes:
        """Rectified image of cam0 (side 0) or cam1 (side 1)."""
        maps = self.maps[side]
        if maps is None:
            return image
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), dtype=np.uint8)

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
        if self.maps[1] is not None:
            recorded = cv2.convertMaps(*self.maps[1], cv2.CV_32FC1)
            at_u, at_v = (_interpolated(side, at_u, at_v) for side in recorded)
        return replace(self, maps=(self.maps[0], cv2.convertMaps(at_u, at_v, cv2.CV_16SC2)))

    def with_k1_error(self, k1: float) -> RectifiedRig:
        """The same rig with a lens whose k1 exceeds its calibrated value by `k1`."""
        return replace(self, lens=_with_k1(self.lens_or_pinhole, k1 - self.k1_error), k1_error=k1)

    @property
    def lens_or_pinhole(self) -> Camera:
        """The lens, or a `radtan` lens without distortion."""
        size = self.width, self.height
        ideal = Camera(*size, *self.intrinsics, "radtan", (0.0, 0.0, 0.0, 0.0))
        return self.lens or ideal

    def disparity_error(self, right_u: Floats) -> Floats:
        """Errors (N,) of disparities at horizontal positions (N,) in the right image, in pixels."""
        x = (right_u - self.cx) / self.fx
        return np.asarray(self.disparity_offset_px + self.disparity_curve_px * x**2)

    def undistort(self, xy: Floats | Floats32) -> Floats:
        """Undistorted pixels (N, 2) of rectified image pixels (N, 2); NaN beyond 75 degrees."""
        at = np.asarray(xy, dtype=np.float64)
        if self.lens is None:
            return at
        rays = cameras.normalise(self.lens, at)
        if self.k1_error != 0.0:  # the corrected lens may have a smaller reach
            beyond = np.isnan(rays).any(axis=1)
            rays[beyond] = cameras.normalise(_with_k1(self.lens, -self.k1_error), at[beyond])
        rays[np.linalg.norm(rays, axis=1) > _MAX_RAY] = np.nan
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


def rectified_rig(rig: Rig) -> RectifiedRig:
    """Choose rectified cameras for a rig, and compute their maps.

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
    """Whether OpenCV's `stereoRectify` does not support the lens model."""
    return camera.distortion_model not in ("none", "radtan")


def _central_focal(camera: Camera) -> tuple[float, float]:
    """Focal lengths of the pinhole camera with the same magnification on the axis."""
    scale = centre_scale(camera)
    return scale * camera.fx, scale * camera.fy


def _wide_rectification(
    a: Camera, b: Camera, rotation: Floats, translation: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Rotate both cameras half-way towards each other, then align x with the baseline.

    OpenCV's fisheye version chooses focal lengths that crop the image to a small part. Here both
    cameras get the mean focal length (on the axis) and principal point of the recorded ones: 100
    to 120 degrees of a usual fisheye, nowhere reduced in size.

    Returns:
        Rotations (3, 3) of both cameras and projections (3, 4), as `cv2.stereoRectify`.

    Source: Fusiello et al., "A compact algorithm for rectification of stereo pairs", 2000.
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
    """Maps to the recorded image, outside of it for rays that the lens does not see."""
    v, u = np.mgrid[: size[1], : size[0]].astype(np.float64)
    pixels = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    rays = pixels @ np.linalg.inv(projection[:, :3]).T @ rotation
    xy = np.nan_to_num(cameras.project(camera, rays), nan=_OUTSIDE_PX)
    bounded = np.clip(xy, _OUTSIDE_PX, -_OUTSIDE_PX).astype(np.float32)
    first, second = cv2.convertMaps(bounded.reshape(size[1], size[0], 2), None, cv2.CV_16SC2)
    return first, second


def _interpolated(values: Floats32, u: Floats32, v: Floats32) -> Floats32:
    """Values of a map at positions between its pixels; `_OUTSIDE_PX` where it has none."""

    def remapped(interpolation: int) -> Floats32:
        found = cv2.remap(values, u, v, interpolation, None, cv2.BORDER_CONSTANT, _OUTSIDE_PX)
        return np.asarray(found, dtype=np.float32)

    between, nearest = remapped(cv2.INTER_LINEAR), remapped(cv2.INTER_NEAREST)
    is_torn = np.abs(between - nearest) > _TORN_PX
    return np.where(is_torn, np.float32(_OUTSIDE_PX), between)


def _check_baseline(cam1_in_cam0: Floats) -> None:
    along_x, length = float(cam1_in_cam0[0]), float(np.linalg.norm(cam1_in_cam0))
    if length <= 0.0 or along_x < 0.5 * length:
        raise CalibrationError(
            f"cam1 must be to the right of cam0, but its baseline along x is {along_x:.4g} m of "
            f"{length:.4g} m; swap left and right, or check cam1_from_cam0"
        )
