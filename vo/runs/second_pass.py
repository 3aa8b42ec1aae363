"""Why a run is made again from its first frame: by a sensor or lenses that were taken for right."""

from __future__ import annotations

from vo.base.records.inertial_use import InertialUse
from vo.engine.odometry import Odometry
from vo.recordings.sources.source import FrameStream, Recording
from vo.runs.run_options import RunOptions

# Lenses found to be wrong by more pixels at the image's edges have bent what was tracked before
# (KITTI 06: 0.085 m by 11 px; 0.026 by 7.6). Those of KITTI's drive of 2011 are, by 7 px at most.
_MIN_EDGE_PX = 8.0


class TrackAgain(Exception):
    """All frames have to be tracked again, and all files are to be replaced."""


class InertialContradiction(TrackAgain):
    """A sensor contradicts the images: the run has to be made again without it.

    Attributes:
        use: the sensor, with the reason.
    """

    def __init__(self, use: InertialUse) -> None:
        super().__init__(f"{use.sensor}: {use.reason}")
        self.use = use


class LensesFound(TrackAgain):
    """Both lenses of a pair are wrong: the run has to be made again with what is known now.

    Attributes:
        k1: error of their first radial coefficient.
    """

    def __init__(self, k1: float, edge_px: float) -> None:
        super().__init__(f"both lenses are wrong by {edge_px:+.1f} px at the image's edges")
        self.k1 = k1


def check_sensor(use: InertialUse | None, stream: FrameStream, options: RunOptions) -> None:
    """Raise InertialContradiction if there is one, and frames can be read a second time."""
    if use is not None and use.is_contradiction and _can_repeat(stream, options):
        raise InertialContradiction(use)


def check_lenses(odometry: Odometry, stream: FrameStream, options: RunOptions) -> None:
    """Raise LensesFound if those of a pair are so wrong that frames were tracked wrongly."""
    if not (stream.rig.is_stereo and _can_repeat(stream, options)):
        return
    error = odometry.calibration_errors.lens_error
    if error is not None and abs(error.edge_px) > _MIN_EDGE_PX:
        raise LensesFound(error.k1, error.edge_px)


def _can_repeat(stream: FrameStream, options: RunOptions) -> bool:
    return isinstance(stream, Recording) and not options.follow
