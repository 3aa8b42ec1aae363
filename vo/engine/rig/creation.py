"""The odometry for the cameras that there are: a single one or a pair, or a rig.

A lens that is wider than a pinhole camera can be is a rig, too: of views from one place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from vo.base.config import Config
from vo.base.errors import ConfigError
from vo.base.geometry.lens_field import WIDE_DEG, half_angles
from vo.base.geometry.rig_overlap import overlaps
from vo.base.records.metric_scale import ScaleSource
from vo.base.types import Rig
from vo.engine.odometry import Odometry
from vo.engine.stages import BUILT_IN, Components

if TYPE_CHECKING:  # only rigs need it
    from vo.engine.rig.odometry import RigOdometry

AnyOdometry: TypeAlias = "Odometry | RigOdometry"

_WHOLE_DEG = 80.0  # from the axis, from which on a lens is tracked whole by itself


def is_tracked_as_rig(rig: Rig, config: Config, *, has_sensor: bool = False) -> bool:
    """Whether there are more than two cameras, two that see nothing in common, or wide lenses.

    `has_sensor`: whether an inertial sensor would be used, which a rig leaves out.
    """
    if rig.further or any(c.distortion_model == "equirectangular" for c in rig.cameras):
        return True
    if rig.cam1 is not None and not overlaps(rig):
        return True
    field = config.camera.field_of_view
    if field == "cropped" or rig.has_depth:
        return False
    angles = [min(half_angles(lens)) for lens in rig.cameras]
    if field == "whole":
        return bool(max(angles) > np.deg2rad(WIDE_DEG))
    others = has_sensor or config.memory.map or any(c.readout_s for c in rig.cameras)
    return rig.cam1 is None and not others and bool(min(angles) > np.deg2rad(_WHOLE_DEG))


def make_odometry(
    rig: Rig,
    config: Config,
    components: Components = BUILT_IN,
) -> AnyOdometry:
    """The odometry for a rig.

    Raises:
        CalibrationError: the cameras cannot be rectified.
        ConfigError: a mask or a map cannot be used.
    """
    has_sensor = components.inertial_sensor is not None
    if not is_tracked_as_rig(rig, config, has_sensor=has_sensor):
        return Odometry(rig, config, components)
    if config.memory.map:
        check_has_map(rig, config, "memory.map")
    from vo.engine.rig.odometry import RigOdometry

    return RigOdometry(rig, config, components)


def check_has_map(rig: Rig, config: Config, option: str) -> None:
    """Refuse an option of maps for cameras that close no loops; raises `ConfigError`."""
    if is_tracked_as_rig(rig, config) and not overlaps(rig):
        raise ConfigError(
            f"`{option}` is for cameras of which two see the same; these {len(rig.cameras)} see "
            "nothing in common: use `mode=mono`, or `camera.field_of_view=cropped` for a wide lens"
        )


def scale_sources(odometry: AnyOdometry) -> tuple[ScaleSource, ...]:
    """What the odometry itself knows of a scale that its cameras do not give."""
    return () if isinstance(odometry, Odometry) else odometry.scale_sources
