"""Video in messages, encoded by FFmpeg."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import layouts
import numpy as np
import pytest
from av.video.codeccontext import VideoCodecContext
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vo.base.errors import SourceError
from vo.base.types import Bytes
from vo.recordings.sources.logs.video import is_keyframe
from vo.recordings.sources.registry import open_source

COUNT = 30
WIDTH, HEIGHT = 128, 96
PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
ROS_FIELDS = {
    "sensor_msgs/msg/CompressedImage": "string format\nuint8[] data",
    PACKET: (
        "int32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data"
    ),
}
STAMPS_NS = [1_600_000_000_000_000_000 + i * 33_333_333 for i in range(COUNT)]


def picture(index: int) -> Bytes:
    """A moving smooth scene, with a bright square whose position is the number of the frame."""
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH * 2), dtype=np.uint8)
    smooth = cv2.GaussianBlur(noise, (0, 0), 4)
    scene = cv2.normalize(smooth, None, 40, 200, cv2.NORM_MINMAX)[:, index : index + WIDTH].copy()
    scene[:16, 4 * index : 4 * index + 8] = 255
    return np.asarray(scene, dtype=np.uint8)


def packed(encoder: str, every: int = 10) -> Iterator[bytes]:
    """One message per frame, with parameter sets before each keyframe and without B-frames."""
    codec = av.CodecContext.create(encoder, "w")
    assert isinstance(codec, VideoCodecContext)
    codec.width, codec.height, codec.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    codec.framerate, codec.gop_size, codec.max_b_frames = 30, every, 0
    quiet = {"x265-params": "log-level=none:repeat-headers=1:bframes=0"}
    codec.options = {"crf": "12", "tune": "zerolatency", **(quiet if "265" in encoder else {})}
    for i in range(COUNT):
        frame = av.VideoFrame.from_ndarray(picture(i), format="gray").reformat(format="yuv420p")
        frame.pts = i
        yield from (bytes(packet) for packet in codec.encode(frame))
    yield from (bytes(packet) for packet in codec.encode(None))


def write(path: Path, messages: list[bytes], name: str, kind: Any = CompressedVideo) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        definition = build_file_descriptor_set(kind).SerializeToString()
        schema = writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", definition)
        channel = writer.register_channel("/camera/video", "protobuf", schema)
        for stamp, data in zip(STAMPS_NS, messages, strict=True):
            message = kind(frame_id="c", data=data, format=name)
            message.timestamp.FromNanoseconds(stamp)
            writer.add_message(channel, stamp, message.SerializeToString(), stamp)
        writer.finish()
    return with_calibration(path)


def write_ros(path: Path, messages: list[bytes], names: list[str], kind: str) -> Path:
    """As `write` in a message type of ROS 2, without a definition as before ROS 2 Iron."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    if kind not in store.types:
        store.register(get_types_from_msg(f"std_msgs/Header header\n{ROS_FIELDS[kind]}", kind))
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema(kind, "ros2msg", b"")
        channel = writer.register_channel("/camera/video", "cdr", schema)
        for stamp, data, name in zip(STAMPS_NS, messages, names, strict=False):
            time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
            header = store.types["std_msgs/msg/Header"](time, "c")
            array = np.frombuffer(data, dtype=np.uint8)
            fields = (WIDTH, HEIGHT, name, 0, 0, False, array) if kind == PACKET else (name, array)
            message = store.serialize_cdr(store.types[kind](header, *fields), kind)
            writer.add_message(channel, stamp, bytes(message), stamp)
        writer.finish()
    return with_calibration(path)


def with_calibration(path: Path) -> Path:
    text = layouts.CALIBRATION.replace("[64, 48]", f"[{WIDTH}, {HEIGHT}]")
    layouts.write_text(path.with_suffix(".yaml"), text)
    return path


