"""Capture in a thread: the newest images, and reconnection."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from live_devices import FakeDevice, wait_for

from vo.base.errors import SourceError
from vo.recordings.sources.live import capture as capture_module
from vo.recordings.sources.live.capture import Capture
from vo.recordings.sources.live.device import CapturedImages, Device


def connector(*devices: FakeDevice | SourceError):  # noqa: ANN201
    waiting = list(devices)

    def connect() -> Device:
        device = waiting.pop(0)
        if isinstance(device, SourceError):
            raise device
        return device

    return connect


def taken(capture: Capture) -> int | None:
    images = capture.take(2.0)
    return None if images is None else int(images.images[0][0, 0])


def close(capture: Capture, device: FakeDevice) -> None:
    capture.stop()
    device.give(1)  # it waits for an image
    capture.close()


def test_the_newest_images_are_taken_and_the_others_are_counted() -> None:
    device = FakeDevice()
    capture = Capture("camera", connector(device))
    device.give(1)
    assert taken(capture) == 1
    device.give(5)
    wait_for(lambda: capture.dropped == 4)
    assert taken(capture) == 6
    device.give(1)
    assert taken(capture) == 7
    assert capture.dropped == 4
    close(capture, device)
    assert device.is_closed


def test_at_most_one_image_is_kept_for_a_slow_consumer() -> None:
    alive: list[weakref.ref[np.ndarray]] = []

    class Counting(FakeDevice):
        def read(self) -> CapturedImages:
            images = super().read()
            alive.append(weakref.ref(images.images[0]))
            return images

    device = Counting()
    capture = Capture("camera", connector(device))
    device.give(200)
    wait_for(lambda: capture.dropped == 199)
    gc.collect()
    assert sum(ref() is not None for ref in alive) == 1
    close(capture, device)


def test_what_came_before_the_run_is_not_counted() -> None:
    device = FakeDevice()
    capture = Capture("camera", connector(device))
    device.give(10)
    wait_for(lambda: capture.dropped == 9)
    capture.forget()
    device.give(1)
    assert (taken(capture), capture.dropped) == (11, 0)
    close(capture, device)


def test_a_stall_is_a_gap(caplog: pytest.LogCaptureFixture) -> None:
    device = FakeDevice()
    capture = Capture("camera", connector(device))
    stamps_ns = (0, 100_000_000, 200_000_000, 4_200_000_000, 4_300_000_000)
    for stamp_ns in stamps_ns:
        capture._put(CapturedImages(stamp_ns, (np.zeros((2, 2), np.uint8),)))
    assert [tuple(gap)[:2] for gap in capture.gaps] == [(200_000_000, 4_200_000_000)]
    assert caplog.messages == ["camera: images again, after 4.0 s without"]
    close(capture, device)


def test_a_lost_connection_is_made_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(capture_module, "_MIN_WAIT_S", 0.01)
    first, second = FakeDevice(end=2), FakeDevice(first=5)
    refused = SourceError("connection refused")
    capture = Capture("rtsp://camera", connector(first, refused, refused, second))
    first.give(2)
    wait_for(lambda: capture.trouble == "connection refused")
    second.give(1)
    numbers = {taken(capture)}
    wait_for(lambda: bool(capture.gaps))
    numbers.add(taken(capture) if 6 not in numbers else 6)
    assert numbers <= {2, 6}
    gap = capture.gaps[0]
    assert (gap.first_ns, gap.last_ns) == (2000, 6000)
    close(capture, second)
    lost, again = (record.getMessage() for record in caplog.records)
    assert lost == "rtsp://camera: connection lost (the cable was pulled); connecting again"
    assert again.startswith("rtsp://camera: images again, after")


def test_a_device_that_cannot_be_opened_at_first_is_an_error() -> None:
    capture = Capture("camera", connector(SourceError("no such camera")))
    with pytest.raises(SourceError, match="no such camera"):
        capture.take(5.0)


def test_a_bug_is_raised_where_images_are_awaited() -> None:
    class Broken(FakeDevice):
        def read(self) -> CapturedImages:
            raise ZeroDivisionError

    capture = Capture("camera", connector(Broken()))
    with pytest.raises(ZeroDivisionError):
        capture.take(5.0)


def test_waiting_ends_after_the_timeout_and_when_it_is_stopped() -> None:
    device = FakeDevice()
    capture = Capture("camera", connector(device))
    assert capture.take(0.01) is None
    capture.stop()
    assert capture.take(60.0) is None
    close(capture, device)
