"""`vo calibrate` on each kind of recording, all without calibration."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from board_images import poses_around, render
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Bytes, Camera, Frame
from vo.cli.app import app
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import CompressedImageMessage, Dialect, ImageMessage, Message
from vo.recordings.formats.ros2 import ROS2
from vo.recordings.sources.uncalibrated import open_uncalibrated
from vo.tools.calibrating.board import make_board
from vo.tools.calibrating.detection import detect
from vo.tools.calibrating.views import least_motion_frames

SIZE = (320, 240)
LEFT = Camera(*SIZE, 230.0, 229.0, 162.0, 118.0, "radtan", (-0.1, 0.02, 0.0, 0.0))
RIGHT = Camera(*SIZE, 231.0, 230.0, 158.0, 121.0, "radtan", (-0.11, 0.02, 0.0, 0.0))
CAM1_FROM_CAM0 = make_transform(so3_exp(np.array([0.0, -0.01, 0.0])), np.array([-0.08, 0.0, 0.0]))
BOARD = make_board("charuco", 5, 4, 0.04)
OPTIONS = ["--board", "charuco", "--columns", "5", "--rows", "4", "--square", "0.04"]
COUNT = 12
STAMPS_NS = [1_600_000_000_000_000_000 + 200_000_000 * i for i in range(COUNT)]
Pairs = list[tuple[Bytes, Bytes]]


@pytest.fixture(scope="module")
def pairs() -> Pairs:
    poses = poses_around(BOARD, LEFT, COUNT)
    return [
        (render(BOARD, LEFT, pose), render(BOARD, RIGHT, CAM1_FROM_CAM0 @ pose)) for pose in poses
    ]


def raw(pairs: Pairs) -> Iterator[tuple[str, Message]]:
    for stamp, pair in zip(STAMPS_NS, pairs, strict=True):
        for topic, pixels in zip(("/port/image", "/starboard/image"), pair, strict=True):
            yield topic, ImageMessage(stamp, "camera", *SIZE, "mono8", pixels.tobytes())


def compressed(pairs: Pairs) -> Iterator[tuple[str, Message]]:
    for stamp, pair in zip(STAMPS_NS, pairs, strict=True):
        for topic, pixels in zip(("/port/image", "/starboard/image"), pair, strict=True):
            data = cv2.imencode(".jpg", pixels)[1].tobytes()
            yield topic, CompressedImageMessage(stamp, "camera", "jpeg", data)


def write_mcap(path: Path, messages: Iterator[tuple[str, Message]], dialect: Dialect) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile=dialect.profile)
        channels: dict[str, int] = {}
        for topic, message in messages:
            if topic not in channels:
                schema = dialect.schema(type(message))
                known = writer.register_schema(
                    schema.name, dialect.schema_encoding, schema.definition
                )
                channels[topic] = writer.register_channel(topic, dialect.message_encoding, known)
            stamp = message.stamp_ns
            writer.add_message(channels[topic], stamp, dialect.encode(message), stamp)
        writer.finish()


def write_bag(path: Path, pairs: Pairs) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with BagWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {}
        for topic, message in raw(pairs):
            kind = ROS2.schema(type(message)).name
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], message.stamp_ns, ROS2.encode(message))


def write_euroc(path: Path, pairs: Pairs) -> None:
    for camera in (0, 1):
        folder = path / "mav0" / f"cam{camera}"
        (folder / "data").mkdir(parents=True)
        rows = "".join(f"{stamp},{stamp}.png\n" for stamp in STAMPS_NS)
        (folder / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}")
        for stamp, pair in zip(STAMPS_NS, pairs, strict=True):
            cv2.imwrite(str(folder / "data" / f"{stamp}.png"), pair[camera])


def write_kitti(path: Path, pairs: Pairs) -> None:
    for camera in (0, 1):
        (path / f"image_{camera}").mkdir(parents=True)
        for i, pair in enumerate(pairs):
            cv2.imwrite(str(path / f"image_{camera}" / f"{i:06}.png"), pair[camera])
    (path / "times.txt").write_text("".join(f"{0.2 * i:.1f}\n" for i in range(COUNT)))


def write_video(path: Path, images: list[Bytes], held: int = 1) -> None:
    """Write a video of 30 frames per second that repeats each image `held` times."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.options = {"crf": "10"}
        for pixels in np.repeat(images, held, axis=0):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="gray")))
        container.mux(stream.encode())


