"""Camera topics of a log, and its ground truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import layouts
import numpy as np
import pytest
from camera_logs import CAM1_FROM_CAM0, FISHEYE, LENS, calibration, fixed, images, log, stereo
from mcap_logs import DIALECTS, write_log

from vo.base.config import load_config
from vo.base.errors import SourceError
from vo.base.geometry.transforms import inverse
from vo.recordings.formats.calibration.own import write_calibration
from vo.recordings.formats.messages import CompressedImageMessage, ImageMessage, Message
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FRAMES = 6


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("/cam0/image_raw", "/cam1/image_raw"),
        ("/stereo/left/image_raw", "/stereo/right/image_raw"),
        ("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"),
        ("/kitti/image_0/data", "/kitti/image_1/data"),
        ("/front_left/image", "/front_right/image"),
        ("/port/image", "/starboard/image"),
    ],
)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_left_and_right_are_recognised_by_name(
    tmp_path: Path, left: str, right: str, dialect: str
) -> None:
    path = log(
        tmp_path,
        images(right, "b"),
        images(left, "a"),
        calibration(f"{left.rpartition('/')[0]}/camera_info", "a"),
        calibration(f"{right.rpartition('/')[0]}/camera_info", "b"),
        fixed(("b", "a", CAM1_FROM_CAM0)),
        dialect=dialect,
    )
    rig = open_source(path).rig
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(rig.cam1_from_cam0, CAM1_FROM_CAM0, atol=1e-12)


def test_pair_is_found_beside_depth_topics_and_other_cameras(tmp_path: Path) -> None:
    path = stereo(
        tmp_path,
        "/camera/infra1/image_rect_raw",
        "/camera/infra2/image_rect_raw",
        images("/camera/depth/image_rect_raw"),
        images("/camera/color/image_raw"),
    )
    source = open_source(path)
    assert source.rig.is_stereo
    assert all(f.image1 is not None for f in source.frames())


def test_single_camera(tmp_path: Path) -> None:
    path = log(tmp_path, images("/camera/image_raw", "c"), calibration("/camera/camera_info", "c"))
    source = open_source(path)
    assert (source.rig.cam0, source.rig.is_stereo) == (LENS, False)


def test_uncompressed_topic_of_a_camera_is_preferred(tmp_path: Path) -> None:
    raw = list(images("/camera/image_raw", "c"))
    jpeg = cv2.imencode(".jpg", layouts.image(0))[1].tobytes()
    path = log(
        tmp_path,
        [
            ("/camera/image_raw/compressed", CompressedImageMessage(m.stamp_ns, "c", "jpeg", jpeg))
            for _, m in raw
        ],
        raw,
        calibration("/camera/camera_info", "c"),
    )
    frame = next(open_source(path).frames())
    assert np.array_equal(frame.image0, layouts.image(0))


@pytest.mark.parametrize(
    "text", ["jpeg", "bgr8; jpeg compressed bgr8", "mono8; png compressed ", ""]
)
def test_format_of_compressed_images_is_detected_from_the_content(
    tmp_path: Path, text: str
) -> None:
    kind = ".png" if "png" in text else ".jpg"
    smooth = cv2.GaussianBlur(layouts.image(0), (0, 0), 5)
    data = cv2.imencode(kind, smooth)[1].tobytes()
    path = log(
        tmp_path,
        [
            ("/camera/image_raw/compressed", CompressedImageMessage(stamp, "c", text, data))
            for stamp in layouts.STAMPS_NS
        ],
        calibration("/camera/camera_info", "c"),
    )
    frame = next(open_source(path).frames())
    assert np.abs(frame.image0.astype(int) - smooth).max() <= 6


def test_error_for_several_cameras_lists_them_with_options(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/front/image_raw", count=6),
        images("/rear/image_raw", count=3),
        images("/top/image_raw"),
    )
    with pytest.raises(SourceError) as caught:
        open_source(path)
    lines = str(caught.value).splitlines()
    assert "which of 3 cameras?" in lines[0]
    assert "`topics=left=/front/image_raw right=/rear/image_raw`" in lines[0]
    assert [line.split() for line in lines[1:]] == [
        ["/front/image_raw", "sensor_msgs/msg/Image", "6", "messages", "10.0", "Hz"],
        ["/rear/image_raw", "sensor_msgs/msg/Image", "3", "messages", "4.0", "Hz"],
        ["/top/image_raw", "sensor_msgs/msg/Image", "4", "messages", "6.0", "Hz"],
    ]


def test_topics_can_be_chosen(tmp_path: Path) -> None:
    path = stereo(
        tmp_path,
        "/front/image_raw",
        "/rear/image_raw",
        images("/top/image_raw", "c"),
        calibration("/top/camera_info", "c", FISHEYE),
    )
    pair = open_source(path, topics=["left=/front/image_raw", "right=/rear/image_raw"])
    assert pair.rig.is_stereo
    turned = open_source(path, topics=["right=front/image_raw", "left=rear/image_raw"])
    assert turned.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(turned.rig.cam1_from_cam0, inverse(CAM1_FROM_CAM0), atol=1e-12)
    single = open_source(path, topics=["/top/image_raw"])
    assert (single.rig.cam0, single.rig.is_stereo) == (FISHEYE, False)


@pytest.mark.parametrize(
    ("wishes", "reason"),
    [
        (
            ["/front/image_row"],
            "there is no topic /front/image_row; did you mean /front/image_raw?",
        ),
        (["middle=/front/image_raw"], "`topics=middle=/front/image_raw` is invalid"),
        (["right=/front/image_raw"], "requires `topics=left="),
        (["/front/image_raw", "left=/rear/image_raw"], "gives two topics for left"),
        (["left="], "is invalid"),
    ],
)
def test_error_for_wrong_topics(tmp_path: Path, wishes: list[str], reason: str) -> None:
    path = log(tmp_path, images("/front/image_raw"), images("/rear/image_raw", count=1))
    with pytest.raises(SourceError, match=reason):
        open_source(path, topics=wishes)


def test_error_for_topics_of_a_folder(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path / "folder")
    with pytest.raises(SourceError, match=r"\(folder\) has no topics; leave `topics` out"):
        open_source(tmp_path / "folder", topics=["/a"])


def test_error_for_a_log_without_images(tmp_path: Path) -> None:
    path = log(tmp_path, calibration("/camera/camera_info", "c"))
    with pytest.raises(SourceError, match="no topic has images of a known type.*\n.*info"):
        open_source(path)


@pytest.fixture(scope="module")
def expected(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    output = tmp_path_factory.mktemp("expected")
    run(synthetic_stereo, output, config=load_config("fast"), end=FRAMES)
    return (output / "trajectory.tum").read_bytes()


def messages(recording: Path, codec: str) -> Iterator[tuple[str, Message]]:
    for frame in open_source(recording).frames(end=FRAMES):
        for number, image in enumerate((frame.image0, frame.image1)):
            assert image is not None
            topic, name = f"/cam{number}/image_raw", f"cam{number}"
            height, width = image.shape
            if codec == "raw":
                data = image.tobytes()
                yield topic, ImageMessage(frame.stamp_ns, name, width, height, "mono8", data)
            else:
                data = cv2.imencode(".png", image)[1].tobytes()
                yield topic, CompressedImageMessage(frame.stamp_ns, name, "png", data)


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("codec", ["raw", "png"])
def test_mcap(
    synthetic_stereo: Path, expected: bytes, tmp_path: Path, dialect: str, codec: str
) -> None:
    log = write_log(tmp_path / "log.mcap", messages(synthetic_stereo, codec), DIALECTS[dialect])
    write_calibration(tmp_path / "rig.yaml", open_source(synthetic_stereo).rig)
    summary = run(
        log, tmp_path / "out", config=load_config("fast"), calibration=tmp_path / "rig.yaml"
    )
    assert (summary.tracked, summary.facts.format) == (FRAMES, "mcap")
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == expected
