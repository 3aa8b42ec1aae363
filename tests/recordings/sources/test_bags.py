"""ROS bags: compression, several files, crashes and damage; written by `rosbags`."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import layouts
import numpy as np
import pytest
from bag_logs import Packed1, write_bag1, write_bag2
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from vo.base.errors import SourceError, VoError
from vo.recordings.sources.registry import open_source

PACKED1 = [None, *Packed1]
PACKED2 = [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE]


def check_whole(path: Path) -> None:
    source = open_source(path)
    assert source.rig.is_stereo
    frames = list(source.frames())
    assert [f.stamp_ns for f in frames] == layouts.STAMPS_NS
    for i, frame in enumerate(frames):
        assert np.array_equal(frame.image0, layouts.image(i))
        assert frame.image1 is not None
        assert np.array_equal(frame.image1, layouts.image(i, right=True))
    truth = source.ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_from_cam, layouts.truth(), atol=1e-9)


@pytest.mark.parametrize("codec", ["mono8", "png"])
@pytest.mark.parametrize("compression", PACKED1)
def test_ros1_with_each_compression(
    tmp_path: Path, compression: Packed1 | None, codec: str
) -> None:
    write_bag1(tmp_path / "a.bag", layouts.log_messages(codec), compression)
    check_whole(tmp_path / "a.bag")


@pytest.mark.parametrize("codec", ["mono8", "png"])
@pytest.mark.parametrize("compression", PACKED2)
def test_ros2_sqlite_with_each_compression(
    tmp_path: Path, compression: CompressionMode, codec: str
) -> None:
    write_bag2(tmp_path / "bag", layouts.log_messages(codec), StoragePlugin.SQLITE3, compression)
    check_whole(tmp_path / "bag")


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_ros2_without_message_definitions(tmp_path: Path, plugin: StoragePlugin) -> None:
    """The layout of Foxy, Galactic and Humble."""
    bag = write_bag2(tmp_path / "bag", layouts.log_messages("mono8"), plugin)
    for file in bag.glob("*.db3"):
        with sqlite3.connect(file) as database:
            database.execute("DROP TABLE message_definitions")
            database.execute("UPDATE schema SET schema_version = 3, ros_distro = 'humble'")
    for file in bag.glob("*.mcap"):
        _remove_definitions(file)
    check_whole(bag)


def _remove_definitions(path: Path) -> None:
    """Write an MCAP file again, with schemas that have only a name."""
    with path.open("rb") as old, path.with_suffix(".new").open("wb") as new:
        writer = McapWriter(new)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, "", b"")
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    path.with_suffix(".new").rename(path)


@pytest.mark.parametrize(
    "compression", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.STORAGE]
)
def test_ros2_mcap(tmp_path: Path, compression: CompressionMode) -> None:
    write_bag2(tmp_path / "bag", layouts.log_messages("mono8"), StoragePlugin.MCAP, compression)
    assert open_source(tmp_path / "bag").format == "rosbag2"
    check_whole(tmp_path / "bag")


def test_error_for_ros2_mcap_with_compressed_messages(tmp_path: Path) -> None:
    write_bag2(
        tmp_path / "bag", layouts.log_messages("mono8"), StoragePlugin.MCAP, CompressionMode.MESSAGE
    )
    with pytest.raises(SourceError, match="individually compressed messages, which are not"):
        open_source(tmp_path / "bag")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_ros2_without_metadata_as_after_a_crash(
    tmp_path: Path, plugin: StoragePlugin, caplog: pytest.LogCaptureFixture
) -> None:
    write_bag2(tmp_path / "bag_0", layouts.log_messages("mono8"), plugin)
    (tmp_path / "bag_0/metadata.yaml").unlink()
    for path in (tmp_path / "bag_0").iterdir():
        path.rename(path.with_name(f"run_0{path.suffix}"))
    check_whole(tmp_path / "bag_0")
    assert "has no metadata.yaml, as after a crash" in caplog.text


def test_ros2_single_file(tmp_path: Path) -> None:
    write_bag2(tmp_path / "bag", layouts.log_messages())
    file = next((tmp_path / "bag").glob("*.db3"))
    check_whole(Path(shutil.move(file, tmp_path / "alone.db3")))


def test_ros2_with_several_files(tmp_path: Path) -> None:
    """The second half of the messages is in a second file, as after a split."""
    write_bag2(tmp_path / "bag", layouts.log_messages())
    first = next((tmp_path / "bag").glob("*.db3"))
    second = first.with_name("bag_1.db3")
    shutil.copy(first, second)
    for file, half in ((first, ">"), (second, "<=")):
        with sqlite3.connect(file) as database:
            middle = "(SELECT MAX(id) / 2 FROM messages)"
            database.execute(f"DELETE FROM messages WHERE id {half} {middle}")
        database.close()
    text = (tmp_path / "bag/metadata.yaml").read_text()
    listed = text.replace(f"- {first.name}", f"- {first.name}\n  - {second.name}")
    assert second.name in listed
    (tmp_path / "bag/metadata.yaml").write_text(listed)
    check_whole(tmp_path / "bag")


def test_ros2_with_invalid_metadata(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_bag2(tmp_path / "bag", layouts.log_messages())
    (tmp_path / "bag/metadata.yaml").write_text("[")
    check_whole(tmp_path / "bag")
    assert "metadata.yaml cannot be read" in caplog.text


def test_ros2_folder_without_files(tmp_path: Path) -> None:
    write_bag2(tmp_path / "bag", layouts.log_messages())
    next((tmp_path / "bag").glob("*.db3")).unlink()
    with pytest.raises(SourceError, match="has no .db3 or .mcap file"):
        open_source(tmp_path / "bag")


@pytest.mark.parametrize("side", ["left", "right"])
def test_topics_can_be_chosen(tmp_path: Path, side: str) -> None:
    write_bag1(tmp_path / "a.bag", layouts.log_messages(), None)
    topic = f"/cam{int(side == 'right')}/image_raw"
    frame = next(iter(open_source(tmp_path / "a.bag", topics=[topic]).frames()))
    assert np.array_equal(frame.image0, layouts.image(0, right=side == "right"))
    assert frame.image1 is None


def test_ros1_truncated(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The index at the end is missing, and the last chunk or a part of it."""
    path = tmp_path / "a.bag"
    write_bag1(path, layouts.log_messages(), None)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    source = open_source(path)
    frames = list(source.frames())
    assert 2 <= len(frames) < layouts.COUNT
    assert [f.stamp_ns for f in frames] == layouts.STAMPS_NS[: len(frames)]
    for i, frame in enumerate(frames):
        assert np.array_equal(frame.image0, layouts.image(i))
    assert "it is cut off" in caplog.text
    assert "messages in" in caplog.text


