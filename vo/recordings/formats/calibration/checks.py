"""Cameras, rigs, transforms and noise from values of a calibration file, checked.

Cameras may be given by OpenCV's matrices K, D, R, T and P.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.distortion import angle_reach, centre_scale, undistort_rays
from vo.base.geometry.transforms import inverse, make_transform, orthonormalised
from vo.base.types import Camera, Floats, ImuNoise, MountedCamera, Rig
from vo.recordings.formats.calibration.document import ImageSize
from vo.recordings.formats.calibration.lenses import (
    PROJECTIONS,
    check_lens,
    join_projection,
    make_lens,
)
from vo.recordings.formats.calibration.numbers import (
    check_rotation,
    make_list,
    make_matrix,
    make_number,
    make_numbers,
    make_resolution,
)
from vo.recordings.formats.warning_kinds import warning_kind

_MIN_BASELINE_M = 1e-6
_SHORT_BASELINE_M, _MAX_BASELINE_M = 1e-3, 10.0
_MIN_FOCAL_RATIO = 0.03
"""Focal length over image size below which it is in another unit: a view of 173 degrees."""
_MAX_READOUT_S = 0.2
_PLAUSIBLE_FOCAL_RATIO = (0.1, 20.0)
"""Focal length over image width: pinhole cameras with fields of view of 157 and 3 degrees."""
_SAME_SCALE = 0.1
_SAME_POSE = 1e-6
_CENTRED = (0.75, 1.3)
"""Principal point relative to the centre, where both sides have about the same ratio."""
_GRID = 15
_MAX_FOLDED, _SOME_FOLDED = 0.3, 0.15
"""Parts of the image in which a lens cannot be undone: of a wrong model, or doubtful corners."""
_MAX_ROUNDING = 1e-6
_MAX_SKEW_PX = 1.0
_ZERO_IS_NONE = (None, "", "none", "radtan", "plumb_bob", "rational_polynomial")
_HIGHEST_NOISE = (1.0, 1.0, 100.0, 100.0)
"""Noise above these is in another unit, or a text has been misread."""
_NOISE_UNITS = ("rad/s/√Hz", "rad/s²/√Hz", "m/s²/√Hz", "m/s³/√Hz")
_MAX_OFFSET_S = 1.0
checks_log = logging.getLogger(__name__)


def make_camera(
    where: str,
    resolution: Any,
    intrinsics: Any,
    distortion_model: Any = None,
    distortion: Any = (),
    *,
    model: Any = "pinhole",
    zero_is_none: bool = False,
) -> Camera:
    """Create a camera from the values in a file.

    Args:
        where: file and section, for error messages.
        resolution: width and height in pixels.
        intrinsics: parameters of the projection model, then fx, fy, cx, cy in pixels.
        distortion_model: a key of `DISTORTION_NAMES`, or None without distortion.
        distortion: distortion coefficients.
        model: Kalibr's name of the projection, a key of `PROJECTIONS`.
        zero_is_none: whether radtan coefficients that are all 0 are no distortion.
    """
    if not isinstance(model, str) or model not in PROJECTIONS:
        known = ", ".join(f"'{name}'" for name in PROJECTIONS)
        raise CalibrationError(
            f"{where}: camera model {str(model)[:40]!r} is not supported; supported are {known}"
        )
    width, height = make_resolution(where, resolution)
    names = (*PROJECTIONS[model][1], "fx", "fy", "cx", "cy")
    numbers = make_numbers(f"{where}: intrinsics [{', '.join(names)}]", intrinsics, len(names))
    fx, fy, cx, cy = numbers[-4:]
    if zero_is_none and str(distortion_model).startswith("rad") and not any(distortion):
        distortion_model, distortion = "none", ()
    lens = make_lens(where, distortion_model, distortion)
    name, coefficients = join_projection(where, model, numbers[:-4], lens)
    camera = Camera(width, height, fx, fy, cx, cy, name, coefficients)
    check_lens(where, camera)
    _check_pinhole(where, camera)
    return camera


def matrix_camera(
    where: str, *, resolution: Any, matrix: Any, distortion_model: Any, distortion: Any
) -> Camera:
    """A camera from its 3x3 matrix K; the default distortion model is radtan."""
    k = make_matrix(f"{where}: camera matrix", matrix, 3, 3)
    check_camera_matrix(where, k)
    coefficients = make_list(f"{where}: distortion", distortion)
    if not any(coefficients) and distortion_model in _ZERO_IS_NONE:
        distortion_model, coefficients = "none", ()
    intrinsics = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    return make_camera(where, resolution, intrinsics, distortion_model or "radtan", coefficients)


def given_size(
    values: Mapping[str, Any], names: Iterable[str], image_size: ImageSize | None
) -> Any:
    """Width and height by their keys, unchecked, or else the size of the images."""
    size = [values.get(name) for name in names]
    return image_size if None in size else size


def make_rig(where: str, cam0: Camera, cam1: Camera, cam1_from_cam0: Floats) -> Rig:
    """A stereo rig, its baseline checked."""
    check_baseline(where, cam1_from_cam0)
    return Rig(cam0, cam1, cam1_from_cam0)


def rig_of(where: str, cameras: Sequence[Camera], cam0_from_cams: Sequence[Floats]) -> Rig:
    """A rig of any number of cameras, given their poses relative to camera 0."""
    if len(cameras) == 1:
        return Rig(cameras[0])
    cam1_from_cam0 = inverse(cam0_from_cams[1])
    if len(cameras) == 2:
        return make_rig(where, cameras[0], cameras[1], cam1_from_cam0)
    _check_apart(where, cam0_from_cams)
    further = map(MountedCamera, cameras[2:], cam0_from_cams[2:])
    return Rig(cameras[0], cameras[1], cam1_from_cam0, further=tuple(further))


def _check_apart(where: str, cam0_from_cams: Sequence[Floats]) -> None:
    """Refuse cameras that are at the same place and look the same way, and warn of far ones."""
    for j, pose in enumerate(cam0_from_cams):
        for i, other in enumerate(cam0_from_cams[:j]):
            if np.abs(pose - other).max() < _SAME_POSE:
                raise CalibrationError(
                    f"{where}: cam{i} and cam{j} have the same pose; give each camera once, with "
                    "its own pose"
                )
        if np.linalg.norm(pose[:3, 3]) > _MAX_BASELINE_M:
            check_baseline(f"{where}: cam{j}", pose)


def rectified_rig(where: str, cam0: Camera, cam1: Camera, baseline_m: float) -> Rig:
    """A rectified rig: the second camera is to the right of the first."""
    return make_rig(where, cam0, cam1, make_transform(np.eye(3), np.array([-baseline_m, 0.0, 0.0])))


def make_readout(where: str, value: Any) -> float:
    """Time from the first to the last row of an image, in seconds; 0 for None."""
    readout_s = 0.0 if value is None else make_number(where, value)
    if not 0.0 <= readout_s <= _MAX_READOUT_S:
        raise CalibrationError(
            f"{where} is {readout_s:g}; it is the time from the first to the last row of an image "
            f"in seconds, from 0 (global shutter) to {_MAX_READOUT_S:g}"
        )
    return readout_s


def check_baseline(where: str, cam1_from_cam0: Floats) -> None:
    """Refuse a baseline of zero, and warn of an implausible one."""
    baseline = float(np.linalg.norm(cam1_from_cam0[:3, 3]))
    if baseline < _MIN_BASELINE_M:
        raise CalibrationError(
            f"{where}: the baseline is {baseline:g} m, so depth cannot be measured; give the "
            "distance between the cameras in metres, or use one camera with `mode=mono`"
        )
    if baseline < _SHORT_BASELINE_M:
        checks_log.warning(
            "%s: the baseline is only %.3g m; it must be in metres, and in the projection P of a "
            "right camera the last column is -fx times that",
            where,
            baseline,
            extra=warning_kind("calibration"),
        )
    if baseline > _MAX_BASELINE_M:
        checks_log.warning(
            "%s: the baseline is %g m; if the unit is millimetres, all lengths will be 1000 times "
            "too large, if it is centimetres, 100 times",
            where,
            baseline,
            extra=warning_kind("large_baseline"),
        )


def rotation_and_translation(where: str, rotation: Any, translation: Any) -> Floats:
    """The (4, 4) transform of OpenCV's R (3x3) and T (three numbers)."""
    r = make_rotation(f"{where}: rotation", rotation)
    t = make_list(f"{where}: translation", translation)
    if len(t) != 3:
        raise CalibrationError(f"{where}: translation has {len(t)} numbers; 3 are needed")
    return make_transform(r, np.array(t))


