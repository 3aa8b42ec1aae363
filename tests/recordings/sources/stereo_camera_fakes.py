"""Stand-ins for the packages of stereo cameras, with the classes and signatures of the real ones.

`test_stereo_cameras.py` compares them with the packages where these are installed.
"""

from __future__ import annotations

import types
from datetime import timedelta
from enum import Enum
from typing import Any

import numpy as np

BASELINE_M = 0.05


def images(number: int, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    left = np.full((height, width), number % 200, dtype=np.uint8)
    return left, left + 1


class FakeRealSense(types.ModuleType):
    """`pyrealsense2` 2.59 with one camera; `coefficients` and `model` are those of its lenses."""

    class stream(Enum):  # noqa: N801
        infrared = 3

    class format(Enum):  # noqa: N801
        y8 = 9

    class option(Enum):  # noqa: N801
        emitter_enabled = 18

    class distortion(Enum):  # noqa: N801
        brown_conrady = 4
        inverse_brown_conrady = 2
        kannala_brandt4 = 5

    def __init__(self) -> None:
        super().__init__("pyrealsense2")
        self.options: dict[Any, float] = {}
        self.serials: list[str] = []
        self.streams: list[tuple[Any, ...]] = []
        self.model, self.coefficients = self.distortion.brown_conrady, [0.0] * 5
        self.stopped = 0
        self.is_plugged = True
        fake = self

        class config:  # noqa: N801
            def enable_device(self, serial: str) -> None:
                fake.serials.append(serial)

            def enable_stream(
                self,
                stream_type: object,
                stream_index: int,
                width: int,
                height: int,
                format: object,
                framerate: int,
            ) -> None:
                fake.streams.append((stream_type, stream_index, width, height, format, framerate))

        class pipeline:  # noqa: N801
            def __init__(self) -> None:
                self._number = 0

            def start(self, config: object) -> _Profile:
                if not fake.is_plugged:
                    raise RuntimeError("No device connected")
                return _Profile(fake)

            def wait_for_frames(self, timeout_ms: int = 5000) -> _Frames:
                if not fake.is_plugged:
                    raise RuntimeError("Frame didn't arrive within 5000")
                self._number += 1
                return _Frames(self._number)

            def stop(self) -> None:
                fake.stopped += 1
                if not fake.is_plugged:
                    raise RuntimeError("stop() cannot be called before start()")

        self.config, self.pipeline = config, pipeline


class _Frames:
    def __init__(self, number: int) -> None:
        self._number = number

    def get_infrared_frame(self, index: int = 0) -> _Frame:
        return _Frame(images(self._number, 480, 848)[index - 1], 33.3 * self._number)


class _Frame:
    def __init__(self, image: np.ndarray, timestamp_ms: float) -> None:
        self._image, self._timestamp_ms = image, timestamp_ms

    def get_data(self) -> memoryview:
        return memoryview(self._image)

    def get_timestamp(self) -> float:
        return self._timestamp_ms


class _Profile:
    def __init__(self, fake: FakeRealSense) -> None:
        self._fake = fake

    def get_stream(self, stream_type: object, stream_index: int = -1) -> _Profile:
        return self

    def as_video_stream_profile(self) -> _Profile:
        return self

    def get_intrinsics(self) -> types.SimpleNamespace:
        return types.SimpleNamespace(
            width=848,
            height=480,
            fx=425.5,
            fy=425.25,
            ppx=421.0,
            ppy=240.5,
            model=self._fake.model,
            coeffs=self._fake.coefficients,
        )

    def get_extrinsics_to(self, to: _Profile) -> types.SimpleNamespace:
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
        return types.SimpleNamespace(
            rotation=turn.ravel(order="F").tolist(), translation=[-BASELINE_M, 0.0, 0.0]
        )

    def get_device(self) -> _Profile:
        return self

    def first_depth_sensor(self) -> _Profile:
        return self

    def supports(self, option: object) -> bool:
        return True

    def set_option(self, option: object, value: float) -> None:
        self._fake.options[option] = value


class FakeDepthAi(types.ModuleType):
    """`depthai` 3.12 with one camera."""

    class CameraBoardSocket(Enum):
        CAM_B = 1
        CAM_C = 2

    class CameraModel(Enum):
        Perspective = 0
        Fisheye = 1
        Equirectangular = 2

    class ImgFrame:
        Type = Enum("Type", ["GRAY8"])

        def __init__(self, image: np.ndarray, stamp: timedelta) -> None:
            self._image, self._stamp = image, stamp

        def getCvFrame(self) -> np.ndarray:  # noqa: N802
            return self._image

        def getTimestamp(self) -> timedelta:  # noqa: N802
            return self._stamp

    def __init__(self) -> None:
        super().__init__("depthai")
        self.is_plugged = True
        self.model, self.coefficients = self.CameraModel.Perspective, [0.1, -0.2] + [0.0] * 12
        self.projector: list[float] = []
        self.asked_for: list[object] = []
        self.requested: list[dict[str, Any]] = []
        self.linked: list[tuple[object, object]] = []
        self.is_closed = False
        self.node = types.SimpleNamespace(Camera=_OakCamera, Sync=_Sync)
        fake = self

        class DeviceInfo:
            def __init__(self, deviceIdOrName: str) -> None:  # noqa: N803
                self.name = deviceIdOrName

        class Device:
            def __init__(self, deviceInfo: object = None) -> None:  # noqa: N803
                if not fake.is_plugged:
                    raise RuntimeError("No available devices")
                fake.asked_for.append(getattr(deviceInfo, "name", None))

            def readCalibration(self) -> _Calibration:  # noqa: N802
                return _Calibration(fake)

            def setIrLaserDotProjectorIntensity(  # noqa: N802
                self, intensity: float, mask: int = -1
            ) -> bool:
                fake.projector.append(intensity)
                return True

            def close(self) -> None:
                fake.is_closed = True

        class Pipeline:
            def __init__(self, defaultDevice: Device) -> None:  # noqa: N803
                self.is_started = False

            def create(self, node: type) -> Any:
                return node(fake)

            def start(self) -> None:
                self.is_started = True

        self.Device, self.DeviceInfo, self.Pipeline = Device, DeviceInfo, Pipeline


class _Calibration:
    def __init__(self, fake: FakeDepthAi) -> None:
        self._fake = fake

    def getCameraIntrinsics(  # noqa: N802
        self,
        cameraId: object,  # noqa: N803
        resizeWidth: int = -1,  # noqa: N803
        resizeHeight: int = -1,  # noqa: N803
    ) -> list[list[float]]:
        f = 800.0 * resizeWidth / 1280
        return [[f, 0.0, resizeWidth / 2], [0.0, f, resizeHeight / 2], [0.0, 0.0, 1.0]]

    def getDistortionModel(self, cameraId: object) -> object:  # noqa: N802, N803
        return self._fake.model

    def getDistortionCoefficients(self, cameraId: object) -> list[float]:  # noqa: N802, N803
        return self._fake.coefficients

    def getCameraExtrinsics(  # noqa: N802
        self,
        srcCamera: object,  # noqa: N803
        dstCamera: object,  # noqa: N803
        useSpecTranslation: bool = False,  # noqa: N803
    ) -> list[list[float]]:
        """Takes points from the source to the destination, in centimetres."""
        pose = np.eye(4)
        pose[0, 3] = -100 * BASELINE_M
        return pose.tolist()


class _OakCamera:
    def __init__(self, fake: FakeDepthAi) -> None:
        self._fake = fake

    def build(
        self,
        boardSocket: object,  # noqa: N803
        sensorResolution: object = None,  # noqa: N803
        sensorFps: float | None = None,  # noqa: N803
    ) -> _OakCamera:
        return self

    def requestOutput(  # noqa: N802
        self,
        size: tuple[int, int],
        type: object = None,
        resizeMode: object = None,  # noqa: N803
        fps: float | None = None,
        enableUndistortion: bool | None = None,  # noqa: N803
    ) -> _Output:
        self._fake.requested.append({"size": size, "type": type, "undistort": enableUndistortion})
        return _Output(self._fake)


class _Output:
    def __init__(self, fake: FakeDepthAi) -> None:
        self._fake, self._number = fake, 0

    def link(self, target: object) -> None:
        self._fake.linked.append((self, target))

    def createOutputQueue(  # noqa: N802
        self,
        maxSize: int = 16,  # noqa: N803
        blocking: bool = False,
    ) -> _Output:
        return self

    def get(self, timeout: timedelta) -> dict[str, Any] | None:
        if not self._fake.is_plugged:
            raise RuntimeError("Communication exception - possible device error")
        self._number += 1
        stamp = timedelta(seconds=0.0333 * self._number)
        pair = images(self._number, 400, 640)
        frames = [self._fake.ImgFrame(image, stamp) for image in pair]
        return dict(zip(("left", "right"), frames, strict=True))


class _Sync:
    def __init__(self, fake: FakeDepthAi) -> None:
        self.inputs = {"left": "left", "right": "right"}
        self.out = _Output(fake)

    def setSyncThreshold(self, syncThreshold: timedelta) -> None:  # noqa: N802, N803
        self.threshold = syncThreshold


class FakeZed(types.ModuleType):
    """`pyzed.sl` 5 with one camera."""

    ERROR_CODE = Enum("ERROR_CODE", ["SUCCESS", "CAMERA_NOT_DETECTED", "CAMERA_NOT_INITIALIZED"])
    RESOLUTION = Enum("RESOLUTION", ["VGA", "HD720"])
    DEPTH_MODE = Enum("DEPTH_MODE", ["NONE", "PERFORMANCE"])
    UNIT = Enum("UNIT", ["METER", "MILLIMETER"])
    VIEW = Enum("VIEW", ["LEFT_GRAY", "RIGHT_GRAY"])
    TIME_REFERENCE = Enum("TIME_REFERENCE", ["IMAGE", "CURRENT"])

    class InitParameters:
        def __init__(self) -> None:
            self.serial: int | None = None

        def set_from_serial_number(self, serial_number: int) -> None:
            self.serial = serial_number

    class RuntimeParameters: ...

    class Mat:
        def get_data(self) -> np.ndarray:
            return self.data

    def __init__(self) -> None:
        super().__init__("pyzed.sl")
        self.is_plugged = True
        self.settings: Any = None
        self.is_closed = False
        fake = self

        class Camera:
            def __init__(self) -> None:
                self._number = 0

            def open(self, py_init: object) -> object:
                fake.settings = py_init
                codes = fake.ERROR_CODE
                return codes.SUCCESS if fake.is_plugged else codes.CAMERA_NOT_DETECTED

            def get_camera_information(self) -> types.SimpleNamespace:
                lens = types.SimpleNamespace(fx=340.0, fy=340.0, cx=335.5, cy=187.5)
                parameters = types.SimpleNamespace(
                    left_cam=lens, right_cam=lens, get_camera_baseline=lambda: BASELINE_M
                )
                return types.SimpleNamespace(
                    camera_configuration=types.SimpleNamespace(
                        resolution=types.SimpleNamespace(width=672, height=376),
                        calibration_parameters=parameters,
                    )
                )

            def grab(self, py_runtime: object) -> object:
                self._number += 1
                codes = fake.ERROR_CODE
                return codes.SUCCESS if fake.is_plugged else codes.CAMERA_NOT_INITIALIZED

            def get_timestamp(self, time_reference: object) -> types.SimpleNamespace:
                return types.SimpleNamespace(get_nanoseconds=lambda: 33_300_000 * self._number)

            def retrieve_image(self, py_mat: Any, view: Any) -> object:
                left, right = images(self._number, 376, 672)
                py_mat.data = left if view is fake.VIEW.LEFT_GRAY else right
                return fake.ERROR_CODE.SUCCESS

            def close(self) -> None:
                fake.is_closed = True

        self.Camera = Camera
