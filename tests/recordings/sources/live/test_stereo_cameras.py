"""RealSense, OAK and ZED cameras, against stand-ins for their packages."""

from __future__ import annotations

import importlib
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from stereo_camera_fakes import BASELINE_M, FakeDepthAi, FakeRealSense, FakeZed

from vo.base.errors import CalibrationError, MissingExtraError, SourceError
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.sources.live.address import parse_address
from vo.recordings.sources.live.clock import HostClock
from vo.recordings.sources.live.device import Device
from vo.recordings.sources.live.oak import Oak
from vo.recordings.sources.live.opening import LiveOptions, open_live
from vo.recordings.sources.live.realsense import RealSense
from vo.recordings.sources.live.zed import Zed

CLOCK = HostClock()
Fake = FakeRealSense | FakeDepthAi | FakeZed
KINDS: dict[str, tuple[type, type, str]] = {
    "realsense": (FakeRealSense, RealSense, "pyrealsense2"),
    "oak": (FakeDepthAi, Oak, "depthai"),
    "zed": (FakeZed, Zed, "pyzed.sl"),
}
SIZES = {"realsense": (848, 480), "oak": (640, 400), "zed": (672, 376)}


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def fake(kind: str, monkeypatch: pytest.MonkeyPatch) -> Fake:
    made: Fake = KINDS[kind][0]()
    if kind == "zed":
        monkeypatch.setitem(sys.modules, "pyzed", types.ModuleType("pyzed"))
    monkeypatch.setitem(sys.modules, KINDS[kind][2], made)
    return made


def opened(kind: str, serial: str | None = None) -> Device:
    device: Device = KINDS[kind][1](serial, CLOCK)
    return device


def test_the_factory_calibration_is_read(kind: str, fake: Fake) -> None:
    device = opened(kind)
    rig = device.rig
    assert rig is not None and rig.cam1 is not None and rig.cam1_from_cam0 is not None
    assert (rig.cam0.width, rig.cam0.height) == SIZES[kind]
    np.testing.assert_allclose(rig.cam1_from_cam0[:3, 3], [-BASELINE_M, 0, 0], atol=1e-12)
    expected = {
        "realsense": (425.5, 425.25, 421.0, 240.5),
        "oak": (400.0, 400.0, 320.0, 200.0),
        "zed": (340.0, 340.0, 335.5, 187.5),
    }[kind]
    assert (rig.cam0.fx, rig.cam0.fy, rig.cam0.cx, rig.cam0.cy) == expected
    if kind == "realsense":  # whose rotations are stored column by column
        np.testing.assert_allclose(rig.cam1_from_cam0[2, :3], [0.0, 0.6, 0.8])
    if kind == "oak":
        assert (rig.cam0.distortion_model, rig.cam0.distortion[:2]) == ("radtan", (0.1, -0.2))
    else:
        assert not rig.cam0.is_distorted


def test_pairs_come_with_increasing_stamps(
    kind: str, fake: Fake, caplog: pytest.LogCaptureFixture
) -> None:
    device = opened(kind)
    captured = [device.read() for _ in range(3)]
    width, height = SIZES[kind]
    for number, each in enumerate(captured, start=1):
        left, right = each.images
        assert left.shape == right.shape == (height, width)
        assert (int(left[0, 0]), int(right[0, 0])) == (number, number + 1)
    stamps = [each.stamp_ns for each in captured]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[0] - CLOCK.now_ns()) < 2_000_000_000
    assert "tested without a camera" in caplog.text


def test_the_projector_is_off(kind: str, fake: Fake) -> None:
    opened(kind)
    if isinstance(fake, FakeRealSense):
        assert fake.options == {fake.option.emitter_enabled: 0.0}
        assert [stream[1] for stream in fake.streams] == [1, 2]
    if isinstance(fake, FakeDepthAi):
        assert fake.projector == [0.0]
        assert [each["undistort"] for each in fake.requested] == [False, False]
        assert len(fake.linked) == 2
    if isinstance(fake, FakeZed):
        assert fake.settings.depth_mode is fake.DEPTH_MODE.NONE


def test_a_serial_number_chooses_the_camera(kind: str, fake: Fake) -> None:
    opened(kind, "1234")
    chosen = {
        "realsense": getattr(fake, "serials", None),
        "oak": getattr(fake, "asked_for", None),
        "zed": [getattr(getattr(fake, "settings", None), "serial", None)],
    }[kind]
    assert chosen == ([1234] if kind == "zed" else ["1234"])


def test_no_camera_and_a_cable_that_is_pulled_are_errors(kind: str, fake: Fake) -> None:
    device = opened(kind)
    device.read()
    fake.is_plugged = False
    with pytest.raises(SourceError, match=f"^{kind}: "):
        device.read()
    device.close()
    with pytest.raises(SourceError, match=f"^{kind} cannot be opened: "):
        opened(kind)