def make_rotation(where: str, value: Any) -> Floats:
    """A (3, 3) rotation, orthonormalised."""
    rotation = make_matrix(where, value, 3, 3)
    check_rotation(where, rotation)
    return orthonormalised(make_transform(rotation, np.zeros(3)))[:3, :3]


def make_projection(where: str, value: Any) -> tuple[Floats, Floats]:
    """A (3, 4) projection P = K [I | t] of a rectified camera, and t (3,).

    The rectified cameras of a rig have parallel axes, so that p_in_camera = p_in_common + t.
    """
    p = make_matrix(f"{where}: projection matrix", value, 3, 4)
    if not (p[0, 0] > 1e-3 and p[1, 1] > 1e-3):
        raise CalibrationError(
            f"{where}: the projection matrix has focal lengths {p[0, 0]:g}, {p[1, 1]:g}; they must "
            "be above 0"
        )
    z = p[2, 3]
    return p, np.array([(p[0, 3] - p[0, 2] * z) / p[0, 0], (p[1, 3] - p[1, 2] * z) / p[1, 1], z])


def common_from_camera(where: str, rotation: Any, projection: Any) -> Floats:
    """(4, 4) from an unrectified camera to the common rectified frame of its rig, from R and P."""
    _, t = make_projection(where, projection)
    r = np.eye(3) if rotation is None else make_rotation(f"{where}: rectification", rotation)
    return make_transform(r, -t)


