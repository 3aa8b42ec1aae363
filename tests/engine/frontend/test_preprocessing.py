"""Frames made ready ahead of time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from vo.base.config import Config, FeaturesConfig
from vo.base.geometry.rectification import rectified_rig
from vo.base.types import Camera, Frame, Rig
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.lazy_future import LazyFuture
from vo.engine.frontend.preprocessing import FramePreprocessor
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection

RIG = rectified_rig(Rig(Camera(200, 120, 150.0, 150.0, 100.0, 60.0)))


def _frames(count: int, error: Exception | None = None) -> Iterator[Frame]:
    for index in range(count):
        image = np.random.default_rng(index).integers(0, 255, (120, 200), dtype=np.uint8)
        yield Frame(index, index, (image,))
    if error is not None:
        raise error


@pytest.fixture(params=[1, 2, 3])
def threads(request: pytest.FixtureRequest) -> int:
    count: int = request.param
    return count


@pytest.fixture
def preparation(threads: int) -> Iterator[FramePreprocessor]:
    config = Config(features=FeaturesConfig(count=100))
    frontend = make_frontend(config)
    vertical_disparity = VerticalDisparityCorrection(
        RIG, frontend.matcher, frontend.patches, config.stereo
    )
    preparation = FramePreprocessor(RIG, frontend.extractor, vertical_disparity, threads=threads)
    yield preparation
    preparation.close()


def test_every_frame_comes_in_order_and_is_the_same_as_alone(
    preparation: FramePreprocessor,
) -> None:
    ahead = [coming.result() for coming in preparation.ahead(_frames(4))]
    alone = [preparation.submit(frame).result() for frame in _frames(4)]
    assert [frame.index for frame in ahead] == [0, 1, 2, 3]
    for one, other in zip(ahead, alone, strict=True):
        np.testing.assert_array_equal(one.keypoints.descriptor, other.keypoints.descriptor)
        np.testing.assert_array_equal(one.keypoints.xy, other.keypoints.xy)


def test_one_frame_is_read_ahead_by_a_third_thread_and_no_more(
    preparation: FramePreprocessor, threads: int
) -> None:
    read: list[int] = []

    def frames() -> Iterator[Frame]:
        for frame in _frames(5):
            read.append(frame.index)
            yield frame

    ahead = preparation.ahead(frames())
    for last in (1, 2, 3):
        next(ahead)
        assert read == list(range(last + (threads > 2)))


def test_frames_before_an_error_are_handed_out(preparation: FramePreprocessor) -> None:
    ahead = preparation.ahead(_frames(2, OSError("unplugged")))
    assert [next(ahead).result().index for _ in range(2)] == [0, 1]
    with pytest.raises(OSError, match="unplugged"):
        next(ahead)


def test_no_frames_are_no_trouble(preparation: FramePreprocessor) -> None:
    assert list(preparation.ahead(_frames(0))) == []


def test_what_comes_later_is_worked_out_once_wherever_it_was_begun() -> None:
    threads: list[str] = []

    def work() -> int:
        threads.append(threading.current_thread().name)
        return 7

    with ThreadPoolExecutor(1, thread_name_prefix="beside") as pool:
        begun = LazyFuture(work, pool)
        begun.start()
        begun.start()
        assert (begun.result(), begun.result()) == (7, 7)
        assert len(threads) == 1 and threads[0].startswith("beside")
        asked = LazyFuture(work, pool)
        assert (asked.result(), asked.result()) == (7, 7)
        assert len(threads) == 2 and threads[1] == threads[0]  # one detector, one thread
    nowhere = LazyFuture(work, None)
    nowhere.start()
    assert len(threads) == 2
    assert nowhere.result() == 7
    assert threads[2:] == [threading.current_thread().name]


def test_work_that_failed_fails_again_when_asked_again() -> None:
    later = LazyFuture(lambda: 1 // 0, None)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            later.result()
