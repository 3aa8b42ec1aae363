"""Checks of what a map file contains: any bytes may have the right checksums."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.types import Camera, Floats
from vo.engine.places.records import Place

MAX_NUMBER = 2**31 - 1  # of sessions, keyframes and worlds
MAX_LENGTH = 1e12  # of positions, in any unit
_MAX_SCALE = 1e9  # and the inverse of the smallest one
_MAX_SHEAR = 1e-3  # of the elements of a rotation
_MAX_SIDE = 100_000  # pixels
_MAX_OCTAVE = 63
_ROUNDING = 1e-6  # of the largest element of a covariance


def number(value: Any) -> int:
    """A whole number from 0 to `MAX_NUMBER`, else a ValueError."""
    if type(value) is not int or not 0 <= value <= MAX_NUMBER:
        raise ValueError(f"{value!r} is no number of a map")
    return value


def text(value: Any) -> str:
    """A text, else a ValueError."""
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return value


def listed(value: Any) -> list[Any]:
    """A list, else a ValueError."""
    if not isinstance(value, list):
        raise ValueError(f"{value!r} is no list")
    return value


def ideal_camera(fields: dict[str, Any]) -> Camera:
    """The rectified camera of the keyframes.

    Raises:
        ValueError: it is none.
        TypeError, KeyError: fields are missing, or are no fields of a camera.
    """
    camera = Camera(**{**fields, "distortion": tuple(fields["distortion"])})
    sides, others = (camera.width, camera.height), (camera.fx, camera.fy, camera.cx, camera.cy)
    is_whole = all(type(side) is int and 0 < side <= _MAX_SIDE for side in sides)
    is_real = all(type(value) in (int, float) and abs(value) <= MAX_LENGTH for value in others)
    if not (is_whole and is_real and min(camera.fx, camera.fy) > 0):
        raise ValueError("the camera of a map is none")
    if camera.distortion_model != "none" or camera.distortion:
        raise ValueError("the camera of a map is not rectified")
    return camera


def check_poses(poses: Floats, scale: Floats) -> None:
    """Check poses (n, 4, 4) and scales (n,).

    Raises:
        ValueError: a pose is no rigid motion, or a scale is not positive.
    """
    rotation = poses[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        product = rotation @ rotation.transpose(0, 2, 1)
        is_rigid = (np.abs(product - np.eye(3)) < _MAX_SHEAR).all() and (
            np.abs(np.linalg.det(rotation) - 1.0) < _MAX_SHEAR
        ).all()
    if not is_rigid or not (poses[:, 3] == (0.0, 0.0, 0.0, 1.0)).all():
        raise ValueError("a pose is no rigid motion")
    if not (np.abs(poses[:, :3, 3]) < MAX_LENGTH).all():
        raise ValueError("a pose is not finite, or too far away")
    if not ((scale > 1.0 / _MAX_SCALE) & (scale < _MAX_SCALE)).all():
        raise ValueError("a scale is not positive")


def check_covariances(covariances: Floats) -> None:
    """Check covariances (n, k, k); 0 is exact.

    Raises:
        ValueError: one is not finite, not symmetric, or has a negative variance.
    """
    if not np.isfinite(covariances).all():
        raise ValueError("a covariance is not finite")
    limit = _ROUNDING * np.abs(covariances).max(axis=(1, 2), initial=0.0)
    skew = np.abs(covariances - covariances.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    if (skew > limit).any() or (np.linalg.eigvalsh(covariances).min(axis=1) < -limit).any():
        raise ValueError("a covariance has a negative variance, or is not symmetric")


def check_place(place: Place) -> None:
    """Check a keyframe beyond the shapes of its arrays.

    Raises:
        ValueError: it cannot be one.
    """
    landmarks, descriptor = place.landmarks, place.descriptor
    check_poses(place.odom_from_cam[None], np.ones(1))
    check_covariances(place.covariance[None])
    if not (landmarks.sigma > 0).all():
        raise ValueError("a landmark has no uncertainty")
    if landmarks.descriptor.shape[1] != descriptor.shape[1]:
        raise ValueError("the landmarks of a keyframe have other descriptors than its features")
    if landmarks.descriptor.dtype != descriptor.dtype:
        raise ValueError("the landmarks of a keyframe have other descriptors than its features")
    if place.thumbnail.size == 0:
        raise ValueError("a keyframe has no image")
    if place.frame.segment > MAX_NUMBER or (landmarks.id > MAX_NUMBER - 1).any():
        raise ValueError("a number of a segment or landmark is impossible")
    if (landmarks.id < 0).any() or not np.isin(landmarks.octave, range(_MAX_OCTAVE + 1)).all():
        raise ValueError("a number of a landmark or octave is impossible")
    limit = float(MAX_LENGTH)
    if not ((np.abs(landmarks.xyz) < limit).all() and (np.abs(landmarks.xy) < limit).all()):
        raise ValueError("a landmark is not finite, or too far away")
