"""MCAP files with images, calibrations and transforms of several cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import layouts
import numpy as np
from mcap_logs import DIALECTS, write_log

from vo.base.geometry.transforms import se3_exp
from vo.base.types import Camera
from vo.recordings.formats.messages import (
    CalibrationMessage,
    FrameTransform,
    ImageMessage,
    Message,
    TransformsMessage,
)

OnTopic = tuple[str, Message]
LENS = Camera(
    layouts.WIDTH, layouts.HEIGHT, *layouts.INTRINSICS, "radtan", (0.05, -0.01, 0.001, 0.002, 0.0)
)
FISHEYE = replace(LENS, distortion_model="equidistant", distortion=(0.01, 0.02, 0.03, 0.04))
RATIONAL = replace(LENS, distortion=(0.05, -0.01, 0.001, 0.002, 0.0, 0.01, 0.02, 0.03))
CAM1_FROM_CAM0 = se3_exp(np.array([0.01, -0.02, 0.005, -0.12, 0.001, 0.002]))


def images(topic: str, frame: str = "cam", count: int = 4, every: int = 1) -> Iterator[OnTopic]:
    for stamp in layouts.STAMPS_NS[:count:every]:
        pixels = layouts.image(0).tobytes()
        size = layouts.WIDTH, layouts.HEIGHT
        yield topic, ImageMessage(stamp, frame, *size, "mono8", pixels)


def calibration(
    topic: str, frame: str, camera: Camera = LENS, shift: float = 0.0, turn: Any = None
) -> OnTopic:
    projection = np.column_stack([camera.matrix, [shift * camera.fx, 0, 0]])
    message = CalibrationMessage(
        layouts.STAMPS_NS[0], frame, camera, np.eye(3) if turn is None else turn, projection
    )
    return topic, message


def fixed(*transforms: tuple[str, str, Any]) -> OnTopic:
    message = TransformsMessage(1, tuple(FrameTransform(*each) for each in transforms))
    return "/tf_static", message


def log(tmp_path: Path, *parts: OnTopic | Iterable[OnTopic], dialect: str = "ros2") -> Path:
    messages: list[OnTopic] = []
    for part in parts:
        messages.extend([part] if isinstance(part, tuple) else part)  # type: ignore[list-item]
    return write_log(tmp_path / "log.mcap", messages, DIALECTS[dialect])


def stereo(tmp_path: Path, left: str, right: str, *more: OnTopic | Iterable[OnTopic]) -> Path:
    return log(
        tmp_path,
        images(left, "a"),
        images(right, "b"),
        calibration(f"{left.rpartition('/')[0]}/camera_info", "a"),
        calibration(f"{right.rpartition('/')[0]}/camera_info", "b"),
        fixed(("b", "a", CAM1_FROM_CAM0)),
        *more,
    )
