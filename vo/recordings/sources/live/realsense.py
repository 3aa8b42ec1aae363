"""RealSense cameras of the D400 family: the stereo pair of their infrared cameras.

The device rectifies these images, and its factory calibration comes with them. The dot projector
is switched off: its dots stand still in the image while the camera moves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.errors import CalibrationError, SourceError
from vo.base.extras import require
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import make_camera, make_rig
from vo.recordings.sources.live.clock import CaptureStamps, HostClock
from vo.recordings.sources.live.device import CapturedImages, as_grey, warn_of_untested

_WIDTH, _HEIGHT, _RATE_HZ = 848, 480, 30
_TIMEOUT_MS = 5000
_LENSES = {"brown_conrady": "radtan", "kannala_brandt4": "equidistant"}
_NS_PER_MS = 1e6


class RealSense:
    """A `Device` for a camera through `pyrealsense2`."""

    def __init__(self, serial: str | None, clock: HostClock) -> None:
        self._rs: Any = require("pyrealsense2", "realsense", "RealSense cameras")
        self._name = "realsense" if serial is None else f"realsense:{serial}"
        self._clock, self._stamps = clock, CaptureStamps()
        self._pipeline = self._rs.pipeline()
        try:
            profile = self._pipeline.start(self._config(serial))
        except RuntimeError as error:
            raise SourceError(f"{self._name} cannot be opened: {error}") from error
        try:
            self.rig: Rig | None = self._factory_rig(profile)
            self._switch_projector_off(profile)
        except BaseException:
            self.close()
            raise
        warn_of_untested(self._name, "pyrealsense2")

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        try:
            frames = self._pipeline.wait_for_frames(_TIMEOUT_MS)
            arrival_ns = self._clock.now_ns()
            left, right = frames.get_infrared_frame(1), frames.get_infrared_frame(2)
            # Copies: the memory of frames is used again.
            images = tuple(as_grey(np.array(each.get_data())) for each in (left, right))
            own_ns = round(_NS_PER_MS * left.get_timestamp())
        except RuntimeError as error:
            raise SourceError(f"{self._name}: {error}") from error
        return CapturedImages(self._stamps.stamp(arrival_ns, own_ns), images)

    def close(self) -> None:
        """See `Device.close`."""
        try:
            self._pipeline.stop()
        except RuntimeError:  # it was unplugged
            return

    def _config(self, serial: str | None) -> Any:
        rs = self._rs
        config = rs.config()
        if serial is not None:
            config.enable_device(serial)
        for number in (1, 2):
            config.enable_stream(
                rs.stream.infrared, number, _WIDTH, _HEIGHT, rs.format.y8, _RATE_HZ
            )
        return config

    def _factory_rig(self, profile: Any) -> Rig:
        streams = [profile.get_stream(self._rs.stream.infrared, number) for number in (1, 2)]
        left, right = (self._camera(each.as_video_stream_profile()) for each in streams)
        extrinsics = streams[0].get_extrinsics_to(streams[1])
        rotation = np.reshape(extrinsics.rotation, (3, 3)).T  # column by column
        cam1_from_cam0 = make_transform(rotation, np.array(extrinsics.translation))
        return make_rig(self._name, left, right, cam1_from_cam0)

    def _camera(self, profile: Any) -> Camera:
        intrinsics = profile.get_intrinsics()
        model, coefficients = intrinsics.model.name, [float(x) for x in intrinsics.coeffs]
        if any(coefficients) and model not in _LENSES:
            raise CalibrationError(
                f"{self._name}: distortion {model} is not supported; give `calibration=FILE`"
            )
        is_fisheye = model == "kannala_brandt4"
        return make_camera(
            f"{self._name}: factory calibration",
            [intrinsics.width, intrinsics.height],
            [intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy],
            _LENSES.get(model, "radtan"),
            coefficients[:4] if is_fisheye else coefficients,
        )

    def _switch_projector_off(self, profile: Any) -> None:
        sensor = profile.get_device().first_depth_sensor()
        option = self._rs.option.emitter_enabled
        if sensor.supports(option):
            sensor.set_option(option, 0.0)
