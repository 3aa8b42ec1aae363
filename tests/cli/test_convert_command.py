"""`vo convert`: the converted recording equals the original."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoder
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder
from typer.testing import CliRunner, Result

from vo.api.conversion_size import scaled_camera
from vo.base.config import load_config
from vo.base.geometry.cameras import project
from vo.base.types import Camera, Floats, Frame, Ints, Trajectory
from vo.cli.app import app
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run
from vo.tools.inspection.opening import open_leniently, right_stamps

FRAMES = 8
KINDS = [
    ("a.mcap", "mcap", "raw"),
    ("b.mcap", "mcap-ros2", "png"),
    ("c", "euroc", "png"),
    ("d", "kitti", "png"),
    ("e", "folder", "png"),
]


def vo_convert(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


def converted(source: Path, output: Path, *flags: object) -> Path:
    result = vo_convert(source, output, *flags)
    assert result.exit_code == 0, result.output
    return output


def path_of(recording: Path, output: Path) -> bytes:
    run(recording, output, config=load_config("fast"), end=FRAMES)
    return (output / "trajectory.tum").read_bytes()


def positions_at(truth: Trajectory, stamps_ns: Ints) -> Floats:
    """Positions at stamps, by linear interpolation."""
    columns = [np.interp(stamps_ns, truth.stamps_ns, axis) for axis in truth.positions.T]
    return np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def true_path(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return path_of(synthetic_stereo, tmp_path_factory.mktemp("run"))


@pytest.mark.parametrize(("name", "format", "codec"), KINDS)
def test_lossless_conversion_preserves_everything(
    synthetic_stereo: Path,
    tmp_path: Path,
    true_path: bytes,
    name: str,
    format: str,
    codec: str,
) -> None:
    flags = ("--to", format, "--codec", codec, "--end", FRAMES)
    output = converted(synthetic_stereo, tmp_path / name, *flags)
    before, after = open_source(synthetic_stereo), open_source(output)
    assert after.stamps_ns.tolist() == before.stamps_ns[:FRAMES].tolist()
    assert np.array_equal(after.rig.cam0.matrix, before.rig.cam0.matrix)
    assert after.rig.cam1_from_cam0 is not None and before.rig.cam1_from_cam0 is not None
    assert after.rig.cam1_from_cam0 == pytest.approx(before.rig.cam1_from_cam0, abs=1e-12)
    for a, b in zip(before.frames(0, FRAMES), after.frames(), strict=True):
        assert np.array_equal(a.image0, b.image0)
        assert a.image1 is not None and b.image1 is not None
        assert np.array_equal(a.image1, b.image1)
    assert after.ground_truth is not None and before.ground_truth is not None
    positions = positions_at(before.ground_truth, after.stamps_ns)
    assert np.ptp(positions, axis=0).max() > 0.1
    found = positions_at(after.ground_truth, after.stamps_ns)
    if format == "kitti":  # its world is the first camera
        positions, found = (np.linalg.norm(xyz - xyz[0], axis=1) for xyz in (positions, found))
    assert found == pytest.approx(positions, abs=1e-3)
    assert path_of(output, tmp_path / "run") == true_path


def test_right_stamps_missing_images_and_slices_are_preserved(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    walk = Path(shutil.copytree(synthetic_stereo, tmp_path / "walk"))
    table = walk / "mav0" / "cam1" / "data.csv"
    heading, *lines = table.read_text().splitlines()
    shifted = [f"{int(line.split(',')[0]) + 1234},{line.split(',')[1]}" for line in lines]
    table.write_text("\n".join([heading, *shifted[:5], *shifted[6:]]) + "\n")
    damaged = sorted((walk / "mav0" / "cam0" / "data").iterdir())[7]
    damaged.write_bytes(damaged.read_bytes()[:300])
    output = converted(walk, tmp_path / "a.mcap", "--start", 3, "--end", 12, "--stride", 2)
    before, after = open_leniently(walk), open_leniently(output)
    left_ns = [shot.stamp_ns for shot in after.cameras[0].shots]
    all_ns = [shot.stamp_ns for shot in before.cameras[0].shots]
    assert left_ns == [all_ns[i] for i in (3, 5, 9, 11)]
    right_ns = right_stamps(after.cameras[0].shots, after.cameras[1].shots)
    assert right_ns.tolist() == [all_ns[3] + 1234, -1, all_ns[9] + 1234, all_ns[11] + 1234]


def test_a_scaled_camera_sees_the_same_corners() -> None:
    camera = Camera(640, 400, 320.0, 321.0, 325.7, 203.5, "radtan", (0.1, -0.05, 0.001, 0.002))
    small = scaled_camera(camera, 320, 100)
    points = np.random.default_rng(3).uniform((-1, -0.6, 1), (1, 0.6, 2), (50, 3))
    # The outer corner of the image is at -0.5: pixels are counted from their centres.
    expected = (project(camera, points) + 0.5) * (0.5, 0.25) - 0.5
    assert project(small, points) == pytest.approx(expected, abs=1e-9)


def test_resizing_scales_images_and_calibration(synthetic_stereo: Path, tmp_path: Path) -> None:
    output = converted(synthetic_stereo, tmp_path / "half", "--resize", 0.5, "--end", 2)
    before, after = open_source(synthetic_stereo), open_source(output)
    assert after.rig.cam0 == scaled_camera(
        before.rig.cam0, before.rig.cam0.width // 2, before.rig.cam0.height // 2
    )
    image, small = next(before.frames()).image0, next(after.frames()).image0
    blocks = image[: 2 * small.shape[0], : 2 * small.shape[1]].astype(float)
    means = blocks.reshape(small.shape[0], 2, small.shape[1], 2).mean(axis=(1, 3))
    assert np.abs(means - small).max() <= 1.0


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--to", "tum"), "euroc"),
        (("--codec", "raw"), "--codec png or jpeg"),
        (("--resize", "big"), "--resize big"),
        (("--to", "mcap"), "a file ending in .mcap"),
        (("--to", "bag"), "cannot write format"),
        (("--start", "500"), "only 30 frames"),
    ],
)
def test_invalid_arguments_are_one_error_line(
    synthetic_stereo: Path, tmp_path: Path, flags: tuple[str, ...], message: str
) -> None:
    result = vo_convert(synthetic_stereo, tmp_path / "out", *flags)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ") and message in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_conversion_leaves_no_files(synthetic_stereo: Path, tmp_path: Path) -> None:
    program = [sys.executable, "-c", "from vo.cli.app import app; app()"]
    arguments = ["convert", str(synthetic_stereo), str(tmp_path / "a.mcap"), "--resize", "6"]
    process = subprocess.Popen([*program, *arguments], stderr=subprocess.DEVNULL)
    while not list(tmp_path.iterdir()) and process.poll() is None:
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(timeout=60) == 130
    assert list(tmp_path.iterdir()) == []


def colour_clip(path: Path) -> Path:
    """A recording like those of TUM RGB-D: colour, 16-bit depth, stamps as file names."""
    noise = np.random.default_rng(7)
    lists: dict[str, list[str]] = {"rgb": [], "depth": []}
    for i in range(4):
        colour = cv2.GaussianBlur(noise.integers(0, 256, (60, 80, 3), dtype=np.uint8), (0, 0), 1.5)
        depth = noise.integers(0, 65536, (60, 80), dtype=np.uint16)
        for name, image in (("rgb", colour), ("depth", depth)):
            (path / name).mkdir(parents=True, exist_ok=True)
            file = f"{name}/1305031102.{175304000 + i * 33_000_000:09d}.png"
            assert cv2.imwrite(str(path / file), image)
            lists[name].append(f"{file[len(name) + 1 : -4]} {file}")
    for name, lines in lists.items():
        (path / f"{name}.txt").write_text("\n".join(["# title", *lines]) + "\n")
    (path / "calibration.yaml").write_text(
        "cam0: {resolution: [80, 60], intrinsics: [70.0, 70.0, 39.5, 29.5]}\n"
    )
    return path


def recorded(path: Path) -> list[Frame]:
    return list(open_source(path).frames(images="recorded"))


def images_in(folder: Path) -> list[Pixels]:
    return [
        np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
        for file in sorted(folder.glob("*.png"))
    ]


@pytest.mark.parametrize(("format", "codec"), [("mcap", "raw"), ("mcap-ros2", "png")])
def test_colour_and_depth_are_preserved_in_a_log(tmp_path: Path, format: str, codec: str) -> None:
    clip = colour_clip(tmp_path / "clip")
    log = converted(clip, tmp_path / "a.mcap", "--to", format, "--codec", codec)
    back = converted(log, tmp_path / "back", "--to", "tum")
    for name in ("rgb", "depth"):
        before, after = images_in(clip / name), images_in(back / name)
        assert len(after) == 4
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
        assert {image.dtype.name for image in after} == {"uint8" if name == "rgb" else "uint16"}
    folder = converted(log, tmp_path / "folder", "--to", "folder", "--stride", 2)
    pairs = zip(images_in(clip / "rgb")[::2], images_in(folder), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)


def test_official_decoders_read_the_colours(tmp_path: Path) -> None:
    clip = colour_clip(tmp_path / "clip")
    expected = images_in(clip / "rgb")
    ros2 = converted(clip, tmp_path / "a.mcap", "--to", "mcap-ros2", "--codec", "raw")
    foxglove = converted(clip, tmp_path / "b.mcap", "--codec", "raw")
    for path, factory in ((ros2, Ros2Decoder()), (foxglove, ProtobufDecoder())):
        with path.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[factory])
            messages = [m for *_, m in reader.iter_decoded_messages(["/cam0/image_raw"])]
        assert [(m.encoding, m.step) for m in messages] == [("bgr8", 240)] * 4
        images = [np.frombuffer(bytes(m.data), np.uint8).reshape(60, 80, 3) for m in messages]
        assert all(np.array_equal(a, b) for a, b in zip(images, expected, strict=True))


def test_gray_writes_the_images_of_the_odometry(tmp_path: Path) -> None:
    clip = colour_clip(tmp_path / "clip")
    grey = converted(clip, tmp_path / "grey", "--gray")
    assert [f.image0.ndim for f in recorded(grey)] == [2] * 4
    seen = open_source(clip).frames()
    assert all(
        np.array_equal(a.image0, b.image0) for a, b in zip(seen, recorded(grey), strict=True)
    )


def test_jpeg_and_resizing_preserve_colour(tmp_path: Path) -> None:
    clip = colour_clip(tmp_path / "clip")
    small = converted(clip, tmp_path / "s", "--codec", "jpeg", "--resize", 0.5, "--to", "kitti")
    assert sorted(folder.name for folder in small.iterdir() if folder.is_dir()) == [
        "depth",
        "image_2",
    ]
    for before, after in zip(recorded(clip), recorded(small), strict=True):
        assert after.image0.shape == (30, 40, 3)
        expected = cv2.resize(before.image0, (40, 30), interpolation=cv2.INTER_AREA)
        assert np.abs(after.image0.astype(float) - expected).mean() < 8.0
    assert open_source(small).rig.cam0.fx == 35.0


@pytest.mark.parametrize(("codec", "bits"), [("png", 16), ("jpeg", 8), ("raw", 16)])
def test_16_bits_are_preserved_unless_jpeg(tmp_path: Path, codec: str, bits: int) -> None:
    deep = np.random.default_rng(2).integers(0, 4096, (60, 80), dtype=np.uint16)
    (tmp_path / "a").mkdir()
    assert cv2.imwrite(str(tmp_path / "a" / "0.png"), cv2.GaussianBlur(deep, (0, 0), 1.2))
    calibration = "cam0: {resolution: [80, 60], intrinsics: [70.0, 70.0, 39.5, 29.5]}\n"
    (tmp_path / "a" / "calibration.yaml").write_text(calibration)
    log = converted(tmp_path / "a", tmp_path / "a.mcap", "--codec", codec)
    (before,), (after,) = recorded(tmp_path / "a"), recorded(log)
    assert after.image0.dtype == (np.uint16 if bits == 16 else np.uint8)
    if bits == 16:
        assert np.array_equal(before.image0, after.image0)
    else:
        assert np.abs(after.image0.astype(float) - (before.image0 >> 4)).mean() < 3.0


def lines_of(recording: Path) -> list[str]:
    return (recording / "mav0" / "imu0" / "data.csv").read_text().splitlines()[1:]


@pytest.mark.parametrize("format", ["mcap", "mcap-ros2"])
def test_inertial_measurements_are_preserved_exactly(
    synthetic_stereo: Path, tmp_path: Path, format: str
) -> None:
    log = converted(synthetic_stereo, tmp_path / "a.mcap", "--to", format, "--end", 6)
    back = converted(log, tmp_path / "back")
    stamps = open_source(synthetic_stereo).stamps_ns[:6]
    times = [int(line.split(",")[0]) for line in lines_of(synthetic_stereo)]
    kept = [i for i, time in enumerate(times) if stamps[0] <= time <= stamps[-1]]
    expected = lines_of(synthetic_stereo)[kept[0] - 1 : kept[-1] + 2]
    assert len(expected) > 40 and lines_of(back) == expected
    before, after = open_source(synthetic_stereo).imus[0], open_source(back).imus[0]
    assert before.cam0_from_imu is not None and after.cam0_from_imu is not None
    assert after.cam0_from_imu == pytest.approx(before.cam0_from_imu, abs=1e-12)
    for name in ("cam0", "cam1"):
        pairs = zip(
            images_in(synthetic_stereo / "mav0" / name / "data")[:6],
            images_in(back / "mav0" / name / "data"),
            strict=True,
        )
        assert all(np.array_equal(a, b) for a, b in pairs)


def test_rosbags_reads_the_inertial_measurements(synthetic_stereo: Path, tmp_path: Path) -> None:
    flags = ("--to", "mcap-ros2", "--start", 2, "--end", 6)
    log = converted(synthetic_stereo, tmp_path / "a.mcap", *flags)
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[Ros2Decoder()])
        messages = [m for *_, m in reader.iter_decoded_messages(["/imu0"])]
    read = [
        [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec]
        + [getattr(v, axis) for v in (m.angular_velocity, m.linear_acceleration) for axis in "xyz"]
        for m in messages
    ]
    rows = [line.split(",") for line in lines_of(synthetic_stereo)]
    known = {int(row[0]): [float(value) for value in row[1:]] for row in rows}
    assert len(read) > 20
    assert all(values == known[stamp] for stamp, *values in read)
    assert {m.header.frame_id for m in messages} == {"body"}


def test_imu_noise_is_preserved_and_an_unknown_pose_stays_unknown(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    walk = Path(shutil.copytree(synthetic_stereo, tmp_path / "walk"))
    cut = converted(walk, tmp_path / "cut", "--end", 3)
    before, after = (open_source(path).imus[0] for path in (walk, cut))
    assert after.noise == before.noise and after.noise is not None
    sensor = walk / "mav0" / "imu0" / "sensor.yaml"
    sensor.unlink()
    result = vo_convert(walk, tmp_path / "a.mcap", "--end", 3)
    assert result.exit_code == 0
    assert "its pose relative to the camera is unknown" in " ".join(result.stderr.split())
    assert open_source(tmp_path / "a.mcap").imus[0].cam0_from_imu is None
    result = vo_convert(walk, tmp_path / "kitti", "--to", "kitti", "--end", 3)
    assert "format kitti does not support it" in " ".join(result.stderr.split())


def test_warnings_are_sentences(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (48, 64), dtype=np.uint8)
    source = tmp_path / "images [old]"
    source.mkdir()
    for name in ("a.png", "b.png"):
        assert cv2.imwrite(str(source / name), noise)
    result = vo_convert(source, tmp_path / "copy")
    words = "warning: " + str(source) + " has no times.txt or timestamps.txt and no stamps in its"
    assert words in result.output and "LoggedWarning" not in result.output
