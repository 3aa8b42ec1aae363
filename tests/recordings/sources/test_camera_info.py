"""Calibration messages as drivers write them: each is read rightly, or refused with the cause."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import layouts
import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from vo.base.errors import CalibrationError
from vo.base.types import Floats
from vo.recordings.formats.warning_kinds import LoggedWarning, collected_warnings
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import Recording

STORE = get_typestore(Stores.ROS2_HUMBLE)
FX, FY, CX, CY = layouts.INTRINSICS
K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1.0]])
EYE = np.eye(3)
NAN = np.full((3, 3), np.nan)
SIZE = (layouts.WIDTH, layouts.HEIGHT)


def of(name: str, *values: Any) -> Any:
    return STORE.types[name.replace("/", "/msg/")](*values)


def header(number: int, frame: str) -> Any:
    time = of("builtin_interfaces/Time", *divmod(layouts.STAMPS_NS[number], 10**9))
    return of("std_msgs/Header", time, frame)


def projection(last: float = 0.0, k: Floats = K) -> Floats:
    return np.column_stack([k, [last, 0, 0]])


RIGHT = projection(-FX * 0.12)


def info(  # noqa: PLR0913
    number: int,
    frame: str,
    p: Floats,
    *,
    k: Floats = K,
    r: Floats = EYE,
    d: Any = (0.0,) * 5,
    model: str = "plumb_bob",
    size: tuple[int, int] = SIZE,
    binning: int = 0,
    roi: tuple[int, int, int, int] = (0, 0, 0, 0),
) -> Any:
    region = of("sensor_msgs/RegionOfInterest", *roi, False)
    arrays = np.array(d, dtype=float), k.ravel() + 0.0, r.ravel() + 0.0, p.ravel() + 0.0
    return of(
        "sensor_msgs/CameraInfo", header(number, frame), *size[::-1], model, *arrays, binning,
        binning, region,
    )  # fmt: skip


def write(  # noqa: PLR0913
    path: Path,
    *,
    left: Any = None,
    right: Any = None,
    image: str = "image_raw",
    infos: tuple[str, str] = ("/left/camera_info", "/right/camera_info"),
    frames: tuple[str, str] = ("l", "r"),
    image_size: tuple[int, int] = SIZE,
    **both: Any,
) -> Path:
    """A pair of cameras; `left`, `right` and `both` are arguments of `info`."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channels: dict[str, int] = {}

        def add(topic: str, message: Any, number: int) -> None:
            kind = message.__msgtype__
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(message, kind))
            writer.add_message(channels[topic], number + 1, data, number + 1)

        for number in range(3):
            sides = (("left", left, projection()), ("right", right, RIGHT))
            for i, (side, own, p) in enumerate(sides):
                values = {"p": p, **both, **(own or {})}
                add(infos[i], info(number, frames[i], **values), number)
                width, height = image_size
                pixels = layouts.image(number, right=side == "right")[:height, :width].ravel()
                add(
                    f"/{side}/{image}",
                    of("sensor_msgs/Image", header(number, frames[i]), height, width, "mono8", 0,
                       width, np.ascontiguousarray(pixels)),
                    number,
                )  # fmt: skip
        writer.finish()
    return path


def opened(path: Path) -> tuple[Recording, list[LoggedWarning]]:
    with collected_warnings() as warnings:
        return open_source(path), warnings


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, (FX, FY, CX, CY, "none")),
        ({"k": K * 0, "image": "image_rect"}, (FX, FY, CX, CY, "none")),
        ({"infos": ("/a", "/b")}, (FX, FY, CX, CY, "none")),
        ({"infos": ("/left/image_raw/camera_info", "/b")}, (FX, FY, CX, CY, "none")),
        ({"binning": 1, "roi": (0, 0, SIZE[1], SIZE[0])}, (FX, FY, CX, CY, "none")),
        ({"binning": 2, "image_size": (32, 24)}, (FX / 2, FY / 2, CX / 2, CY / 2, "none")),
        (
            {"roi": (8, 4, 24, 32), "image_size": (32, 24)},
            (FX, FY, CX - 8, CY - 4, "none"),
        ),
        ({"model": "", "d": ()}, (FX, FY, CX, CY, "none")),
        ({"model": "pinhole"}, (FX, FY, CX, CY, "none")),
        ({"model": "Plumb Bob", "d": (0.01, 0, 0, 0, 0)}, (FX, FY, CX, CY, "radtan")),
        ({"model": "rational_polynomial", "d": (0.01,) + (0,) * 13}, (FX, FY, CX, CY, "radtan")),
        ({"model": "equidistant", "d": (0.01, 0, 0, 0, 0)}, (FX, FY, CX, CY, "equidistant")),
        ({"model": "fisheye", "d": (0.0,) * 5}, (FX, FY, CX, CY, "equidistant")),
    ],
)
def test_what_is_read(tmp_path: Path, values: Any, expected: tuple[Any, ...]) -> None:
    source, warnings = opened(write(tmp_path / "log.mcap", **values))
    camera = source.rig.cam0
    found = (camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion_model)
    assert found[4] == expected[4]
    np.testing.assert_allclose(found[:4], expected[:4])
    assert (camera.width, camera.height) == values.get("image_size", SIZE)
    assert source.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(source.rig.cam1_from_cam0[:3, 3], [-0.12, 0, 0], atol=1e-12)
    assert not warnings


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"k": K * 0}, "K is zero: the camera was never calibrated"),
        ({"k": EYE}, "focal length is 1, 1; .* in pixels"),
        ({"k": np.diag([0.5, 0.8, 1.0])}, "multiply one relative to the image by its size"),
        ({"k": K.T}, "transposed; write it row by row"),
        ({"left": {"p": projection() * np.nan}}, "R or P has numbers that are not finite"),
        ({"r": NAN}, "R or P has numbers that are not finite"),
        ({"r": 2 * EYE}, "the rotation is not orthonormal"),
        ({"d": (np.nan,) * 5}, "number 1 is nan"),
        ({"size": (0, 0)}, "whole numbers above 0"),
        ({"size": SIZE[::-1]}, "turned by 90 degrees"),
        ({"binning": 2}, "is for 32x24"),
        ({"model": "pinhole", "d": (0.01, 0, 0, 0, 0)}, "'pinhole' is not supported"),
        ({"infos": ("/a", "/b"), "frames": ("c", "c")}, "/a and /b both are of frame 'c'"),
    ],
)
def test_what_is_refused(tmp_path: Path, values: Any, reason: str) -> None:
    with pytest.raises(CalibrationError, match=f"{reason}(?s:.*)calibration|{reason}; give that"):
        open_source(write(tmp_path / "log.mcap", **values))


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ({"right": {"p": projection(FX * 0.12)}}, ["by P the camera is to the left of"]),
        ({"right": {"p": projection(-0.04)}}, ["is only 0.0008 m; .* -fx times that"]),
        ({"right": {"p": projection()}}, ["only the left camera is used: unknown pose of"]),
        (
            {"k": np.array([[FX, 0, 1.1 * SIZE[0]], [0, FY, CY], [0, 0, 1]])},
            ["of 'l': principal point", "of 'r': principal point"],
        ),
    ],
)
def test_what_is_doubted_is_said_once(tmp_path: Path, values: Any, texts: list[str]) -> None:
    warnings = opened(write(tmp_path / "log.mcap", **values))[1]
    assert len(warnings) == len(texts)
    for warning, text in zip(warnings, texts, strict=True):
        assert re.search(text, warning.text)
