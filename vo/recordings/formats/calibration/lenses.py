"""Lens models of calibration files: names, numbers of coefficients, ranges of parameters."""

from __future__ import annotations

from typing import Any

from vo.base.errors import CalibrationError
from vo.base.types import Camera, DistortionModel
from vo.recordings.formats.calibration.numbers import make_list, unsupported

DISTORTION_NAMES: dict[str, DistortionModel] = {
    "none": "none",
    "radtan": "radtan",
    "radtan5": "radtan",
    "radtan8": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "equidistant",
    "kannala_brandt": "equidistant",
    "fisheye": "equidistant",
    "double_sphere": "double_sphere",
    "ds": "double_sphere",
    "extended_unified": "extended_unified",
    "eucm": "extended_unified",
    "omni": "omni",
    "mei": "omni",
    "equirectangular": "equirectangular",
}
COUNTS: dict[DistortionModel, tuple[int, ...]] = {
    "none": (0,),
    "radtan": (4, 5, 8),
    "equidistant": (4,),
    "double_sphere": (2,),
    "extended_unified": (2,),
    "omni": (1, 5, 6, 9),
    "equirectangular": (0,),
}
PROJECTIONS: dict[str, tuple[DistortionModel, tuple[str, ...]]] = {
    "pinhole": ("none", ()),
    "omni": ("omni", ("xi",)),
    "ds": ("double_sphere", ("xi", "alpha")),
    "eucm": ("extended_unified", ("alpha", "beta")),
}
"""Kalibr's camera models: the lens model, and its parameters before fx in the intrinsics."""

_OPENCV_COUNTS = (12, 14)
"""OpenCV's thin-prism and tilted models; supported if all coefficients after the eighth are 0."""


def _compared(name: Any) -> str:
    """A name in lower case, only its letters and digits."""
    return "".join(character for character in str(name).lower() if character.isalnum())


_NAMES: dict[str, DistortionModel] = {_compared(n): m for n, m in DISTORTION_NAMES.items()} | {
    "equi": "equidistant",
    "kannalabrandt4": "equidistant",
    "kb4": "equidistant",
    "radialtangential8": "radtan",
    "brownconrady": "radtan",
}
"""Names without their punctuation, and others that some programs write."""


def lens_named(name: Any) -> DistortionModel | None:
    """The lens model of a name in `DISTORTION_NAMES`, whatever its spelling."""
    return _NAMES.get(_compared(name))


def make_lens(
    where: str, model: Any, coefficients: Any
) -> tuple[DistortionModel, tuple[float, ...]]:
    """The lens model and its coefficients, given a name in `DISTORTION_NAMES` or None."""
    name = "none" if model is None else lens_named(model)
    if name is None:
        raise unsupported(f"{where}: distortion model {str(model)[:40]!r}", DISTORTION_NAMES)
    numbers = make_list(f"{where}: distortion", coefficients)
    if model is None and numbers:
        raise CalibrationError(
            f"{where}: distortion has {len(numbers)} coefficients but distortion_model is missing"
        )
    if name == "none" and not any(numbers):
        return "none", ()
    most = COUNTS[name][-1]
    if not any(numbers[most:]):  # some programs append zeros
        numbers = numbers[:most]
    elif name == "radtan" and len(numbers) in _OPENCV_COUNTS:
        raise CalibrationError(
            f"{where}: distortion has {len(numbers)} coefficients; those of thin prisms and "
            "tilted sensors, from the ninth on, must be 0: calibrate with 5 or 8"
        )
    if len(numbers) not in COUNTS[name]:
        counts = " or ".join(str(count) for count in COUNTS[name])
        raise CalibrationError(
            f"{where}: distortion has {len(numbers)} coefficients; {model} has {counts}"
        )
    return name, numbers


def join_projection(
    where: str,
    projection: str,
    parameters: tuple[float, ...],
    lens: tuple[DistortionModel, tuple[float, ...]],
) -> tuple[DistortionModel, tuple[float, ...]]:
    """Combine a projection of `PROJECTIONS` and a distortion model into one lens model."""
    wide, names = PROJECTIONS[projection]
    if not names:
        return lens
    model, coefficients = lens
    if model != "none" and (wide, model) != ("omni", "radtan"):
        raise CalibrationError(
            f"{where}: camera model {projection} with distortion model {model} is not supported; "
            f"use {'radtan or none' if wide == 'omni' else 'none'} with {projection}"
        )
    return wide, (*parameters, *coefficients)


def check_lens(where: str, camera: Camera) -> None:
    """Check the parameters of a lens model."""
    ranges: dict[str, tuple[float, float]] = {}
    if camera.distortion_model == "double_sphere":
        ranges = {"xi": (-0.999, 1.0), "alpha": (0.0, 1.0)}
    elif camera.distortion_model == "extended_unified":
        ranges = {"alpha": (0.0, 1.0), "beta": (1e-3, 1e3)}
    elif camera.distortion_model == "omni":
        ranges = {"xi": (0.0, 1e3)}
    for (name, (low, high)), value in zip(ranges.items(), camera.distortion, strict=False):
        if not low <= value <= high:
            raise CalibrationError(
                f"{where}: {name} is {value:g}; for {camera.distortion_model} it must be from "
                f"{low:g} to {high:g}"
            )
