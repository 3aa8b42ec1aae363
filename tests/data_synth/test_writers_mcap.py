"""MCAP recordings, read back by independent software."""

from __future__ import annotations

import resource
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_dialects import FOXGLOVE, ROS2, Dialect, matrix, quat_transform, read, transforms, write
from recordings import (
    BODY_FROM_CAM0,
    CAM1_FROM_CAM0,
    FISHEYE,
    FRAMES,
    RADTAN,
    STEREO_DROPS,
    make_recording,
    make_shots,
)
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability

from data_synth.records import Shot
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera

RERUN = Path(sys.executable).with_name("rerun")


@pytest.fixture(params=[FOXGLOVE, ROS2], ids=["foxglove", "ros2"])
def dialect(request: pytest.FixtureRequest) -> Dialect:
    return request.param  # type: ignore[no-any-return]


@pytest.mark.parametrize("codec", ["raw", "png"])
def test_images_and_stamps_are_those_rendered(dialect: Dialect, codec: str, tmp_path: Path) -> None:
    recording = make_recording()
    path = write(dialect, tmp_path / "a.mcap", recording, codec)
    for camera in (0, 1):
        name = f"/cam{camera}/image_raw" + ("" if codec == "raw" else "/compressed")
        messages = read(dialect, path, name)
        kept = [i for i in range(FRAMES) if i not in STEREO_DROPS[camera]]
        stamps = recording.stamps_ns[camera][kept].tolist()
        assert [log_time for log_time, _ in messages] == stamps
        assert [dialect.stamp_ns(message) for _, message in messages] == stamps
        shots = list(make_shots(recording))
        for frame, (_, message) in zip(kept, messages, strict=True):
            assert dialect.frame(message) == f"cam{camera}"
            np.testing.assert_array_equal(_pixels(message, codec), shots[frame].images[camera])


def _pixels(message: Any, codec: str) -> Any:
    data = np.frombuffer(message.data, dtype=np.uint8)
    if codec == "raw":
        assert (message.encoding, message.step) == ("mono8", message.width)
        return data.reshape(message.height, message.width)
    assert message.format == codec
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)