def test_ros1_without_index_is_complete(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The bag ends after a chunk, as when the recorder is killed."""
    path = tmp_path / "a.bag.active"
    write_bag1(path, layouts.log_messages(), None)
    data = path.read_bytes()
    index_at = int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")
    path.write_bytes(data[:index_at])
    check_whole(path)
    assert "its index is missing" in caplog.text


@pytest.mark.parametrize("kind", ["a.bag", "bag"])
def test_damaged_bags_give_frames_or_one_error(tmp_path: Path, kind: str) -> None:
    """Cuts and wrong bytes at random positions give a VoError, or intact frames."""
    path = tmp_path / kind
    write = layouts.write_rosbag1 if kind == "a.bag" else layouts.write_rosbag2
    write(path)
    file = path if path.is_file() else next(path.glob("*.db3"))
    whole = file.read_bytes()
    rng = np.random.default_rng(5)
    opened = 0
    for trial in range(60):
        data = bytearray(whole)
        at = int(rng.integers(0, len(data)))
        if trial % 2:
            data = data[:at]
        else:
            data[at] ^= int(rng.integers(1, 256))
        file.write_bytes(data)
        try:
            source = open_source(path, mode="mono")
            stamps = [frame.stamp_ns for frame in source.frames()]
        except VoError:
            continue
        opened += 1
        assert stamps == sorted(set(stamps))
        assert len(stamps) <= layouts.COUNT
    assert opened >= 20


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V1.2\n", b"something else"])
def test_error_for_files_that_are_not_bags(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.bag").write_bytes(content)
    with pytest.raises(SourceError, match="a ROS 1 bag of version 2.0 begins with"):
        open_source(tmp_path / "a.bag")
    (tmp_path / "a.db3").write_bytes(content or b"x" * 100)
    with pytest.raises(SourceError, match="cannot be read as a ROS 2 bag"):
        open_source(tmp_path / "a.db3")