def relative_pose(common_from_cam0: Floats, common_from_cam1: Floats) -> Floats:
    """cam1_from_cam0 of two cameras, given their poses in a common frame."""
    return np.asarray(inverse(common_from_cam1) @ common_from_cam0)


def make_noise(
    where: str, values: Mapping[str, Any], names: tuple[str, str, str, str]
) -> ImuNoise | None:
    """The noise of a sensor; None if the file has none of its values.

    `names`: keys of the white noise of the gyroscope, its random walk, and the same of the
    accelerometer.
    """
    if not any(name in values for name in names):
        return None
    missing = [name for name in names if name not in values]
    if missing:
        raise CalibrationError(
            f"{where}: {missing[0]} is missing; noise is given by {', '.join(names)}"
        )
    numbers = [make_number(f"{where}: {name}", values[name]) for name in names]
    for name, number, highest, unit in zip(
        names, numbers, _HIGHEST_NOISE, _NOISE_UNITS, strict=True
    ):
        if not 0.0 <= number <= highest:
            raise CalibrationError(
                f"{where}: {name} is {number:g}; it must be from 0 to {highest:g} {unit}"
            )
    return ImuNoise(*numbers)


def make_time_offset(where: str, value: Any) -> float:
    """A time offset in seconds; 0 if it is missing. A large one causes a warning."""
    if value is None:
        return 0.0
    offset_s = make_number(where, value)
    if abs(offset_s) > _MAX_OFFSET_S:
        checks_log.warning(
            "%s is %g s between camera and IMU; it must be in seconds", where, offset_s
        )
    return offset_s


def check_camera_matrix(where: str, k: Floats) -> None:
    """Refuse a (3, 3) matrix that is not fx 0 cx / 0 fy cy / 0 0 1; warn of a skew of the axes."""
    if not k.any():
        raise CalibrationError(f"{where}: the camera matrix is zero: it was never calibrated")
    if k[2, :2].min() > 1.0 and k[2, 2] == 1.0 and not np.any(k[:2, 2]):
        raise CalibrationError(f"{where}: the camera matrix is transposed; write it row by row")
    if np.abs(k[2] - (0.0, 0.0, 1.0)).max() > _MAX_ROUNDING or abs(k[1, 0]) > _MAX_ROUNDING:
        raise CalibrationError(
            f"{where}: the camera matrix has the rows {_row(k[1])} and {_row(k[2])}; they must be "
            "[0, fy, cy] and [0, 0, 1]"
        )
    if abs(k[0, 1]) > _MAX_SKEW_PX:
        checks_log.warning(
            "%s: the skew of the camera matrix, %g px, is not used: axes of pixels are taken as "
            "perpendicular",
            where,
            k[0, 1],
        )