WRITERS: dict[str, Callable[[Path, Pairs], None]] = {
    "ros2.mcap": lambda path, pairs: write_mcap(path, raw(pairs), ROS2),
    "foxglove.mcap": lambda path, pairs: write_mcap(path, raw(pairs), FOXGLOVE),
    "compressed.mcap": lambda path, pairs: write_mcap(path, compressed(pairs), ROS2),
    "bag": write_bag,
    "euroc": write_euroc,
    "kitti": write_kitti,
    "video.mp4": lambda path, pairs: write_video(path, [left for left, _ in pairs]),
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_board_is_detected_in_every_kind_of_recording(
    name: str, pairs: Pairs, tmp_path: Path
) -> None:
    WRITERS[name](tmp_path / name, pairs)
    topics = ["left=/port/image", "right=/starboard/image"] if name.endswith(("mcap", "g")) else []
    source = open_uncalibrated(tmp_path / name, topics=topics)
    assert source.rig.is_stereo == (name != "video.mp4")
    frames = list(source.frames())
    assert len(frames) == COUNT
    sides = [frames[1].image0] + ([frames[1].image1] if source.rig.is_stereo else [])
    for image, expected in zip(sides, pairs[1], strict=False):
        found, known = detect(BOARD, image), detect(BOARD, expected)
        assert found is not None and known is not None
        _, i, j = np.intersect1d(found.ids, known.ids, return_indices=True)
        assert len(i) >= 15
        assert np.abs(found.xy[i] - known.xy[j]).max() < 0.5


def test_a_pair_from_a_log_with_unusual_topic_names(pairs: Pairs, tmp_path: Path) -> None:
    log, output = tmp_path / "board.mcap", tmp_path / "calibration.yaml"
    write_mcap(log, compressed(pairs), FOXGLOVE)
    topics = ["--topic", "left=/port/image", "--topic", "right=/starboard/image"]
    words = ["calibrate", str(log), *OPTIONS, *topics, "--model", "radtan", "-o", str(output)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.stderr
    rig = read_calibration(output, None).rig
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    assert rig.cam0.fx == pytest.approx(LEFT.fx, rel=0.01)
    assert np.linalg.norm(rig.cam1_from_cam0[:3, 3]) == pytest.approx(0.08, rel=0.01)
    text = output.read_text()
    assert "# cam0: radtan" in text and "standard deviations: fx" in text
    assert "translation" in text


def test_a_board_held_still_gives_one_view(pairs: Pairs, tmp_path: Path) -> None:
    video, output = tmp_path / "board.mp4", tmp_path / "calibration.yaml"
    write_video(video, [left for left, _ in pairs], held=8)
    words = ["calibrate", str(video), *OPTIONS, "--model", "radtan", "-o", str(output), "--json"]
    result = CliRunner().invoke(app, [*words, "--look-at", "24"])
    assert result.exit_code == 0, result.stderr
    figures = json.loads(result.stdout)
    assert figures["frames"] == 24  # of 96, every fourth
    assert figures["views"] <= COUNT
    assert figures["cam0"]["parameters"]["fx"]["value"] == pytest.approx(LEFT.fx, rel=0.02)


def test_the_frame_with_the_least_motion_of_each_group_is_chosen() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 128), dtype=np.uint8)
    smooth = cv2.GaussianBlur(noise, (0, 0), 8.0) * 4
    shifts = [0, 8, 9, 10, 20, 30, 40, 40, 50, 51]
    frames = [Frame(i, i, (np.roll(smooth, shift, axis=1),)) for i, shift in enumerate(shifts)]
    # Frame 7 is a copy of frame 6, which is in motion.
    assert [frame.index for frame in least_motion_frames(frames, 5)] == [2, 9]
    assert [frame.index for frame in least_motion_frames(frames, 1)] == list(range(10))
