"""The odometry for the cameras that there are: a single one or a pair, or a rig."""

from __future__ import annotations

from subprocess import Popen
from typing import TYPE_CHECKING, TypeAlias

from vo.base.config import Config
from vo.base.errors import ConfigError
from vo.base.geometry.rig_overlap import overlaps
from vo.base.records.metric_scale import ScaleSource
from vo.base.types import Rig
from vo.engine.odometry import Odometry
from vo.engine.stages import BUILT_IN, Components

if TYPE_CHECKING:  # only rigs need it
    from vo.engine.rig.odometry import RigOdometry

AnyOdometry: TypeAlias = "Odometry | RigOdometry"


def is_tracked_as_rig(rig: Rig) -> bool:
    """Whether there are more than two cameras, or two that see nothing in common."""
    return bool(rig.further) or (rig.cam1 is not None and not overlaps(rig))


def make_odometry(
    rig: Rig,
    config: Config,
    components: Components = BUILT_IN,
    optimizer_process: Popen[bytes] | None = None,
) -> AnyOdometry:
    """The odometry for a rig.

    Raises:
        CalibrationError: the cameras cannot be rectified.
        ConfigError: a mask or a map cannot be used.
    """
    if not is_tracked_as_rig(rig):
        return Odometry(rig, config, components, optimizer_process)
    if config.memory.map:
        check_has_map(rig, "memory.map")
    from vo.engine.rig.odometry import RigOdometry

    return RigOdometry(rig, config, components, optimizer_process)


def check_has_map(rig: Rig, option: str) -> None:
    """Refuse an option of maps for cameras that close no loops; raises `ConfigError`."""
    if is_tracked_as_rig(rig) and not overlaps(rig):
        raise ConfigError(
            f"`{option}` is for cameras of which two see the same; these {len(rig.cameras)} see "
            "nothing in common: use `mode=mono`"
        )


def scale_sources(odometry: AnyOdometry) -> tuple[ScaleSource, ...]:
    """What the odometry itself knows of a scale that its cameras do not give."""
    return () if isinstance(odometry, Odometry) else odometry.scale_sources
