"""OAK cameras with two grey cameras, through DepthAI 3, with the factory calibration.

The images are neither rectified nor undistorted. The dot projector of the Pro models is off unless
it is switched on, which is not done here; it is switched off nevertheless.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import timedelta
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError, SourceError
from vo.base.extras import require
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration.checks import make_camera, make_rig
from vo.recordings.sources.live.clock import CaptureStamps, HostClock
from vo.recordings.sources.live.device import CapturedImages, as_grey, warn_of_untested

_WIDTH, _HEIGHT, _RATE_HZ = 640, 400, 30
_TIMEOUT = timedelta(seconds=5)
_TOLERANCE = timedelta(milliseconds=5)  # the sensors are triggered together
_MAX_COEFFICIENTS = 8  # of the rational model; thin-prism and tilt follow
_M_PER_CM = 1e-2


class Oak:
    """A `Device` for a camera through `depthai`."""

    def __init__(self, serial: str | None, clock: HostClock) -> None:
        self._dai: Any = require("depthai", "oak", "OAK cameras")
        self._name = "oak" if serial is None else f"oak:{serial}"
        self._clock, self._stamps = clock, CaptureStamps()
        dai = self._dai
        try:
            self._device = dai.Device() if serial is None else dai.Device(dai.DeviceInfo(serial))
        except RuntimeError as error:
            raise SourceError(f"{self._name} cannot be opened: {error}") from error
        self._sockets = (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C)
        try:
            self.rig: Rig | None = self._factory_rig(self._device.readCalibration())
            self._device.setIrLaserDotProjectorIntensity(0.0)
            self._queue = self._start()
        except RuntimeError as error:
            self.close()
            raise SourceError(f"{self._name}: {error}") from error
        except BaseException:
            self.close()
            raise
        warn_of_untested(self._name, "depthai")

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        try:
            group = self._queue.get(_TIMEOUT)
            arrival_ns = self._clock.now_ns()
            if group is None:
                raise SourceError(f"{self._name} gives no images")
            frames = [group["left"], group["right"]]
            images = tuple(as_grey(frame.getCvFrame()) for frame in frames)
            own = frames[0].getTimestamp()  # of the host's monotonic clock
        except RuntimeError as error:
            raise SourceError(f"{self._name}: {error}") from error
        own_ns = own // timedelta(microseconds=1) * 1000
        return CapturedImages(self._stamps.stamp(arrival_ns, own_ns), images)

    def close(self) -> None:
        """See `Device.close`."""
        with suppress(RuntimeError):  # it was unplugged
            self._device.close()

    def _start(self) -> Any:
        dai = self._dai
        pipeline = dai.Pipeline(self._device)
        sync = pipeline.create(dai.node.Sync)
        sync.setSyncThreshold(_TOLERANCE)
        for name, socket in zip(("left", "right"), self._sockets, strict=True):
            camera = pipeline.create(dai.node.Camera).build(socket, sensorFps=_RATE_HZ)
            output = camera.requestOutput(
                (_WIDTH, _HEIGHT), type=dai.ImgFrame.Type.GRAY8, enableUndistortion=False
            )
            output.link(sync.inputs[name])
        queue = sync.out.createOutputQueue(maxSize=2, blocking=False)
        pipeline.start()
        self._pipeline = pipeline  # it ends when it is collected
        return queue

    def _factory_rig(self, calibration: Any) -> Rig:
        left, right = (self._camera(calibration, socket) for socket in self._sockets)
        matrix = np.array(calibration.getCameraExtrinsics(*self._sockets), dtype=np.float64)
        cam1_from_cam0 = make_transform(matrix[:3, :3], _M_PER_CM * matrix[:3, 3])
        return make_rig(self._name, left, right, cam1_from_cam0)

    def _camera(self, calibration: Any, socket: Any) -> Camera:
        models = self._dai.CameraModel
        lenses = {models.Perspective: "radtan", models.Fisheye: "equidistant"}
        model = calibration.getDistortionModel(socket)
        if model not in lenses:
            raise CalibrationError(
                f"{self._name}: distortion {model} is not supported; give `calibration=FILE`"
            )
        k = np.array(calibration.getCameraIntrinsics(socket, _WIDTH, _HEIGHT))
        lens = lenses[model]
        return make_camera(
            f"{self._name}: factory calibration",
            [_WIDTH, _HEIGHT],
            [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])],
            lens,
            self._coefficients(lens, calibration.getDistortionCoefficients(socket)),
        )

    def _coefficients(self, lens: str, given: Sequence[float]) -> list[float]:
        count = 4 if lens == "equidistant" else _MAX_COEFFICIENTS
        if any(given[count:]):
            raise CalibrationError(
                f"{self._name}: its distortion has more than {count} coefficients; give "
                "`calibration=FILE`"
            )
        return [float(x) for x in given[:count]]
