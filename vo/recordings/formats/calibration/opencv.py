"""Reader of OpenCV's calibrations: FileStorage (YAML, XML or JSON), and what scripts write.

The values have any of the spellings in `keys`. A pair has M1 D1 M2 D2 (or the like), R and T with
x2 = R x1 + T (cam1_from_cam0). R and T may be in a separate file, `extrinsics` beside `intrinsics`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import NamedTuple

from vo.base.errors import CalibrationError
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration import keys
from vo.recordings.formats.calibration.checks import (
    make_rig,
    matrix_camera,
    rotation_and_translation,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
    shortened,
)
from vo.recordings.formats.calibration.keys import Entry, Values
from vo.recordings.formats.calibration.numbers import unsupported

_IDEAL = ("pinhole", "perspective", "none", "")
_RADTAN = (
    "radtan", "radialtangential", "plumbbob", "rationalpolynomial", "rational", "brown",
    "brownconrady", "opencv", "fullopencv", "standard", "normal",
)  # fmt: skip
_EQUIDISTANT = (
    "fisheye", "equidistant", "kannalabrandt", "kannalabrandt4", "kannalabrandt8",
    "kannalabrandtk3", "kb4", "kb8", "opencvfisheye",
)  # fmt: skip
_OMNI = ("omni", "omnidir", "mei")
_BROWN_CONRADY = ("modifiedbrownconrady", "inversebrownconrady")
"""Models of RealSense cameras, which are ideal if their coefficients are 0."""
_REALSENSE_NUMBERS = {
    "1": "modifiedbrownconrady", "2": "inversebrownconrady", "3": "ftheta", "4": "brownconrady",
    "5": "kannalabrandt4",
}  # fmt: skip
"""Its SDK's numbers of the models, in files with its name ppx of the principal point."""
_OTHERS = (
    "ds", "doublesphere", "eucm", "ucm", "unified", "fov", "atan", "scaramuzza", "ocam", "division",
    "equirectangular", "thinprism", "ftheta", *_BROWN_CONRADY,
)  # fmt: skip
_MODELS = (
    "radtan (plumb_bob, rational_polynomial)",
    "equidistant (fisheye, kannala_brandt) and omni",
)
_log = logging.getLogger(__name__)


def recognises(document: Document) -> bool:
    """Whether the file has a camera matrix with one of the usual keys, perhaps in a section."""
    sections = [document.data, *(v for v in document.data.values() if isinstance(v, Mapping))]
    return any(keys.find_sides(Values(section)) for section in sections)


def read(document: Document, image_size: ImageSize | None) -> Calibration:
    """Read one camera or a pair."""
    try:
        values = keys.camera_values(document.data)
    except CalibrationError as error:
        raise CalibrationError(f"{document.path}: {error}") from error
    sides = keys.find_sides(values)
    cam0 = _camera(document, values, sides[0], image_size)
    if len(sides) == 1:
        return Calibration(Rig(cam0))
    extrinsics = _extrinsics(document)
    if extrinsics is None:
        _log.warning(
            "%s: only the first camera is used, because R and T are missing; add them, or put "
            "extrinsics%s beside intrinsics%s",
            document.path,
            document.path.suffix,
            document.path.suffix,
        )
        return Calibration(Rig(cam0))
    cam1 = _camera(document, values, sides[1], image_size)
    where = extrinsics.where
    cam1_from_cam0 = rotation_and_translation(
        where, extrinsics.rotation.value, extrinsics.translation.value
    )
    where = f"{where}: {extrinsics.translation.key}"
    return Calibration(make_rig(where, cam0, cam1, cam1_from_cam0))


class _Extrinsics(NamedTuple):
    where: str
    rotation: Entry
    translation: Entry


def _extrinsics(document: Document) -> _Extrinsics | None:
    path = document.path
    beside = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    documents = [document]
    if beside != path and beside.is_file():
        documents.append(load_document(beside))
    for each in documents:
        values = Values(each.data)
        rotation = values.find(keys.ROTATION, keys.is_array)
        translation = values.find(keys.TRANSLATION, keys.is_array)
        if rotation is not None and translation is not None:
            return _Extrinsics(str(each.path), rotation, translation)
    return None


def _camera(document: Document, values: Values, side: str, image_size: ImageSize | None) -> Camera:
    matrix = keys.find_matrix(values, side)
    assert matrix is not None
    where = f"{document.path}: {matrix.key}"
    resolution = keys.size_of(where, values, image_size)
    model = _lens_model(str(document.path), values, side)
    distortion = keys.find_distortion(str(document.path), values, matrix, side, model=model)
    xi = values.find(keys.spelled(("xi",), side))
    if xi is not None:
        model = "omni"
        distortion = (*keys.coefficients_of(f"{document.path}: {xi.key}", _listed(xi)), *distortion)
    elif model == "omni":
        raise CalibrationError(f"{where}: xi is missing; the omni model needs it")
    return matrix_camera(
        where,
        resolution=resolution,
        matrix=matrix.value,
        distortion_model=model,
        distortion=distortion,
    )


def _listed(entry: Entry) -> object:
    """A number, or a matrix of one, as list."""
    return entry.value if keys.is_array(entry.value) else [entry.value]


def _lens_model(where: str, values: Values, side: str) -> str:
    """The distortion model that the file names; radtan if it names none."""
    flag = values.find(("fisheyemodel", "isfisheye", "fisheye"), lambda v: not keys.is_array(v))
    if flag is not None and str(flag.value).strip().lower() not in ("0", "false", "no", ""):
        return "equidistant"
    if values.find((keys.SECTION_MODEL,)) is not None:
        return "equidistant"
    for names, is_text in ((keys.LENS_MODEL, False), (keys.CAMERA_MODEL, True)):
        entry = values.find(keys.spelled(names, side)) or values.find(names)
        if entry is None:
            continue
        name = keys.normalised(entry.value).removeprefix("rs2").removeprefix("distortion")
        if values.find(keys.spelled(("ppx",), side)) is not None:
            name = _REALSENSE_NUMBERS.get(name, name)
        if name in _BROWN_CONRADY and _is_zero(values, side):
            return "radtan"
        if name in _EQUIDISTANT:
            return "equidistant"
        if name in _OMNI:
            return "omni"
        if name in _RADTAN:
            return "radtan"
        # The model of a camera may also be the name of a product.
        if name not in _IDEAL and (not is_text or name in _OTHERS):
            shown = shortened(entry.value)[:60]
            shown = f"{shown} ({name})" if shown.isdigit() else shown
            raise unsupported(f"{where}: {entry.key} {shown}", _MODELS)
    return "radtan"


def _is_zero(values: Values, side: str) -> bool:
    found = values.find(keys.spelled(keys.DISTORTION, side), keys.is_array)
    return found is not None and not any(keys.coefficients_of(found.key, found.value))