@pytest.fixture(scope="module", params=[("libx264", "h264"), ("libx265", "h265")])
def video(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    encoder, name = request.param
    folder = tmp_path_factory.mktemp("video")
    return write(folder / "log.mcap", list(packed(encoder)), name)


def differs(image: Bytes, index: int) -> float:
    return float(np.abs(image.astype(int) - picture(index)).mean())


def test_frames_in_order(video: Path) -> None:
    frames = list(open_source(video, calibration=video.with_suffix(".yaml")).frames())
    assert [frame.stamp_ns for frame in frames] == STAMPS_NS
    for frame in frames:
        # Grey in limited range is what an encoder keeps of it; the square tells which it is.
        assert differs(frame.image0, frame.index) < 12
        other = (frame.index + 3) % COUNT
        assert differs(frame.image0, frame.index) < differs(frame.image0, other)


@pytest.mark.parametrize(("start", "stride"), [(0, 7), (13, 1), (25, 2), (9, 12)])
def test_frames_from_the_middle(video: Path, start: int, stride: int) -> None:
    source = open_source(video, calibration=video.with_suffix(".yaml"))
    whole = {frame.index: frame.image0 for frame in source.frames()}
    for frame in source.frames(start=start, stride=stride):
        assert np.array_equal(frame.image0, whole[frame.index])


def test_frames_before_the_first_key_frame_are_skipped(tmp_path: Path) -> None:
    messages = list(packed("libx264"))
    path = write(tmp_path / "log.mcap", messages[3:] + messages[:3], "h264")
    source = open_source(path, calibration=path.with_suffix(".yaml"))
    frames = list(source.frames())
    assert [s.index for s in source.skipped] == list(range(7))
    assert "there is no key frame before it" in source.skipped[0].reason
    assert frames[0].index == 7


def test_damage_loses_frames_up_to_the_next_keyframe(tmp_path: Path) -> None:
    messages = list(packed("libx264"))
    messages[12] = messages[12][: len(messages[12]) // 3]
    path = write(tmp_path / "log.mcap", messages, "h264")
    frames = list(open_source(path, calibration=path.with_suffix(".yaml")).frames())
    good = [frame.index for frame in frames if differs(frame.image0, frame.index) < 12]
    assert set(good) >= {*range(12), *range(20, 30)}


def test_error_names_unsupported_codecs(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", [b"\x12\x00"] * COUNT, "av1")
    with pytest.raises(SourceError, match="none of 30 images can be read.*'av1'; h264 and h265"):
        open_source(path, calibration=path.with_suffix(".yaml"))


@pytest.mark.parametrize(
    ("encoder", "name"),
    [("libx264", "h264"), ("libx265", "h265"), ("libx264", "jpeg"), ("libx265", "")],
)
def test_video_in_images_of_foxglove(tmp_path: Path, encoder: str, name: str) -> None:
    path = write(tmp_path / "log.mcap", list(packed(encoder)), name, CompressedImage)
    frames = list(open_source(path, calibration=path.with_suffix(".yaml")).frames())
    assert [frame.stamp_ns for frame in frames] == STAMPS_NS
    assert all(differs(frame.image0, frame.index) < 12 for frame in frames)


def test_error_says_what_an_image_in_a_message_is(tmp_path: Path) -> None:
    heic = b"\0\0\0\x18ftypheic" + bytes(99)
    path = write(tmp_path / "log.mcap", [heic] * COUNT, "", CompressedImage)
    with pytest.raises(SourceError, match="is a HEIC image: only JPEG, PNG and such are read$"):
        open_source(path, calibration=path.with_suffix(".yaml"))


def test_error_names_the_format_of_images_of_foxglove(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", [b"\x12\x00" * 99] * COUNT, "av1", CompressedImage)
    with pytest.raises(SourceError, match="gives the format 'av1'"):
        open_source(path, calibration=path.with_suffix(".yaml"))


@pytest.mark.parametrize("kind", ROS_FIELDS)
@pytest.mark.parametrize(
    ("encoder", "name"),
    [
        ("libx264", "h264"),
        ("libx264", "avc"),
        ("libx264", "libx264"),
        ("libx265", "hevc"),
        ("libx265", "H265"),
        ("libx265", "hevc_nvenc;yuv420p;bgr8;bgr8"),
    ],
)
def test_video_in_messages_of_ros(tmp_path: Path, kind: str, encoder: str, name: str) -> None:
    path = write_ros(tmp_path / "log.mcap", list(packed(encoder)), [name] * COUNT, kind)
    frames = list(open_source(path, calibration=path.with_suffix(".yaml")).frames())
    assert [frame.stamp_ns for frame in frames] == STAMPS_NS
    assert all(differs(frame.image0, frame.index) < 12 for frame in frames)


@pytest.mark.parametrize(
    ("kind", "name", "expected"),
    [
        ("sensor_msgs/msg/CompressedImage", "nv12", r"not an image \(.*gives the format 'nv12'\)"),
        ("sensor_msgs/msg/CompressedImage", "bgr8; jpeg compressed bgr8", "not an image$"),
        (PACKET, "libsvtav1", "'libsvtav1'; h264 and h265"),
    ],
)
def test_error_names_the_format_of_messages_of_ros(
    tmp_path: Path, kind: str, name: str, expected: str
) -> None:
    pixels = bytes(picture(0)) * 3
    path = write_ros(tmp_path / "log.mcap", [pixels] * COUNT, [name] * COUNT, kind)
    with pytest.raises(SourceError, match=f"none of 30 images can be read.*{expected}"):
        open_source(path, calibration=path.with_suffix(".yaml"))


@pytest.mark.parametrize("is_video_first", [True, False])
def test_images_and_video_in_one_topic_are_not_mixed(tmp_path: Path, is_video_first: bool) -> None:
    video = list(packed("libx264"))
    png = [cv2.imencode(".png", picture(i))[1].tobytes() for i in range(COUNT)]
    first, second = (video, png) if is_video_first else (png, video)
    names = ["h264" if is_video_first else "png"] * 20 + ["png" if is_video_first else "h264"] * 10
    kind = "sensor_msgs/msg/CompressedImage"
    path = write_ros(tmp_path / "log.mcap", first[:20] + second[20:], names, kind)
    source = open_source(path, calibration=path.with_suffix(".yaml"))
    assert [frame.index for frame in source.frames()] == list(range(20))
    assert [each.index for each in source.skipped] == list(range(20, 30))


@pytest.mark.parametrize(
    ("data", "codec", "alone"),
    [
        (b"\x00\x00\x00\x01\x67\x42", "h264", True),
        (b"\x00\x00\x01\x09\xf0\x00\x00\x01\x65", "h264", True),
        (b"\x00\x00\x01\x41\x9a", "h264", False),
        (b"\x00\x00\x01\x40\x01", "h265", True),
        (b"\x00\x00\x01\x26\x01", "h265", True),
        (b"\x00\x00\x01\x02\x01", "h265", False),
        (b"", "h264", False),
        (b"\x00\x00\x01", "h264", False),
    ],
)
def test_keyframes_are_detected(data: bytes, codec: str, alone: bool) -> None:
    assert is_keyframe(data, codec) == alone
