"""Damaged transforms of a log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import layouts
import numpy as np
import pytest
from mcap_logs import write_log

from vo.base.types import Camera
from vo.recordings.formats.messages import (
    CalibrationMessage,
    FrameTransform,
    ImageMessage,
    Message,
    TransformsMessage,
)
from vo.recordings.formats.ros2 import ROS2
from vo.recordings.sources.registry import open_source

CAMERA = Camera(layouts.WIDTH, layouts.HEIGHT, *layouts.INTRINSICS)
DAMAGED_NS = 40  # transforms with a stamp below are cut off


def encode(message: Message) -> bytes:
    data = ROS2.encode(message)
    damaged = isinstance(message, TransformsMessage) and message.stamp_ns < DAMAGED_NS
    return data[: len(data) // 2] if damaged else data


def messages() -> list[tuple[str, Message]]:
    baseline = np.eye(4)
    baseline[0, 3] = -0.5
    transform = FrameTransform("right", "left", baseline)
    found: list[tuple[str, Message]] = [
        ("/tf", TransformsMessage(stamp, (transform,))) for stamp in range(1, 61)
    ]
    for side in ("left", "right"):
        info = CalibrationMessage(1, side, CAMERA, np.eye(3), np.eye(3, 4))
        found.append((f"/{side}/camera_info", info))
        size = layouts.WIDTH, layouts.HEIGHT
        pixels = layouts.image(0).tobytes()
        for stamp in layouts.STAMPS_NS[:3]:
            found.append((f"/{side}/image", ImageMessage(stamp, side, *size, "mono8", pixels)))
    return found


def test_one_warning_for_damaged_transforms(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_log(tmp_path / "log.mcap", messages(), replace(ROS2, encode=encode))
    rig = open_source(path).rig
    assert rig.cam1_from_cam0 is not None and rig.cam1_from_cam0[0, 3] == -0.5
    (record,) = caplog.records
    message = record.getMessage()
    assert message.startswith("/tf: 39 of 60 sampled transforms cannot be read")
