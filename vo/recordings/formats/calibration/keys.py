"""Spellings of the same value in calibration files, such as `dist_coeffs`, `distCoeff` and `D`.

Names are compared in lower case, without underscores and other punctuation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from vo.base.errors import CalibrationError
from vo.recordings.formats.calibration.document import ImageSize
from vo.recordings.formats.calibration.numbers import is_list, make_list, make_matrix, make_number

MATRIX = (
    "cameramatrix", "mtx", "k", "m", "cammatrix", "cammtx", "cameramtx", "kmatrix", "matrixk",
    "intrinsicmatrix", "intrinsicsmatrix", "cameraintrinsicmatrix", "intrinsic", "intrinsics",
    "cameraintrinsic", "cameraintrinsics",
)  # fmt: skip
DISTORTION = (
    "distortioncoefficients", "distortioncoefficient", "distcoeffs", "distcoeff", "distcoefs",
    "distcoef", "distcoefficients", "distortioncoeffs", "distortioncoeff", "distortioncoefs",
    "distortioncoef", "distortionvector", "distortionparameters", "distortionparams",
    "distortionmatrix", "distortion", "distortions", "distmatrix", "distvec", "distparams", "dist",
    "lensdistortion", "cameradistortion", "cameradistcoeffs", "coeffs", "d",
)  # fmt: skip
ROTATION = ("r", "rotation", "rotationmatrix", "rot", "rmat", "stereor", "rstereo")
TRANSLATION = ("t", "translation", "translationvector", "trans", "tvec", "stereot", "tstereo")
PROJECTION = ("p", "projection", "projectionmatrix")
LENS_MODEL = ("distortionmodel", "distortiontype", "lensmodel", "lenstype")
CAMERA_MODEL = ("cameramodel", "cameratype", "modeltype", "model", "projectionmodel")
_RECTIFIED = ("rectified", "isrectified", "undistorted", "isundistorted")
_SIZES = (
    ("imagewidth", "imageheight"), ("width", "height"), ("imgwidth", "imgheight"),
    ("camerawidth", "cameraheight"), ("resolutionwidth", "resolutionheight"),
    ("resolutionx", "resolutiony"), ("framewidth", "frameheight"), ("cols", "rows"),
    ("imagecols", "imagerows"), ("w", "h"),
)  # fmt: skip
_SIZE_LISTS = (
    "imagesize", "resolution", "imgsize", "imageresolution", "framesize", "imagedimensions", "size",
    "calibdimension", "calibrationdimension", "dimension", "dimensions",
)  # fmt: skip
_RADTAN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_EQUIDISTANT = ("k1", "k2", "k3", "k4")
_INTRINSICS = (("fx", "focalx"), ("fy", "focaly"), ("cx", "ppx"), ("cy", "ppy"))
_SIDES = (
    ("0", "1"), ("1", "2"), ("left", "right"), ("l", "r"), ("cam0", "cam1"), ("cam1", "cam2"),
    ("camera0", "camera1"), ("camera1", "camera2"),
)  # fmt: skip
_SECTIONS = {
    "left": "left", "leftcamera": "left", "cameraleft": "left", "camleft": "left",
    "right": "right", "rightcamera": "right", "cameraright": "right", "camright": "right",
    "cam0": "cam0", "cam1": "cam1", "cam2": "cam2", "camera0": "camera0", "camera1": "camera1",
    "camera2": "camera2", "stereo": "", "extrinsics": "", "extrinsic": "",
}  # fmt: skip
"""Sections, and the mark of the camera that their values have; none for those of the pair."""
_FISHEYE_SECTIONS = ("fisheye", "equidistant", "kannalabrandt")
SECTION_MODEL = "distortionmodelofsection"
"""Key of the model that the name of a section says, such as `fisheye_params`."""
_MAX_LISTED = 12


class Entry(NamedTuple):
    """A value of a file, and its key as the file spells it."""

    key: str
    value: Any


class Values:
    """The values of a section of a calibration file, to be found by any spelling of their names.

    Keys of a section such as `left` are read as if they began with that word.
    """

    def __init__(self, data: Mapping[str, Any]) -> None:
        self.keys: list[str] = []
        self._entries: dict[str, list[Entry]] = {}
        for key, value in data.items():
            side = _SECTIONS.get(normalised(key))
            if side is None or not isinstance(value, Mapping) or "data" in value:
                self._add(normalised(key), Entry(str(key), value))
                continue
            for inner, inner_value in value.items():
                self._add(side + normalised(inner), Entry(f"{key}.{inner}", inner_value))

    def find(
        self, names: Iterable[str], accepts: Callable[[Any], bool] = lambda _: True
    ) -> Entry | None:
        """The first entry with one of these normalised names, and a value that is accepted."""
        for name in names:
            for entry in self._entries.get(name, ()):
                if accepts(entry.value):
                    return entry
        return None

    def find_all(self, names: Iterable[str], accepts: Callable[[Any], bool]) -> list[Entry]:
        """All such entries."""
        return [e for name in names for e in self._entries.get(name, ()) if accepts(e.value)]

    def _add(self, name: str, entry: Entry) -> None:
        self.keys.append(entry.key)
        self._entries.setdefault(name, []).append(entry)


def normalised(key: Any) -> str:
    """A key in lower case, only its letters and digits."""
    return "".join(character for character in str(key).lower() if character.isalnum())


def spelled(names: Iterable[str], side: str = "") -> list[str]:
    """Names of a camera's values: `dist` of side `left` is `distleft` or `leftdist`."""
    if not side:
        return list(names)
    first = [name + side for name in names]
    return first if side.isdigit() else [*first, *(side + name for name in names)]


