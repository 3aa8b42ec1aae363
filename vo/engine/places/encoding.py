"""Stored keyframes as bytes: a header in JSON, then the arrays, little-endian.

The same bytes are used in memory, in the spill file and in map files (docs/map-format.md).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from vo.base.files.bounded_json import load_json
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.records import PATCH_PX, Place, PlaceKey, PlaceLandmarks

_LENGTH = struct.Struct("<I")
_ALIGNMENT = 8
_LANDMARK_ARRAYS = {  # dtype, and shape after the number of landmarks; None: that of the array
    "id": ("<i8", ()),
    "xyz": ("<f4", (3,)),
    "xy": ("<f4", (2,)),
    "sigma": ("<f4", ()),
    "descriptor": (None, None),
    "octave": ("<i4", ()),
    "angle": ("<f4", ()),
    "patch": ("|u1", (PATCH_PX, PATCH_PX)),
}
_PLACE_ARRAYS = {
    "odom_from_cam": ("<f8", (4, 4)),
    "covariance": ("<f8", (6, 6)),
    "descriptor": (None, None),
    "thumbnail": ("|u1", None),
}
_DESCRIPTOR_TYPES = ("|u1", "<f4", "<f2", "|i1")


def encode_place(place: Place) -> bytes:
    """A stored keyframe as bytes."""
    arrays = {name: getattr(place, name) for name in _PLACE_ARRAYS}
    arrays |= {f"landmarks.{n}": getattr(place.landmarks, n) for n in _LANDMARK_ARRAYS}
    parts, listed, offset = list[Any](), list[Any](), 0
    for name, array in arrays.items():
        dtype = _dtype_of(name) or array.dtype.newbyteorder("<").str
        data = np.ascontiguousarray(array, dtype)
        listed.append([name, dtype, list(array.shape), offset])
        padding = -data.nbytes % _ALIGNMENT
        parts += [data, bytes(padding)]
        offset += data.nbytes + padding
    frame = place.frame
    header = json.dumps(
        {
            "session": place.key.session,
            "keyframe": place.key.keyframe,
            "frame": [frame.index, frame.stamp_ns, frame.segment],
            "is_metric": place.is_metric,
            **({"is_doubted": True} if place.is_doubted else {}),
            "arrays": listed,
        },
        separators=(",", ":"),
    ).encode()
    header += b" " * (-(len(header) + _LENGTH.size) % _ALIGNMENT)
    return b"".join([_LENGTH.pack(len(header)), header, *parts])


def decode_place(data: bytes) -> Place:
    """The stored keyframe that `encode_place` has written; its arrays cannot be written to.

    Raises:
        ValueError: the bytes are something else.
    """
    if len(data) < _LENGTH.size:
        raise ValueError("a keyframe is cut off")
    (length,) = _LENGTH.unpack_from(data)
    begin = _LENGTH.size + length
    if begin > len(data):
        raise ValueError("a keyframe is cut off")
    header = load_json(data[_LENGTH.size : begin])
    try:
        arrays = {row[0]: _array(data, begin, *row) for row in header["arrays"]}
        landmarks = PlaceLandmarks(**{n: arrays[f"landmarks.{n}"] for n in _LANDMARK_ARRAYS})
        place = Place(
            key=PlaceKey(_whole(header["session"]), _whole(header["keyframe"])),
            frame=FrameId(*map(_whole, header["frame"])),
            is_metric=bool(header["is_metric"]),
            landmarks=landmarks,
            is_doubted=bool(header.get("is_doubted", False)),
            **{n: arrays[n] for n in _PLACE_ARRAYS},
        )
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"the header of a keyframe is not understood ({error})") from error
    _check(place)
    return place


def _dtype_of(name: str) -> str | None:
    inner = name.removeprefix("landmarks.")
    return (_PLACE_ARRAYS if inner == name else _LANDMARK_ARRAYS)[inner][0]


def _array(data: bytes, begin: int, name: str, dtype: str, shape: Any, offset: Any) -> Any:
    expected = _dtype_of(name)
    if dtype != expected and not (expected is None and dtype in _DESCRIPTOR_TYPES):
        raise ValueError(f"the array {name} of a keyframe has the type {dtype}")
    sizes = [_whole(s) for s in shape]
    count, start = 1, begin + _whole(offset)
    for size in sizes:
        count *= size
    if start + count * np.dtype(dtype).itemsize > len(data):
        raise ValueError(f"the array {name} of a keyframe is cut off")
    return np.frombuffer(data, dtype, count, start).reshape(sizes)


def _whole(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"a number of a keyframe is {value!r}, expected a whole one")
    return value


def _check(place: Place) -> None:
    """Check shapes, and that poses and landmarks are finite."""
    landmarks = place.landmarks
    count = len(landmarks.id)
    for name, (_, shape) in _LANDMARK_ARRAYS.items():
        array = getattr(landmarks, name)
        if len(array) != count or (shape is not None and array.shape[1:] != shape):
            raise ValueError(f"the array {name} of a keyframe has the shape {array.shape}")
    for name in ("odom_from_cam", "covariance"):
        array = getattr(place, name)
        if array.shape != _PLACE_ARRAYS[name][1]:
            raise ValueError(f"the array {name} of a keyframe has the shape {array.shape}")
    if place.thumbnail.ndim != 2 or place.descriptor.ndim != 2 or landmarks.descriptor.ndim != 2:
        raise ValueError("an image or the descriptors of a keyframe have no two dimensions")
    if not (np.isfinite(place.odom_from_cam).all() and np.isfinite(landmarks.xyz).all()):
        raise ValueError("a pose or a landmark of a keyframe is not finite")
    if count and not (np.diff(landmarks.id) > 0).all():
        raise ValueError("the landmarks of a keyframe are not in order")
