"""Reader of `camera.txt` of DSO and of the TUM monoVO data set.

A first line with the model and its numbers, a second with the size of the images; the further lines
describe DSO's rectified images and are not used. A lens of the FOV model is read as the equidistant
one that is nearest to it; they differ by less than 0.1 px.

Source: DSO, `src/util/Undistort.cpp`; Engel et al., "A photometrically calibrated benchmark for
monocular visual odometry", 2016.
"""

from __future__ import annotations

import re

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.types import Rig
from vo.recordings.formats.calibration.checks import make_camera
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_MODELS = ("Pinhole", "FOV", "RadTan", "EquiDistant", "KannalaBrandt")
_FIRST_LINE = re.compile(rf"(?:({'|'.join(_MODELS)})\s+)?({_NUMBER}(?:\s+{_NUMBER}){{4,7}})")
_SIZE_LINE = re.compile(r"(\d{1,5})\s+(\d{1,5})")
_MAX_ANGLE = np.radians(85.0)
_MAX_ERROR_PX = 0.1
_FITTED_ANGLES = 400
_SUPPORTED = {"RadTan": "radtan", "EquiDistant": "equidistant"}


def recognises(document: Document) -> bool:
    """Whether the first line has five or eight numbers, and the second a size."""
    lines = _lines(document)
    return (
        len(lines) >= 2
        and _FIRST_LINE.fullmatch(lines[0]) is not None
        and _SIZE_LINE.fullmatch(lines[1]) is not None
    )


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read the camera."""
    lines = _lines(document)
    first, second = _FIRST_LINE.fullmatch(lines[0]), _SIZE_LINE.fullmatch(lines[1])
    assert first is not None
    assert second is not None
    numbers = [float(text) for text in first[2].split()]
    width, height = int(second[1]), int(second[2])
    model = first[1] or ("FOV" if len(numbers) == 5 else "RadTan")
    fx, fy, cx, cy, *lens = numbers
    if cx < 1.0 and cy < 1.0:  # relative to the size; (0, 0) is the corner of the first pixel
        fx, fy, cx, cy = fx * width, fy * height, cx * width - 0.5, cy * height - 0.5
    distortion_model, distortion = "none", list[float]()
    if model == "FOV" and lens[0]:
        corner = np.abs([[cx, width - cx], [cy, height - cy]]).max(axis=1) / (fx, fy)
        scale, distortion = _equidistant_of_fov(document, lens[0], float(np.hypot(*corner)), fx)
        fx, fy, distortion_model = fx * scale, fy * scale, "equidistant"
    elif model in _SUPPORTED and len(lens) == 4:
        distortion_model, distortion = _SUPPORTED[model], lens
    elif model not in ("FOV", "Pinhole") or any(lens):
        raise CalibrationError(
            f"{document.path}: the lens model {model} with {lens} is not supported; FOV with one "
            "coefficient, and RadTan and EquiDistant with four are"
        )
    intrinsics = [fx, fy, cx, cy]
    camera = make_camera(
        str(document.path), [width, height], intrinsics, distortion_model, distortion
    )
    return Calibration(Rig(camera))


def _equidistant_of_fov(
    document: Document, omega: float, max_radius: float, fx: float
) -> tuple[float, list[float]]:
    """The equidistant lens that is nearest to one of the FOV model, up to a radius in the image.

    For a point at an angle theta from the axis, the FOV model gives the radius
    atan(2 tan(theta) tan(omega / 2)) / omega, in focal lengths.

    Returns:
        A factor for the focal lengths, and k1 to k4.

    Source: Devernay and Faugeras, "Straight lines have to be straight", 2001, eq. 13 and 14.
    """
    tangent = np.tan(omega / 2.0)
    angle = min(abs(max_radius * omega), np.pi / 2.0)
    widest = float(np.arctan2(np.sin(angle), 2.0 * abs(tangent) * np.cos(angle)))
    theta = np.linspace(0.0, min(widest, _MAX_ANGLE), _FITTED_ANGLES)[1:]
    radius = np.arctan(2.0 * np.tan(theta) * tangent) / omega
    scale = float(2.0 * tangent / omega)
    powers = theta[:, None] ** [3, 5, 7, 9]
    coefficients, *_ = np.linalg.lstsq(powers, radius / scale - theta, rcond=None)
    error_px = np.abs(scale * (theta + powers @ coefficients) - radius).max() * fx
    if widest > _MAX_ANGLE or error_px > _MAX_ERROR_PX:
        raise CalibrationError(
            f"{document.path}: the FOV lens with {omega:g} sees {np.degrees(2 * widest):.0f} "
            f"degrees, and differs by {error_px:.2g} px from the nearest supported lens model "
            "(equidistant); calibrate anew: vo calibrate"
        )
    return scale, coefficients.tolist()


def _lines(document: Document) -> list[str]:
    lines = (line.strip() for line in document.text.splitlines())
    return [line for line in lines if line and not line.startswith("#")]