def test_a_missing_package_is_told_in_one_line(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, KINDS[kind][2], None)
    with pytest.raises(MissingExtraError, match="pip install 'visual-odometry|ZED SDK"):
        opened(kind)


def test_lenses_that_are_not_supported_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    realsense = FakeRealSense()
    realsense.model, realsense.coefficients = realsense.distortion.inverse_brown_conrady, [0.1] * 5
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense)
    with pytest.raises(CalibrationError, match="inverse_brown_conrady is not supported"):
        opened("realsense")
    assert realsense.stopped == 1
    depthai = FakeDepthAi()
    monkeypatch.setitem(sys.modules, "depthai", depthai)
    for model, coefficients, message in (
        (depthai.CameraModel.Equirectangular, [], "Equirectangular is not supported"),
        (depthai.CameraModel.Perspective, [0.1] * 14, "more than 8 coefficients"),
    ):
        depthai.model, depthai.coefficients = model, coefficients
        with pytest.raises(CalibrationError, match=message):
            opened("oak")
        assert depthai.is_closed
    depthai.model, depthai.coefficients = depthai.CameraModel.Fisheye, [0.1, 0.2, 0.3, 0.4]
    rig = opened("oak").rig
    assert rig is not None
    assert rig.cam0.distortion_model == "equidistant"


def test_a_run_needs_no_calibration(kind: str, fake: Fake, tmp_path: Path) -> None:
    address = parse_address(f"{kind}:")
    assert address is not None
    stream = open_live(address, None)
    assert (stream.name, stream.rig.is_stereo) == (kind, True)
    frame = next(stream.frames())
    assert frame.image1 is not None
    stream.close()
    mono = open_live(address, None, "mono")
    assert not mono.rig.is_stereo
    mono.close()
    with pytest.raises(SourceError, match="leave `side_by_side` out"):
        open_live(address, None, options=LiveOptions(side_by_side=True))
    width, height = SIZES[kind]
    write_calibration(tmp_path / "own.yaml", Rig(Camera(width, height, 300, 300, 320, 200)))
    with pytest.raises(CalibrationError, match="own.yaml has no right camera"):
        open_live(address, tmp_path / "own.yaml")


def test_stand_ins_have_only_what_the_package_has(kind: str) -> None:
    """Where the package is installed; the ZED SDK's is not on the package index."""
    real = pytest.importorskip(KINDS[kind][2], exc_type=ImportError)
    names = {
        "realsense": [
            *("config.enable_device", "config.enable_stream", "pipeline.start", "pipeline.stop"),
            *("pipeline.wait_for_frames", "composite_frame.get_infrared_frame", "frame.get_data"),
            *("frame.get_timestamp", "pipeline_profile.get_stream", "pipeline_profile.get_device"),
            *("stream_profile.as_video_stream_profile", "stream_profile.get_extrinsics_to"),
            *("video_stream_profile.get_intrinsics", "device.first_depth_sensor"),
            *("depth_sensor.supports", "depth_sensor.set_option", "stream.infrared", "format.y8"),
            *("option.emitter_enabled", "distortion.brown_conrady", "distortion.kannala_brandt4"),
            *("intrinsics.ppx", "intrinsics.coeffs", "extrinsics.rotation", "intrinsics.model"),
        ],
        "oak": [
            *("Device.readCalibration", "Device.setIrLaserDotProjectorIntensity", "Device.close"),
            *("DeviceInfo", "Pipeline.create", "Pipeline.start", "node.Camera.build"),
            *("node.Camera.requestOutput", "node.Sync.setSyncThreshold", "node.Sync.inputs"),
            *("node.Sync.out", "Node.Output.createOutputQueue", "Node.Output.link"),
            *("MessageQueue.get", "MessageGroup.__getitem__", "ImgFrame.getCvFrame"),
            *("ImgFrame.getTimestamp", "ImgFrame.Type.GRAY8", "CameraModel.Perspective"),
            *("CameraModel.Fisheye", "CameraBoardSocket.CAM_B", "CameraBoardSocket.CAM_C"),
            *("CalibrationHandler.getCameraIntrinsics", "CalibrationHandler.getCameraExtrinsics"),
            *("CalibrationHandler.getDistortionModel",),
            *("CalibrationHandler.getDistortionCoefficients",),
        ],
        "zed": [
            *("Camera.open", "Camera.grab", "Camera.retrieve_image", "Camera.get_timestamp"),
            *("Camera.get_camera_information", "Camera.close", "Mat.get_data"),
            *("InitParameters.set_from_serial_number", "RESOLUTION.VGA", "DEPTH_MODE.NONE"),
            *("UNIT.METER", "VIEW.LEFT_GRAY", "TIME_REFERENCE.IMAGE", "ERROR_CODE.SUCCESS"),
        ],
    }[kind]
    for name in names:
        found: object = importlib.import_module(KINDS[kind][2])
        assert found is real
        for part in name.split("."):
            found = getattr(found, part)
