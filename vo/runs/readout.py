"""The time from the first to the last row of an image."""

from __future__ import annotations

import numpy as np

from vo.base.config import Config
from vo.base.errors import CalibrationError
from vo.recordings.sources.source import FrameStream, Recording


def check_readout(stream: FrameStream, config: Config) -> None:
    """Refuse a readout time that is longer than the time between frames: CalibrationError."""
    given, calibrated_s = config.camera.readout_s, stream.rig.cam0.readout_s
    readout_s = calibrated_s if given is None else given
    if readout_s == 0.0 or not isinstance(stream, Recording) or len(stream) < 2:
        return
    interval_s = 1e-9 * float(np.median(np.diff(stream.stamps_ns)))
    if readout_s > interval_s > 0.0:
        name = "readout_s of the calibration" if given is None else "camera.readout_s"
        raise CalibrationError(
            f"{name} is {readout_s:g} s, but frames are {interval_s:.3g} s apart; give the time "
            "from the first to the last row of an image, or 0 for a global shutter"
        )
