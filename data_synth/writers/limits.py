"""Checks, before rendering, of what a layout can represent."""

from __future__ import annotations

import numpy as np

from vo.base.errors import ConfigError
from vo.base.extras import require
from vo.base.geometry.rectification import rectified_projections
from vo.base.types import Rig

_SAME = 1e-9


def check_kitti(rig: Rig, has_drops: bool) -> None:
    """Check that one or two cameras are ideal and side by side, and that no frame is missing.

    Raises:
        ConfigError: one of these is not so.
    """
    if rig.further:
        raise _not_kitti(f"there are {len(rig.cameras)}")
    for name, camera in (("cam0", rig.cam0), ("cam1", rig.cam1)):
        if camera is not None and camera.is_distorted:
            raise _not_kitti(f"{name} is distorted ({camera.distortion_model})")
    if rig.cam1 is not None and rig.cam1 != rig.cam0:
        raise _not_kitti("cam1 is not equal to cam0")
    if rig.cam1_from_cam0 is not None and not _is_beside(rig):
        x, y, z = rig.cam1_from_cam0[:3, 3]
        raise _not_kitti(
            "cam1 is rotated or not exactly to the right of cam0 "
            f"(cam1_from_cam0 shifts by {x:.4g}, {y:.4g}, {z:.4g} m)"
        )
    if has_drops:
        raise ConfigError(
            "format kitti cannot represent missing frames; set effects.drops to 0, or choose "
            "format euroc"
        )


def check_tum(rig: Rig, has_drops: bool) -> None:
    """Check that there is one camera.

    Raises:
        ConfigError: there are more.
    """
    if rig.is_stereo:
        raise ConfigError(
            f"format tum has one camera with depth, but there are {len(rig.cameras)}; use one "
            "camera (`mono`), or choose format euroc"
        )


def check_mcap(rig: Rig, has_drops: bool) -> None:
    """Check that a pair can be rectified, which its messages require.

    Raises:
        CalibrationError: it cannot.
    """
    rectified_projections(rig)


def check_ros2(rig: Rig, has_drops: bool) -> None:
    """As `check_mcap`, and that messages of ROS can be written.

    Raises:
        CalibrationError: the pair cannot be rectified.
        MissingExtraError: rosbags is not installed.
    """
    require("rosbags", extra="ros", what="ROS messages")
    check_mcap(rig, has_drops)


def check_nothing(rig: Rig, has_drops: bool) -> None:
    """No check: the layout can represent every recording."""


def _is_beside(rig: Rig) -> bool:
    assert rig.cam1_from_cam0 is not None
    rotation, shift = rig.cam1_from_cam0[:3, :3], rig.cam1_from_cam0[:3, 3]
    straight = np.abs(rotation - np.eye(3)).max() < _SAME and np.abs(shift[1:]).max() < _SAME
    return bool(straight and shift[0] < 0.0)


def _not_kitti(reason: str) -> ConfigError:
    return ConfigError(
        f"format kitti requires rectified cameras without distortion, but {reason}; choose "
        "another camera (pinhole, kitti), or format euroc"
    )
