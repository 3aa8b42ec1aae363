"""Helper threads do not preempt the tracking thread."""

from __future__ import annotations

import os
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from vo.base.config import Config
from vo.base.geometry.rectification import rectified_rig
from vo.base.scheduling import give_way
from vo.base.types import Camera, Frame, Rig
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.preprocessing import FramePreprocessor
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems have no SCHED_BATCH")


def test_only_the_calling_thread_gives_way() -> None:
    before = os.sched_getscheduler(0)
    with ThreadPoolExecutor(1, initializer=give_way) as pool:
        assert pool.submit(os.sched_getscheduler, 0).result() == os.SCHED_BATCH
    assert os.sched_getscheduler(0) == before


def test_frames_are_preprocessed_by_threads_that_give_way(monkeypatch: pytest.MonkeyPatch) -> None:
    policies: list[int] = []
    rig = rectified_rig(Rig(Camera(200, 120, 150.0, 150.0, 100.0, 60.0)))
    image = np.random.default_rng(0).integers(0, 255, (120, 200), dtype=np.uint8)
    config = Config()
    frontend = make_frontend(config)
    vertical_disparity = VerticalDisparityCorrection(
        rig, frontend.matcher, frontend.patches, config.stereo
    )
    preprocessor = FramePreprocessor(rig, frontend.extractor, vertical_disparity, threads=2)
    monkeypatch.setattr(
        "vo.engine.frontend.preprocessing.half_size_pyramid",
        lambda image: policies.append(os.sched_getscheduler(0)) or (),
    )
    try:
        preprocessor.submit(Frame(0, 0, (image,))).result()
    finally:
        preprocessor.close()
    assert policies == [os.SCHED_BATCH]


def test_a_system_that_forbids_it_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError("not in this container")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    give_way()
