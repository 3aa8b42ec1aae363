"""The time from the first to the last row of an image."""

from __future__ import annotations

import numpy as np

from vo.base.config import Config
from vo.base.errors import CalibrationError, ConfigError
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.source import FrameStream, Recording
from vo.runs.run_options import RunOptions


def checked_readout(stream: FrameStream, config: Config, options: RunOptions) -> Config:
    """The settings with the readout time found by the images, if it is `auto`.

    Raises:
        CalibrationError: a readout time is longer than the time between frames.
        ConfigError: `auto` for what is no recording.
    """
    given, calibrated_s = config.camera.readout_s, stream.rig.cam0.readout_s
    if given == "auto":
        if not isinstance(stream, ImageSequence):
            raise ConfigError("`camera.readout_s=auto` needs a recording")
        from vo.runs.readout_estimation import readout_by_images  # seldom needed

        without = _with_readout(config, 0.0)
        return _with_readout(config, readout_by_images(stream, without, options))
    readout_s = calibrated_s if given is None else given
    if readout_s == 0.0 or not isinstance(stream, Recording) or len(stream) < 2:
        return config
    interval_s = 1e-9 * float(np.median(np.diff(stream.stamps_ns)))
    if readout_s > interval_s > 0.0:
        name = "readout_s of the calibration" if given is None else "camera.readout_s"
        raise CalibrationError(
            f"{name} is {readout_s:g} s, but frames are {interval_s:.3g} s apart; give the time "
            "from the first to the last row of an image, or 0 for a global shutter"
        )
    return config


def _with_readout(config: Config, seconds: float) -> Config:
    camera = config.camera.model_copy(update={"readout_s": seconds})
    return config.model_copy(update={"camera": camera})