def test_jpeg_images_are_close_to_those_rendered(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording(stereo=False, drops=((),))
    ramp = np.add.outer(np.arange(32), 4 * np.arange(48)).astype(np.uint8)
    shots = (Shot(i, (ramp,)) for i in range(FRAMES))
    dialect.write(tmp_path / "a.mcap", recording, shots, "jpeg")
    messages = read(dialect, tmp_path / "a.mcap", "/cam0/image_raw/compressed")
    assert len(messages) == FRAMES
    assert np.abs(_pixels(messages[0][1], "jpeg") - ramp.astype(float)).max() <= 4.0


def test_each_image_of_cam0_has_a_depth_image(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording()
    path = write(dialect, tmp_path / "a.mcap", recording)
    images, depths = (read(dialect, path, f"/cam0/{x}") for x in ("image_raw", "depth"))
    assert [t for t, _ in depths] == [t for t, _ in images]
    last = list(make_shots(recording))[-1].depth
    message = depths[-1][1]
    assert message.encoding == "32FC1"
    pixels = np.frombuffer(message.data, "<f4").reshape(message.height, message.width)
    np.testing.assert_array_equal(pixels, last)
    assert np.isinf(pixels[0]).all()


def test_transforms_lead_from_the_world_to_each_camera(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording()
    path = write(dialect, tmp_path / "a.mcap", recording)
    fixed, moving = (transforms(dialect, path, topic) for topic in ("/tf_static", "/tf"))
    assert list(fixed) == [("body", "cam0"), ("cam0", "cam1")]
    assert list(moving) == [("world", "body"), ("world", "walker")]
    world_from_cam0 = np.array(moving["world", "body"]) @ fixed["body", "cam0"][0]
    truth = recording.cam0_truth
    np.testing.assert_allclose(world_from_cam0, truth.world_from_cam, rtol=0, atol=1e-9)
    world_from_cam1 = world_from_cam0 @ fixed["cam0", "cam1"][0]
    expected = truth.world_from_cam @ inverse(CAM1_FROM_CAM0)
    np.testing.assert_allclose(world_from_cam1, expected, rtol=0, atol=1e-9)
    walker = recording.movers[0].world_from_mover
    np.testing.assert_allclose(moving["world", "walker"], walker, rtol=0, atol=1e-9)
    assert [t for t, _ in read(dialect, path, "/tf")] == truth.stamps_ns.tolist()
    np.testing.assert_allclose(fixed["body", "cam0"][0], BODY_FROM_CAM0, rtol=0, atol=1e-12)


def test_inertial_samples_and_true_poses_are_exact(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording()
    path = write(dialect, tmp_path / "a.mcap", recording)
    imu, truth = recording.imu, recording.body_truth
    assert imu is not None
    samples = read(dialect, path, "/imu0")
    assert [dialect.stamp_ns(m) for _, m in samples] == imu.stamps_ns.tolist()
    for name, expected in (("angular_velocity", imu.gyro), ("linear_acceleration", imu.accel)):
        vectors = [getattr(m, name) for _, m in samples]
        np.testing.assert_array_equal([(v.x, v.y, v.z) for v in vectors], expected)
    if dialect is ROS2:
        # Continuous noise of 1.7e-4 rad/s/√Hz and 2e-3 m/s²/√Hz, sampled at 200 Hz.
        first = samples[0][1]
        assert first.angular_velocity_covariance[0] == pytest.approx(1.7e-4**2 * 200)
        assert first.linear_acceleration_covariance[8] == pytest.approx(2e-3**2 * 200)
    poses = read(dialect, path, "/truth/pose")
    assert [t for t, _ in poses] == truth.stamps_ns.tolist()
    assert {dialect.frame(m) for _, m in poses} == {"world"}
    read_poses = [quat_transform(m.pose.position, m.pose.orientation) for _, m in poses]
    np.testing.assert_allclose(read_poses, truth.world_from_body, rtol=0, atol=1e-12)


@pytest.mark.parametrize("camera", [RADTAN, FISHEYE], ids=["radtan", "fisheye"])
def test_calibration_rectifies_as_the_odometry_does(
    dialect: Dialect, camera: Camera, tmp_path: Path
) -> None:
    recording = make_recording(camera)
    path = write(dialect, tmp_path / "a.mcap", recording)
    working = rectified_rig(recording.rig)
    point = np.array([0.3, -0.2, 4.0])
    rows, depth_rays = [], []
    for number, cam_from_cam0 in enumerate((np.eye(4), CAM1_FROM_CAM0)):
        stamps_and_messages = read(dialect, path, f"/cam{number}/camera_info")
        images = read(dialect, path, f"/cam{number}/image_raw")
        assert [t for t, _ in stamps_and_messages] == [t for t, _ in images]
        k, r, p = (matrix(stamps_and_messages[0][1], name) for name in "KRP")
        np.testing.assert_array_equal(k, camera.matrix)
        # CameraInfo: a point in rectified cam0 is projected by the P of either camera.
        in_cam = cam_from_cam0[:3, :3] @ point + cam_from_cam0[:3, 3]
        seen_by_turning = p[:, :3] @ (r @ in_cam)
        left_r = matrix(read(dialect, path, "/cam0/camera_info")[0][1], "R")
        seen_by_p = p @ np.append(left_r @ point, 1.0)
        np.testing.assert_allclose(
            seen_by_turning[:2] / seen_by_turning[2], seen_by_p[:2] / seen_by_p[2], atol=1e-9
        )
        rows.append(seen_by_p[1] / seen_by_p[2])
        depth_rays.append((seen_by_p[0] / seen_by_p[2], seen_by_p[2]))
    assert rows[0] == pytest.approx(rows[1], abs=1e-9)
    disparity = depth_rays[0][0] - depth_rays[1][0]
    assert disparity * depth_rays[0][1] == pytest.approx(working.fx * working.baseline_m, rel=1e-9)


def test_mono_calibration_is_unrectified(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording(stereo=False, drops=((),))
    path = write(dialect, tmp_path / "a.mcap", recording)
    message = read(dialect, path, "/cam0/camera_info")[0][1]
    np.testing.assert_array_equal(matrix(message, "R"), np.eye(3))
    np.testing.assert_array_equal(matrix(message, "P")[:, :3], RADTAN.matrix)
    assert list(transforms(dialect, path, "/tf_static")) == [("body", "cam0")]


def test_messages_are_in_order_of_time(dialect: Dialect, tmp_path: Path) -> None:
    path = write(dialect, tmp_path / "a.mcap", make_recording())
    with path.open("rb") as stream:
        reader = make_reader(stream)
        in_file = [
            (channel.topic, message)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        summary = reader.get_summary()
    times = [message.log_time for _, message in in_file]
    assert times == sorted(times)
    assert all(message.publish_time == message.log_time for _, message in in_file)
    assert in_file[0][0] == "/tf_static"
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(in_file) == 1 + 70 + 70 + 7 + 3 * 6 + 2 * 5
    assert {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()} == (
        dialect.schemas
    )
    assert [index.compression for index in summary.chunk_indexes] == ["zstd"]


@pytest.mark.parametrize("stereo", [False, True], ids=["mono", "stereo"])
def test_file_without_inertial_sensor_and_depth_has_no_such_topics(
    dialect: Dialect, stereo: bool, tmp_path: Path
) -> None:
    recording = make_recording(stereo=stereo, inertial=False, depth=False)
    path = write(dialect, tmp_path / "a.mcap", recording)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    absent = {"/imu0", "/cam0/depth"} | (set() if stereo else {"/cam1/image_raw"})
    assert "/truth/pose" in topics and "/cam0/image_raw" in topics
    assert not topics & absent


def test_metadata_describes_the_recording(dialect: Dialect, tmp_path: Path) -> None:
    path = write(dialect, tmp_path / "a.mcap", make_recording())
    with path.open("rb") as stream:
        reader = make_reader(stream)
        header = reader.get_header()
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert header.library.startswith("vo ")
    assert header.profile == ("ros2" if dialect is ROS2 else "")
    about = {"name": "small", "generator": header.library, "frames": "7", "fps": "20.0"}
    assert records["recording"] == about
    assert records["imu0"]["gyro_noise"] == "0.00017"
    assert records["imu0"]["rate_hz"] == "200.0"


@pytest.mark.parametrize("codec", ["raw", "png", "jpeg"])
def test_same_recording_gives_same_bytes(dialect: Dialect, codec: str, tmp_path: Path) -> None:
    first, second = (
        write(dialect, tmp_path / f"{n}.mcap", make_recording(), codec).read_bytes() for n in "ab"
    )
    assert first == second


def test_rerun_reads_the_file(dialect: Dialect, tmp_path: Path) -> None:
    path = write(dialect, tmp_path / "a.mcap", make_recording())
    done = subprocess.run(
        [RERUN, "mcap", "info", path], capture_output=True, text=True, check=True, timeout=60
    )
    for topic, schema in dialect.schemas.items():
        assert any(topic in line and schema in line for line in done.stdout.splitlines()), topic


def test_rosbags_reads_the_ros_file(tmp_path: Path) -> None:
    recording = make_recording()
    path = write(ROS2, tmp_path / "a.mcap", recording)
    with AnyReader([path]) as reader:
        images = [c for c in reader.connections if c.topic == "/cam1/image_raw"]
        found = [
            (time_ns, reader.deserialize(data, connection.msgtype))
            for connection, time_ns, data in reader.messages(connections=images)
        ]
        qualities = {
            c.topic: c.ext.offered_qos_profiles[0]
            for c in reader.connections
            if isinstance(c.ext, ConnectionExtRosbag2)
        }
    expected = [shot.images[1] for shot in make_shots(recording) if shot.images[1] is not None]
    assert len(found) == len(expected) == 5
    for (_, message), image in zip(found, expected, strict=True):
        np.testing.assert_array_equal(message.data.reshape(32, 48), image)
    # tf2 accepts static transforms from transient-local publishers only.
    lasting = {t for t, q in qualities.items() if q.durability is QosDurability.TRANSIENT_LOCAL}
    assert (len(qualities), lasting) == (9, {"/tf_static"})


def test_frames_that_all_cameras_dropped_are_skipped(dialect: Dialect, tmp_path: Path) -> None:
    lost = (0, 2, *range(6, 15))  # the last ones are more than are encoded ahead
    recording = make_recording(drops=(lost, lost), frames=15)
    shots = make_shots(recording)
    dialect.write(tmp_path / "a.mcap", recording, shots, "raw")
    times = [t for t, _ in read(dialect, tmp_path / "a.mcap", "/cam0/image_raw")]
    assert times == recording.stamps_ns[0][[1, 3, 4, 5]].tolist()
    assert next(shots, None) is None
    assert len(read(dialect, tmp_path / "a.mcap", "/tf")) == 15


def test_existing_file_is_not_overwritten(dialect: Dialect, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        write(dialect, path, make_recording())
    assert path.read_text() == "mine"


def test_errors_of_the_renderer_propagate(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording(drops=((), ()))

    def breaking() -> Iterator[Shot]:
        for shot in make_shots(recording):
            if shot.index == 5:
                raise ZeroDivisionError("renderer failed")
            yield shot

    with pytest.raises(ZeroDivisionError, match="renderer failed"):
        dialect.write(tmp_path / "a.mcap", recording, breaking(), "png")


def test_full_disk_is_an_os_error(dialect: Dialect, tmp_path: Path) -> None:
    big = Camera(1000, 500, 600.0, 600.0, 500.0, 250.0)
    recording = make_recording(big, stereo=False, depth=False, drops=((),))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        # A file left open would warn when it is collected, and warnings are errors here.
        with pytest.raises(OSError, match="File too large") as caught:
            write(dialect, tmp_path / "a.mcap", recording)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    # A reference to the error keeps all that its frames refer to alive.
    assert caught.traceback
    assert not [each for each in threading.enumerate() if each.name.startswith("encode")]


def test_missing_shot_is_an_error(dialect: Dialect, tmp_path: Path) -> None:
    recording = make_recording(drops=((), ()))
    few = (shot for shot in make_shots(recording) if shot.index < 4)
    with pytest.raises(RuntimeError, match="frame 4 was not rendered"):
        dialect.write(tmp_path / "a.mcap", recording, few, "raw")


@pytest.mark.parametrize("lost", [0, 59], ids=["all", "dropped"])
def test_memory_does_not_grow_with_the_recording(
    dialect: Dialect, lost: int, tmp_path: Path
) -> None:
    frames, size = 60, 500_000
    big = Camera(1000, 500, 600.0, 600.0, 500.0, 250.0)
    drops = (tuple(range(lost)),)
    recording = make_recording(big, stereo=False, drops=drops, frames=frames)
    image, depth = np.zeros((500, 1000), np.uint8), np.ones((500, 1000), np.float32)
    shots = (Shot(i, (image.copy() if i >= lost else None,), depth.copy()) for i in range(frames))
    write(dialect, tmp_path / "warm.mcap", make_recording())
    tracemalloc.start()
    dialect.write(tmp_path / "a.mcap", recording, shots, "raw")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * 5 * size < frames * 5 * size
