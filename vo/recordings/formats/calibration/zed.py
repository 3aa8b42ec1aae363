"""Reader of the factory calibration of ZED cameras, `SN12345.conf`.

Each camera has a section for each resolution, such as [LEFT_CAM_HD]. Its distortion is there, or
for all resolutions in [LEFT_DISTO], which has more coefficients. [STEREO] has the pose of the right
camera: a translation in millimetres, and a rotation vector (RX, CV, RZ) for each resolution, in
radians. With OpenCV's T, x2 = R x1 + T, it is Baseline = -T[0], TY = T[1], TZ = T[2], as
Stereolabs' calibration program writes it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import make_camera, make_rig
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize
from vo.recordings.formats.calibration.keys import coefficients_of
from vo.recordings.formats.calibration.numbers import make_number

_SIZES = {
    "2K": (2208, 1242),
    "FHD": (1920, 1080),
    "HD": (1280, 720),
    "VGA": (672, 376),
    "FHD1200": (1920, 1200),
    "SVGA": (960, 600),
    "QHDPLUS": (3800, 1800),
    "4K": (3840, 2160),
}
_SECTION = re.compile(r"^[ \t]*\[LEFT_CAM_(\w+)\]", re.MULTILINE | re.IGNORECASE)
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_M_PER_MM = 1e-3


def recognises(document: Document) -> bool:
    """Whether there is a line such as `[LEFT_CAM_HD]`."""
    return _SECTION.search(document.text) is not None


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read both cameras, for the resolution of the images."""
    name = _resolution(document, image_size)
    sections = _sections(document)
    cam0 = _camera(document, sections, f"LEFT_CAM_{name}")
    if f"RIGHT_CAM_{name}" not in sections or "STEREO" not in sections:
        return Calibration(Rig(cam0))
    cam1 = _camera(document, sections, f"RIGHT_CAM_{name}")
    cam1_from_cam0 = _cam1_from_cam0(document, sections["STEREO"], name)
    where = f"{document.path}: [STEREO] Baseline"
    return Calibration(make_rig(where, cam0, cam1, cam1_from_cam0))


def _resolution(document: Document, image_size: ImageSize | None) -> str:
    """The name of the resolution of the images."""
    names: list[str] = [name.upper() for name in _SECTION.findall(document.text)]
    sizes = {name: _SIZES[name] for name in names if name in _SIZES}
    for name, size in sizes.items():
        if size == image_size:
            return name
    known = ", ".join(f"{w}x{h} ({name})" for name, (w, h) in sizes.items())
    if image_size is None:
        raise CalibrationError(f"{document.path}: the size of the images is needed; it has {known}")
    raise CalibrationError(
        f"{document.path} has no section for images of {image_size[0]}x{image_size[1]}; it has "
        f"{known or ', '.join(names)}; each image must be that of one camera, not both side by side"
    )


def _sections(document: Document) -> dict[str, Mapping[str, str]]:
    import configparser  # takes 1 ms

    parser = configparser.ConfigParser(
        interpolation=None, strict=False, inline_comment_prefixes=(";", "#")
    )
    try:
        parser.read_string(document.text)
    except configparser.Error as error:
        reason = " ".join(str(error).split())
        raise CalibrationError(f"{document.path} is not INI: {reason[:200]}") from error
    return {name.upper(): parser[name] for name in parser.sections()}


def _camera(document: Document, sections: Mapping[str, Mapping[str, str]], name: str) -> Camera:
    where, section = f"{document.path}: [{name}]", sections[name]
    disto = f"{name.partition('_')[0]}_DISTO"
    lens = sections.get(disto, section)
    if "k1" not in lens:
        lens = section
    if "k1" not in lens:
        raise CalibrationError(f"{where}: k1 is missing, and there is no [{disto}]")
    model, coefficients = _lens(where, lens)
    focal = [section.get(key) for key in ("fx", "fy", "cx", "cy")]
    return make_camera(where, _SIZES[name.partition("_CAM_")[2]], focal, model, coefficients)


def _lens(where: str, section: Mapping[str, str]) -> tuple[str, tuple[float, ...]]:
    """The distortion model and its coefficients; fisheye lenses have k1 to k4 and nothing else."""
    given = {key: make_number(f"{where}: {key}", section.get(key, "0")) for key in _COEFFICIENTS}
    is_fisheye = bool(given["k4"]) and not any(given[key] for key in ("p1", "p2", "k5", "k6"))
    model = "equidistant" if is_fisheye else "radtan"
    return model, coefficients_of(where, given, model)


def _cam1_from_cam0(document: Document, stereo: Mapping[str, str], name: str) -> Floats:
    def number(key: str, default: str | None = None) -> float:
        """The value for this resolution, or else that for all of them."""
        value = stereo.get(f"{key}_{name}", stereo.get(key, default))
        if value is None:
            raise CalibrationError(f"{document.path}: [STEREO] {key}_{name} is missing")
        return make_number(f"{document.path}: [STEREO] {key}_{name}", value)

    rotation = so3_exp(np.array([number("RX"), number("CV"), number("RZ")]))
    t_mm = np.array([-number("Baseline"), number("TY", "0"), number("TZ", "0")])
    return make_transform(rotation, _M_PER_MM * t_mm)