def _row(numbers: Floats) -> str:
    return "[" + ", ".join(f"{number:g}" for number in numbers) + "]"


def _check_pinhole(where: str, camera: Camera) -> None:
    if min(camera.fx / camera.width, camera.fy / camera.height) < _MIN_FOCAL_RATIO:
        raise CalibrationError(
            f"{where}: focal length is {camera.fx:g}, {camera.fy:g}; it must be above 0, and in "
            f"pixels of the {camera.width}x{camera.height} image: multiply one relative to the "
            "image by its size, divide one in millimetres by the size of a pixel"
        )
    off_u = _outside(camera.cx, camera.width)
    off_v = _outside(camera.cy, camera.height)
    if max(off_u, off_v) > 0.5:
        raise CalibrationError(
            f"{where}: principal point ({camera.cx:g}, {camera.cy:g}) is far outside the "
            f"{camera.width}x{camera.height} image; intrinsics are [fx, fy, cx, cy] in pixels"
        )
    if max(off_u, off_v) > 0.0:
        checks_log.warning(
            "%s: principal point (%g, %g) is outside the %dx%d image; check that the calibration "
            "is for images of this size",
            where,
            camera.cx,
            camera.cy,
            camera.width,
            camera.height,
            extra=warning_kind("calibration"),
        )
    sides = (2.0 * camera.cx + 1.0) / camera.width, (2.0 * camera.cy + 1.0) / camera.height
    is_scaled = max(sides) < (1.0 + _SAME_SCALE) * min(sides)
    if is_scaled and not _CENTRED[0] <= np.mean(sides) <= _CENTRED[1]:
        checks_log.warning(
            "%s: the principal point (%g, %g) is the centre of images of about %.0fx%.0f, and "
            "these have %dx%d: the calibration seems to be for another size; scale fx, fy, cx, cy",
            where,
            camera.cx,
            camera.cy,
            2.0 * camera.cx + 1.0,
            2.0 * camera.cy + 1.0,
            camera.width,
            camera.height,
            extra=warning_kind("calibration"),
        )
    ratio = centre_scale(camera) * camera.fx / camera.width
    if not _PLAUSIBLE_FOCAL_RATIO[0] <= ratio <= _PLAUSIBLE_FOCAL_RATIO[1]:
        field_of_view_deg = 2.0 * math.degrees(math.atan(0.5 / ratio))
        checks_log.warning(
            "%s: a focal length of %g for %d pixels is a field of view of %.3g degrees; check the "
            "unit (pixels) and the size of the images",
            where,
            camera.fx,
            camera.width,
            field_of_view_deg,
            extra=warning_kind("calibration"),
        )
    _check_reach(where, camera)


def _check_reach(where: str, camera: Camera) -> None:
    """Refuse a lens that cannot be undone in much of the image; warn if in a part.

    Fisheye images are often a disc, so that only the largest one in the image has to have rays.
    """
    if camera.distortion_model not in ("radtan", "equidistant"):
        return
    is_fisheye = camera.distortion_model == "equidistant"
    if is_fisheye and angle_reach(camera.distortion) >= np.pi / 2:
        return
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.5, 0.5, _GRID)] * 2))
    size = np.array([camera.width, camera.height])
    if is_fisheye:
        inside = np.hypot(u, v) <= 0.5
        u, v, size = u[inside], v[inside], np.array([size.min(), size.min()])
    pixels = np.column_stack([u, v]) * size + np.array([camera.width, camera.height]) / 2
    points = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    ratio = float(np.isnan(undistort_rays(camera, points)[:, 0]).mean())
    if ratio <= _SOME_FOLDED:
        return
    text = (
        f"{where}: the lens with {camera.distortion_model} {_row(np.array(camera.distortion))} "
        f"cannot be undone in {ratio:.0%} of the image; check the model and the order of the "
        "coefficients (radtan: k1, k2, p1, p2, k3; equidistant, for fisheye lenses: k1 to k4)"
    )
    if ratio > _MAX_FOLDED:
        raise CalibrationError(text)
    checks_log.warning("%s", text, extra=warning_kind("calibration"))


def _outside(centre: float, size: int) -> float:
    """Distance outside the image, as a fraction of its size; 0 inside."""
    return max(-centre, centre - size, 0.0) / size
