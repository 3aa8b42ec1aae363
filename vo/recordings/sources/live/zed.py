"""ZED cameras through the ZED SDK: pairs that the SDK has rectified with the factory calibration.

Depth is not computed, so no part of the SDK that needs the GPU's depth engine is used.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from vo.base.errors import MissingExtraError, SourceError
from vo.base.types import Bytes, Camera, Rig
from vo.recordings.formats.calibration.checks import make_camera, rectified_rig
from vo.recordings.sources.live.clock import CaptureStamps, HostClock
from vo.recordings.sources.live.device import CapturedImages, as_grey, warn_of_untested

_RATE_HZ = 30


class Zed:
    """A `Device` for a camera through `pyzed`."""

    def __init__(self, serial: str | None, clock: HostClock) -> None:
        self._sl = _pyzed()
        self._name = "zed" if serial is None else f"zed:{serial}"
        self._clock, self._stamps = clock, CaptureStamps()
        self._camera = self._sl.Camera()
        status = self._camera.open(self._settings(serial))
        if status != self._sl.ERROR_CODE.SUCCESS:
            raise SourceError(f"{self._name} cannot be opened: {status}")
        try:
            information = self._camera.get_camera_information()
            self.rig: Rig | None = self._factory_rig(information.camera_configuration)
        except BaseException:
            self.close()
            raise
        warn_of_untested(self._name, "pyzed")

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        sl = self._sl
        status = self._camera.grab(sl.RuntimeParameters())
        arrival_ns = self._clock.now_ns()
        if status != sl.ERROR_CODE.SUCCESS:
            raise SourceError(f"{self._name}: {status}")
        own_ns = self._camera.get_timestamp(sl.TIME_REFERENCE.IMAGE).get_nanoseconds()
        images = (self._image(sl.VIEW.LEFT_GRAY), self._image(sl.VIEW.RIGHT_GRAY))
        return CapturedImages(self._stamps.stamp(arrival_ns, own_ns), images)

    def close(self) -> None:
        """See `Device.close`."""
        self._camera.close()

    def _image(self, view: Any) -> Bytes:
        matrix = self._sl.Mat()
        self._camera.retrieve_image(matrix, view)
        return as_grey(np.array(matrix.get_data()))  # a copy: the memory is used again

    def _settings(self, serial: str | None) -> Any:
        sl = self._sl
        settings = sl.InitParameters()
        settings.camera_resolution = sl.RESOLUTION.VGA
        settings.camera_fps = _RATE_HZ
        settings.depth_mode = sl.DEPTH_MODE.NONE
        settings.coordinate_units = sl.UNIT.METER
        if serial is not None:
            if not serial.isdigit():
                raise SourceError(f"{self._name}: the serial number of a ZED has digits only")
            settings.set_from_serial_number(int(serial))
        return settings

    def _factory_rig(self, configuration: Any) -> Rig:
        calibration, size = configuration.calibration_parameters, configuration.resolution
        left, right = (
            self._make_camera(each, [size.width, size.height])
            for each in (calibration.left_cam, calibration.right_cam)
        )
        baseline_m = float(calibration.get_camera_baseline())
        return rectified_rig(self._name, left, right, baseline_m)

    def _make_camera(self, parameters: Any, size: list[int]) -> Camera:
        focal = [parameters.fx, parameters.fy, parameters.cx, parameters.cy]
        return make_camera(f"{self._name}: factory calibration", size, focal)


def _pyzed() -> Any:
    try:
        return importlib.import_module("pyzed.sl")
    except ImportError as error:
        raise MissingExtraError(
            "ZED cameras need pyzed, which comes with the ZED SDK "
            f"(https://www.stereolabs.com/developers), not with pip: {error}"
        ) from error
