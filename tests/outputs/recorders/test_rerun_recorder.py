import os
import signal
import subprocess
import sys
import warnings
from collections import defaultdict
from pathlib import Path

import cv2
import fake_run
import numpy as np
import pytest
from rerun.chunk import RrdReader
from rrd import read_rrd

from vo.base.errors import OutputError
from vo.base.geometry.transforms import quat_xyzw_from_rotation, rotation_from_quat_xyzw
from vo.base.types import Rig, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.recorder import NullRecorder, Recorder
from vo.outputs.recorders.rerun_recorder import RerunRecorder
from vo.outputs.recorders.sink import end_of_messages

EPOCH_NS = 1_700_000_000_123_456_789


def record(path: Path, *, images="half", first_ns=0, rig=fake_run.RIG, truth=None) -> Path:
    recorder = RerunRecorder(path, images=images)
    recorder.begin("fake", rig, truth)
    for frame in range(fake_run.FRAMES):
        fake_run.record(recorder, frame, first_ns)
    path_found = fake_run.trajectory(first_ns)
    recorder.finish(path_found, path_found)
    return path


def run_script(script: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python code in a new process that can import the modules of this folder."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    }
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("rrd") / "new_folder" / "run.rrd"
    return record(path, truth=fake_run.trajectory())


def test_rerun_verifies_the_file(recording):
    command = Path(sys.executable).parent / "rerun"
    done = subprocess.run(
        [command, "rrd", "verify", recording], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_holds_a_blueprint(recording):
    assert len(RrdReader(recording).blueprints()) == 1


def test_holds_every_entity_on_both_timelines(recording):
    timelines = defaultdict(set)
    for chunk in RrdReader(recording).stream().to_chunks():
        timelines[chunk.entity_path.lstrip("/")] |= set(chunk.timeline_names)
    both = {entities.FRAME_TIMELINE, entities.SENSOR_TIMELINE}
    moving = [
        entities.CAM0,
        entities.LEFT,
        entities.LEFT_IMAGE,
        entities.RIGHT_IMAGE,
        entities.MATCHES,
        entities.STEREO_MATCHES,
        entities.EPIPOLAR,
        entities.CAUSAL_PATH,
        entities.SMOOTHED_PATH,
        entities.WINDOW_PATH,
        entities.GRAPH,
        entities.COVARIANCE,
        entities.LOCAL_LANDMARKS,
        entities.SETTLED_LANDMARKS,
        entities.EVENTS,
        entities.CAUSAL_POSES,
        entities.SMOOTHED_POSES,
        *(f"{entities.FEATURES}/{name}" for name in entities.FEATURE_COLOURS),
        *(f"{entities.TRACKING_PLOT}/{name}" for name in ("matches", "inliers", "lost")),
        *(f"{entities.REPROJECTION_PLOT}/{name}" for name in ("median", "p95")),
        *(f"{entities.ERROR_PLOT}/{name}" for name in ("causal", "smoothed")),
        *(f"{entities.TIME_PLOT}/{name}" for name in ("total", "features", "tracking")),
    ]
    assert {entity: timelines[entity] for entity in moving} == dict.fromkeys(moving, both)
    assert timelines[entities.TRUE_PATH] == timelines[entities.WORLD] == set()


def test_poses_equal_those_of_the_run(recording):
    tracked = [frame for frame in range(fake_run.FRAMES) if frame != fake_run.LOST_FRAME]
    for entity in (entities.CAUSAL_POSES, entities.SMOOTHED_POSES):
        rows = read_rrd(recording, "scalars")[entity]
        assert [frame for frame, _ in rows] == tracked
        for frame, row in rows:
            expected = fake_run.pose(frame)
            assert row[:3] == pytest.approx(expected[:3, 3], abs=1e-6)
            assert rotation_from_quat_xyzw(np.array(row[3:])) == pytest.approx(
                expected[:3, :3], abs=1e-6
            )


def test_camera_moves_along_the_causal_path(recording):
    rows = read_rrd(recording, "quaternion")[entities.CAM0]
    assert len(rows) == fake_run.FRAMES - 1
    for frame, (quat,) in rows:
        expected = quat_xyzw_from_rotation(fake_run.pose(frame)[:3, :3])
        assert np.asarray(quat) == pytest.approx(expected, abs=1e-6)
    lines = read_rrd(recording, "strips")[entities.CAUSAL_PATH]
    assert [frame for frame, _ in lines] == [*range(1, 6), *range(8, 22)]  # none across the loss
    for frame, (line,) in lines:
        ends = [fake_run.pose(frame - 1)[:3, 3], fake_run.pose(frame)[:3, 3]]
        assert np.array(line) == pytest.approx(np.array(ends), abs=1e-4)


def test_final_smoothed_path_is_one_strip_per_segment(recording):
    last = [strips for frame, strips in read_rrd(recording, "strips")[entities.SMOOTHED_PATH]][0]
    assert [len(strip) for strip in last] == [6, 15]


def test_each_landmark_settles_once(recording):
    rows = read_rrd(recording, "positions")
    settled = np.concatenate([points for _, points in rows[entities.SETTLED_LANDMARKS]])
    (_, first), *_ = rows[entities.LOCAL_LANDMARKS]
    assert len(first) == fake_run.LANDMARKS
    assert len(np.unique(settled, axis=0)) == len(settled) > 0


@pytest.mark.parametrize("images, scale", [("full", 1.0), ("half", 0.5), ("none", 1.0)])
def test_overlays_lie_on_the_image(tmp_path, images, scale):
    path = record(tmp_path / "run.rrd", images=images)
    blobs = read_rrd(path, "blob").get(entities.LEFT_IMAGE, [])
    assert len(blobs) == (0 if images == "none" else fake_run.FRAMES)
    ((width, height),) = read_rrd(path, "resolution")[entities.LEFT][0][1]
    for _, (blob,) in blobs:
        image = cv2.imdecode(np.array(blob, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        assert image.shape == (height, width)
    points = read_rrd(path, "positions")[f"{entities.FEATURES}/tracked"]
    points = [row for row in points if row[0] == 3][0][1]
    assert np.array(points) == pytest.approx((fake_run.view(3).xy[8:] + 0.5) * scale, abs=1 / 31)
    (matrix,) = read_rrd(path, "image_from_camera")[entities.LEFT][0][1]
    centre = (fake_run.CAMERA.cx + 0.5) * scale
    assert matrix[6] == pytest.approx(centre) and matrix[0] == pytest.approx(50.0 * scale)


@pytest.mark.parametrize("first_ns, kind", [(0, "duration[ns]"), (EPOCH_NS, "timestamp[ns]")])
def test_sensor_time_is_exact_for_small_and_epoch_stamps(tmp_path, first_ns, kind):
    path = record(tmp_path / "run.rrd", first_ns=first_ns)
    stamps = set()
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            column = chunk.to_record_batch()[entities.SENSOR_TIMELINE]
            assert str(column.type) == kind
            stamps |= set(column.cast("int64").to_pylist())
    assert stamps == {fake_run.stamp_ns(frame, first_ns) for frame in range(fake_run.FRAMES)}


@pytest.mark.parametrize("is_stereo, scale", [(True, 1.0), (False, 4.0)])
def test_ground_truth_is_aligned_with_the_estimate(tmp_path, is_stereo, scale):
    found = fake_run.trajectory()
    turned = fake_run.pose(4) @ found.world_from_cam
    turned[:, :3, 3] *= scale
    rig = fake_run.RIG if is_stereo else Rig(fake_run.CAMERA)
    path = record(tmp_path / "run.rrd", rig=rig, truth=Trajectory(found.stamps_ns, turned))
    shown = [strips for _, strips in read_rrd(path, "strips")[entities.TRUE_PATH]][-1]
    assert np.array(shown[0]) == pytest.approx(found.positions, abs=1e-3)


def test_events_contain_the_loss_and_the_recovery(recording):
    texts = [(frame, text) for frame, (text,) in read_rrd(recording, "text")[entities.EVENTS]]
    keyframes = [(frame, text) for frame, text in texts if text.startswith("keyframe")]
    assert [frame for frame, _ in keyframes] == [0, 2, 4, *range(8, 22, 2)]
    assert keyframes[1][1] == "keyframe: 20 of 22 matches agree"
    assert [text for text in texts if text not in keyframes] == [
        (0, "tracking"),
        (6, "new segment 1"),
        (6, "lost: 3 matches with the reference frame, 80 needed"),
        (7, "recovered"),
    ]


def test_an_existing_file_is_replaced(tmp_path, recording):
    path = tmp_path / "run.rrd"
    path.write_bytes(b"old" * 1_000_000)
    record(path)
    assert len(read_rrd(path, "blob")[entities.LEFT_IMAGE]) == fake_run.FRAMES


@pytest.mark.parametrize("name", ["folder", "file.txt/run.rrd"])
def test_a_file_that_cannot_be_written_is_an_error(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.txt").touch()
    with pytest.raises(OutputError, match=r"cannot write the recording .*choose another") as error:
        RerunRecorder(tmp_path / name).begin("fake", fake_run.RIG, None)
    assert "\n" not in str(error.value)


def test_a_full_disk_ends_the_recording_not_the_run(tmp_path):
    script = (
        "import resource, sys; from pathlib import Path\n"
        "import fake_run\n"
        "from vo.outputs.recorders.background import BackgroundRecorder\n"
        "from vo.outputs.recorders.rerun_recorder import RerunRecorder\n"
        "recorder = BackgroundRecorder(RerunRecorder(Path(sys.argv[1])), queue_size=1000)\n"
        "recorder.begin('x', fake_run.RIG, None)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))\n"
        "for frame in range(200): fake_run.record(recorder, frame)\n"
        "recorder.finish(fake_run.trajectory(), fake_run.trajectory())\n"
        "print('the run continues')\n"
    )
    done = run_script(script, tmp_path / "run.rrd")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "the run continues\n"
    assert len([line for line in done.stderr.splitlines() if "stopped" in line]) == 1, done.stderr
    assert (tmp_path / "run.rrd").stat().st_size <= 150_000


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_the_file_of_a_killed_run_opens(tmp_path):
    path = tmp_path / "run.rrd"
    script = (
        "import os, signal, sys; from pathlib import Path\n"
        "import fake_run\n"
        "from vo.outputs.recorders.rerun_recorder import RerunRecorder\n"
        "recorder = RerunRecorder(Path(sys.argv[1])); recorder.begin('x', fake_run.RIG, None)\n"
        "for frame in range(45): fake_run.record(recorder, frame)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert run_script(script, path).returncode == -signal.SIGKILL
    assert len(read_rrd(path, "blob")[entities.LEFT_IMAGE]) >= 25


def test_recorder_without_frames_closes(tmp_path):
    recorder = RerunRecorder(tmp_path / "run.rrd")
    nothing = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))
    recorder.finish(nothing, nothing)  # before begin
    recorder.begin("fake", fake_run.RIG, None)
    recorder.finish(nothing, nothing)
    assert len(RrdReader(tmp_path / "run.rrd").recordings()) == 1


def test_null_recorder_accepts_all_calls():
    recorder: Recorder = NullRecorder()
    recorder.begin("fake", fake_run.RIG, fake_run.trajectory())
    fake_run.record(recorder, 0)
    recorder.finish(fake_run.trajectory(), fake_run.trajectory())


@pytest.mark.parametrize("ratio", [0.3, 0.6, 0.9])
def test_a_file_that_was_cut_ends_with_a_whole_message(tmp_path, recording, ratio):
    data = recording.read_bytes()
    path = tmp_path / "cut.rrd"
    path.write_bytes(data[: int(ratio * len(data))])
    with path.open("r+b") as file:
        file.truncate(end_of_messages(file.fileno()))
    assert 0 < path.stat().st_size <= int(ratio * len(data))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without an index
        chunks = RrdReader(path).stream().to_chunks()
    assert len(chunks) > 3
    with recording.open("rb") as file:
        assert 0 <= len(data) - end_of_messages(file.fileno()) < 100  # the footer of the stream
