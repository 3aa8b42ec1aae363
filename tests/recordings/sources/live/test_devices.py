"""Network streams and cameras as devices, and pairs of them."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import count

import cv2
import numpy as np
import pytest
from live_devices import FakeCapture
from live_servers import served

from vo.base.errors import SourceError
from vo.base.types import Rig
from vo.recordings.sources.live.clock import HostClock
from vo.recordings.sources.live.device import CapturedImages, Device
from vo.recordings.sources.live.opencv_device import open_camera, open_opencv_stream
from vo.recordings.sources.live.pair import PAIR_TOLERANCE_NS, PairedDevices, SideBySideDevice
from vo.recordings.sources.live.pyav_device import PyAvStream

CLOCK = HostClock()
OPENERS: list[Callable[[str, HostClock], Device]] = [PyAvStream, open_opencv_stream]


def images(number: int = 5) -> list[np.ndarray]:
    """Blurred noise, whose mean is 20, 40, ... grey levels."""
    rng = np.random.default_rng(0)
    noise = [rng.normal(20 * (i + 1), 60, (64, 96)) for i in range(number)]
    return [np.clip(cv2.GaussianBlur(n, (0, 0), 3), 0, 255).astype(np.uint8) for n in noise]


@pytest.mark.parametrize("scheme", ["rtsp", "http"])
@pytest.mark.parametrize("connect", OPENERS)
def test_network_streams_give_images_with_capture_times(
    scheme: str, connect: Callable[[str, HostClock], Device]
) -> None:
    with served(scheme, images(), 50.0) as server, closing(connect(server.url, CLOCK)) as device:
        captured = [device.read() for _ in range(60)]
        now_ns = CLOCK.now_ns()
    stamps = np.array([each.stamp_ns for each in captured])
    assert (np.diff(stamps) > 0).all()
    assert 0 <= now_ns - stamps[-1] < 1_000_000_000
    assert abs(np.median(np.diff(stamps)[-30:]) - 20_000_000) < 4_000_000
    levels = {round(float(np.median(each.images[0])) / 20) for each in captured}
    assert levels == {1, 2, 3, 4, 5}
    assert captured[0].images[0].shape == (64, 96)


@pytest.mark.parametrize("connect", OPENERS)
def test_a_stream_that_ends_or_is_cut_is_an_error(
    connect: Callable[[str, HostClock], Device],
) -> None:
    with (
        served("http", images(), 100.0, end=10) as server,
        closing(connect(server.url, CLOCK)) as device,
        pytest.raises(SourceError, match="127.0.0.1"),
    ):
        for _ in range(100):
            device.read()


def test_a_server_that_is_not_there_is_told_without_the_password() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    for connect in OPENERS:
        with pytest.raises(SourceError) as told:
            connect(f"rtsp://me:secret@127.0.0.1:{port}/x", CLOCK)
        assert f"rtsp://me:***@127.0.0.1:{port}/x" in str(told.value)
        assert "secret" not in str(told.value)


def test_a_camera_is_asked_for_the_size_of_its_calibration() -> None:
    opened: list[FakeCapture] = []

    def open_capture(*arguments: object) -> FakeCapture:
        opened.append(FakeCapture(*arguments, sizes=((1280, 720),)))
        return opened[-1]

    for target, size, shape in [("0", (1280, 720), (720, 1280)), ("1", (500, 400), (480, 640))]:
        device = open_camera(target, size, CLOCK, open_capture)
        assert device.read().images[0].shape == shape
        device.close()
    assert [capture.target for capture in opened] == [0, 1]
    assert all(capture.is_released for capture in opened)
    assert cv2.CAP_PROP_FOURCC in opened[0].requested  # packed images, as they are large
    assert cv2.CAP_PROP_FOURCC not in opened[1].requested


def test_a_missing_camera_is_told_in_one_line() -> None:
    with pytest.raises(SourceError, match="camera:9 cannot be opened: there is no such camera"):
        open_camera("9", None, CLOCK, FakeCapture)


class Sequence:
    """A device with given stamps in milliseconds; its images contain their numbers."""

    rig: Rig | None = None

    def __init__(self, stamps_ms: Iterator[float], offset: int = 0) -> None:
        self._stamps_ms, self._numbers = stamps_ms, count(offset)
        self.is_closed, self._end = False, threading.Event()

    def read(self) -> CapturedImages:
        stamp_ms = next(self._stamps_ms, None)
        if stamp_ms is None:
            self._end.wait(1.0)
            raise SourceError("it ended")
        image = np.full((4, 6), next(self._numbers), dtype=np.uint8)
        return CapturedImages(round(1e6 * stamp_ms), (image,))

    def close(self) -> None:
        self.is_closed = True


def test_images_of_two_devices_are_paired_by_their_stamps(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("vo.recordings.sources.live.pair._TIMEOUT_S", 0.2)
    left = Sequence(iter([100.0, 133, 167, 200]))
    right = Sequence(iter([95.0, 138, 183, 207]), offset=50)
    device = PairedDevices("camera:0,1", lambda: left, lambda: right)
    pairs = []
    with pytest.raises(SourceError, match="no images from one of the two cameras"):
        while True:
            pairs.append(device.read())
    numbers = [tuple(int(image[0, 0]) for image in pair.images) for pair in pairs]
    assert numbers == [(0, 50), (1, 51), (3, 53)]  # 167 and 183 ms are too far apart
    assert [pair.stamp_ns for pair in pairs] == [100_000_000, 133_000_000, 200_000_000]
    device.close()
    assert "camera:0,1: 2 images left out, without a partner within 10 ms" in caplog.text


def test_two_devices_that_never_agree_are_told_how_far_they_are_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("vo.recordings.sources.live.pair._TIMEOUT_S", 0.2)
    left = Sequence(iter([100.0, 140, 180]))
    right = Sequence(iter([115.0, 155, 195]))
    device = PairedDevices("camera:0,1", lambda: left, lambda: right)
    with pytest.raises(SourceError, match="15 ms apart, more than the 10 ms of a pair"):
        device.read()
    assert PAIR_TOLERANCE_NS == 10_000_000


def test_the_left_device_is_closed_if_there_is_no_right_one() -> None:
    left = Sequence(iter([0.0]))

    def missing() -> Device:
        raise SourceError("no such camera")

    with pytest.raises(SourceError, match="no such camera"):
        PairedDevices("camera:0,1", lambda: left, missing)
    assert left.is_closed


def test_a_side_by_side_image_is_divided() -> None:
    device = SideBySideDevice(Sequence(iter([5.0])))
    stamp_ns, (left, right) = device.read()
    assert (stamp_ns, left.shape, right.shape) == (5_000_000, (4, 3), (4, 3))