def find_sides(values: Values) -> tuple[str, ...]:
    """Marks of the cameras in the names of their matrices: two, one, or none without a matrix."""
    for sides in _SIDES:
        if all(find_matrix(values, side) is not None for side in sides):
            return sides
    for side in ("", *(left for left, _ in _SIDES)):
        if find_matrix(values, side) is not None:
            return (side,)
    return ()


def find_matrix(values: Values, side: str) -> Entry | None:
    """The camera matrix of a side, or that of its fx, fy, cx and cy."""
    found = values.find(spelled(MATRIX, side), is_matrix)
    if found is not None:
        return found
    section = values.find(spelled(MATRIX, side), lambda value: isinstance(value, Mapping))
    if section is not None:
        return _of_numbers(Values(section.value), "", section.key)
    return _of_numbers(values, side, "fx")


def _of_numbers(values: Values, side: str, key: str) -> Entry | None:
    """The camera matrix of fx, fy, cx and cy, None if one is missing."""
    found = []
    for names in _INTRINSICS:
        entry = values.find([each for name in names for each in spelled([name], side)], _is_scalar)
        if entry is None:
            return None
        found.append(entry.value)
    fx, fy, cx, cy = found
    return Entry(key, [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def camera_values(data: Mapping[str, Any]) -> Values:
    """The values of a file with a camera matrix, at the top or in the only section that has one.

    Values beside that section, such as the size of the images, belong to it.
    """
    values = Values(data)
    if find_sides(values):
        return values
    inside = {
        str(key): section
        for key, section in data.items()
        if isinstance(section, Mapping) and find_sides(Values(section))
    }
    if len(inside) > 1:
        raise CalibrationError(
            f"sections {', '.join(inside)[:200]} each have a camera; name them left and right, or "
            "give a file with one camera"
        )
    for name, section in inside.items():
        others = {key: v for key, v in data.items() if key not in inside}
        is_fisheye = any(word in normalised(name) for word in _FISHEYE_SECTIONS)
        said = {SECTION_MODEL: "equidistant"} if is_fisheye else {}
        return Values(others | said | dict(section))
    return values


def is_array(value: Any) -> bool:
    """Whether a value is a list, or a section with data, rather than a number or a text."""
    return "data" in value if isinstance(value, Mapping) else is_list(value)


def is_matrix(value: Any) -> bool:
    """Whether a value has the nine numbers of a camera matrix."""
    data = value.get("data") if isinstance(value, Mapping) else value
    if not is_list(data):
        return isinstance(value, Mapping) and "data" in value  # damaged; the reader says how
    return len(data) in (3, 9) and not (len(data) == 3 and not is_array(data[0]))


def find_distortion(
    where: str, values: Values, matrix: Entry, side: str = "", *, model: str = "radtan"
) -> tuple[float, ...]:
    """The distortion coefficients of a camera; none if the file says that there are none."""
    found = values.find_all(spelled(DISTORTION, side), _is_coefficients)
    lists = [coefficients_of(f"{where}: {e.key}", e.value, model) for e in found]
    if len(lists) > 1 and any(one != lists[0] for one in lists):
        names = " and ".join(entry.key for entry in found[:2])
        raise CalibrationError(f"{where}: {names} differ; keep the distortion of these images")
    if lists:
        return lists[0]
    scalars = {name: values.find([name + side], _is_scalar) for name in _RADTAN}
    if any(scalars.values()):
        named = {name: entry.value for name, entry in scalars.items() if entry is not None}
        return coefficients_of(where, named, model)
    if _is_rectified(values, matrix, side):
        return ()
    listed = ", ".join(values.keys[:_MAX_LISTED]) + (", …" * (len(values.keys) > _MAX_LISTED))
    raise CalibrationError(
        f"{where}: {matrix.key} has no distortion beside it; the keys are {listed[:300]}; add "
        f"distortion_coefficients{side and '_' + side}: [k1, k2, p1, p2, k3], or [] if the images "
        "have no distortion"
    )


def coefficients_of(where: str, value: Any, model: str = "radtan") -> tuple[float, ...]:
    """Distortion coefficients of a list, a section with data, or one with k1, k2 and so on."""
    if not isinstance(value, Mapping) or "data" in value:
        return make_list(where, value)
    named = {normalised(key): item for key, item in value.items()}
    if model == "equidistant":
        missing = [name for name in _EQUIDISTANT if name not in named]
        if missing:
            raise CalibrationError(f"{where}: {missing[0]} is missing; equidistant has k1 to k4")
        return tuple(make_number(f"{where}: {name}", named[name]) for name in _EQUIDISTANT)
    if "k4" in named and "p1" not in named:
        raise CalibrationError(
            f"{where}: k1 to k4 without p1 and p2 are those of a fisheye lens; add "
            "distortion_model: equidistant"
        )
    numbers = [make_number(f"{where}: {n}", named[n]) if n in named else 0.0 for n in _RADTAN]
    count = 8 if any(numbers[5:]) else 5 if numbers[4] else 4
    return tuple(numbers[:count])


def size_of(where: str, values: Values, image_size: ImageSize | None) -> Any:
    """Width and height in the file, unchecked, or else those of the images."""
    found = values.find(_SIZE_LISTS, lambda v: is_array(v) or isinstance(v, Mapping))
    section = None if found is None or is_array(found.value) else Values(found.value)
    for names in _SIZES:
        for each in filter(None, (values, section)):
            sides = [each.find([name], _is_scalar) for name in names]
            if sides[0] is not None and sides[1] is not None:
                return [sides[0].value, sides[1].value]
    if found is not None:
        return found.value.get("data") if isinstance(found.value, Mapping) else found.value
    if image_size is None:
        raise CalibrationError(
            f"{where}: the size of the images is missing; add image_width and image_height"
        )
    return image_size


def _is_coefficients(value: Any) -> bool:
    return is_array(value) or (isinstance(value, Mapping) and "k1" in map(normalised, value))


def _is_scalar(value: Any) -> bool:
    return isinstance(value, int | float | str)


def _is_rectified(values: Values, matrix: Entry, side: str) -> bool:
    """Whether the file says so, or the projection of the rectified camera is that of this one."""
    stated = values.find(spelled(_RECTIFIED, side)) or values.find(_RECTIFIED)
    if stated is not None and str(stated.value).strip().lower() in ("1", "true", "yes"):
        return True
    projection = values.find(spelled(PROJECTION, side), is_array)
    if projection is None or not is_array(matrix.value):
        return False
    k = make_matrix(matrix.key, matrix.value, 3, 3)
    p = make_matrix(projection.key, projection.value, 3, 4)
    return bool(np.allclose(k, p[:, :3], rtol=1e-6, atol=1e-6))
