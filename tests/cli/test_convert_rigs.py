"""`vo convert` of rigs: all cameras with their own stamps, and the same path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder
from typer.testing import CliRunner, Result

import vo
from vo.api.conversion_size import scaled_camera
from vo.base.config import load_config
from vo.base.types import Frame
from vo.cli.app import app
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

RIG = """
cam0: {resolution: [160, 120], intrinsics: [90, 90, 79.5, 59.5]}
cam1: {resolution: [160, 120], intrinsics: [90, 90, 79.5, 59.5]}
cam1_from_cam0: [[1, 0, 0, -0.2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
cam2: {resolution: [128, 120], intrinsics: [80, 80, 63.5, 59.5]}
cam2_from_cam0: [[0, 0, -1, 0.2], [0, 1, 0, 0], [1, 0, 0, 0.3], [0, 0, 0, 1]]
"""
FRAMES, LATE_NS = 10, 20_000_000


def rendered(folder: Path, effects: str) -> Path:
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    settings = ["world=room", "motion=handheld", "seconds=1", f"fps={FRAMES}", "seed=3"]
    camera = folder / "rig.yaml"
    return vo.synth(folder / "walk", camera=str(camera), effects=effects, overrides=settings)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three cameras without a common trigger; cam1 lacks image 4, cam2 cannot be read at 7."""
    path = rendered(tmp_path_factory.mktemp("rig"), "none,stagger=0.5")
    table = path / "mav0" / "cam1" / "data.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join(lines[:5] + lines[6:]) + "\n")
    damaged = sorted((path / "mav0" / "cam2" / "data").iterdir())[7]
    damaged.write_bytes(damaged.read_bytes()[:300])
    return path


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same rig with a common trigger."""
    return rendered(tmp_path_factory.mktemp("plain"), "none")


@pytest.fixture(scope="module")
def true_path(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return path_of(walk, tmp_path_factory.mktemp("run"))


def vo_convert(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


def path_of(recording: Path, output: Path) -> str:
    run(recording, output, config=load_config("fast"))
    poses = (output / "cameras.csv").read_text().splitlines()
    # An image that cannot be read is missing in a copy, and its time is that of cam0 there.
    poses = [line for line in poses if not line.startswith("7,") or ",cam2," not in line]
    return (output / "trajectory.tum").read_text() + "\n".join(poses)


def frames_of(path: Path) -> list[Frame]:
    return list(open_source(path).frames())


def assert_same_images(before: list[Frame], after: list[Frame]) -> None:
    for one, other in zip(before, after, strict=True):
        assert len(one.images) == len(other.images) == 3
        for image, copy in zip(one.images, other.images, strict=True):
            assert (image is None) == (copy is None)
            assert image is None or copy is None or np.array_equal(image, copy)


@pytest.mark.parametrize(
    ("name", "format", "codec"),
    [("a", "euroc", "png"), ("b.mcap", "mcap", "png"), ("c.mcap", "mcap-ros2", "raw")],
)
def test_images_stamps_calibration_and_path_are_the_same(
    walk: Path, tmp_path: Path, true_path: str, name: str, format: str, codec: str
) -> None:
    output = tmp_path / name
    result = vo_convert(walk, output, "--to", format, "--codec", codec)
    assert result.exit_code == 0, result.output
    assert f"{FRAMES} rig frames" in result.output
    before, after = frames_of(walk), frames_of(output)
    for number, (one, other) in enumerate(zip(before, after, strict=True)):
        assert one.stamps_ns is not None and other.stamps_ns is not None
        assert one.stamps_ns[2] - one.stamps_ns[0] == LATE_NS
        is_here = [image is not None for image in other.images]
        assert is_here == [True, number != 4, number != 7]
        pairs = zip(one.stamps_ns, other.stamps_ns, is_here, strict=True)
        assert all(a == b for a, b, here in pairs if here)
    assert_same_images(before, after)
    source, copy = open_source(walk), open_source(output)
    for lens, of_copy in zip(source.rig.cameras, copy.rig.cameras, strict=True):
        assert (of_copy.width, of_copy.height) == (lens.width, lens.height)
        assert np.array_equal(of_copy.matrix, lens.matrix) and not any(of_copy.distortion)
    np.testing.assert_allclose(copy.rig.cam0_from_cams, source.rig.cam0_from_cams, atol=1e-12)
    for one_imu, other_imu in zip(source.imus, copy.imus, strict=True):
        assert np.isin(other_imu.stamps_ns, one_imu.stamps_ns).all()
        assert len(other_imu.stamps_ns) > 150
    assert copy.ground_truth is not None
    assert path_of(output, tmp_path / "run") == true_path


def test_an_euroc_folder_has_each_cameras_file_and_own_stamps(walk: Path, tmp_path: Path) -> None:
    assert vo_convert(walk, tmp_path / "a", "--start", 2, "--stride", 2).exit_code == 0
    stamps = open_source(walk).stamps_ns[2::2]
    for number, pose in enumerate(open_source(walk).rig.cam0_from_cams):
        folder = tmp_path / "a" / "mav0" / f"cam{number}"
        listed = [int(line.split(",")[0]) for line in (folder / "data.csv").read_text().split()[2:]]
        kept = np.delete(stamps, 1) if number == 1 else stamps  # image 4
        assert listed == (kept + number * LATE_NS // 2).tolist()
        assert sorted(int(file.stem) for file in (folder / "data").iterdir()) == listed
        sensor = yaml.safe_load((folder / "sensor.yaml").read_text())
        first = yaml.safe_load((tmp_path / "a/mav0/cam0/sensor.yaml").read_text())
        body_from = [np.reshape(each["T_BS"]["data"], (4, 4)) for each in (first, sensor)]
        np.testing.assert_allclose(np.linalg.inv(body_from[0]) @ body_from[1], pose, atol=1e-9)


def test_others_read_the_topics_of_all_cameras(walk: Path, tmp_path: Path) -> None:
    output = tmp_path / "a.mcap"
    assert vo_convert(walk, output, "--to", "mcap-ros2").exit_code == 0
    with output.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[Ros2Decoder()])
        found = [(each[1].topic, each[3]) for each in reader.iter_decoded_messages()]
    counts = {n: sum(topic.startswith(f"/cam{n}/image") for topic, _ in found) for n in range(3)}
    assert counts == {0: FRAMES, 1: FRAMES - 1, 2: FRAMES - 1}
    (side, *_) = [message for topic, message in found if topic == "/cam2/camera_info"]
    assert (side.width, side.k[0], side.header.frame_id) == (128, 80.0, "cam2")
    (fixed,) = [message for topic, message in found if topic == "/tf_static"]
    assert {each.child_frame_id for each in fixed.transforms} >= {"cam0", "cam1", "cam2"}


def test_all_cameras_are_resized(plain: Path, tmp_path: Path) -> None:
    assert vo_convert(plain, tmp_path / "half", "--resize", 0.5, "--end", 2).exit_code == 0
    before, after = open_source(plain).rig, open_source(tmp_path / "half").rig
    expected = [scaled_camera(each, each.width // 2, each.height // 2) for each in before.cameras]
    assert list(after.cameras) == expected
    assert [
        image.shape for image in frames_of(tmp_path / "half")[1].images if image is not None
    ] == [
        (60, 80),
        (60, 80),
        (60, 64),
    ]


def test_a_plain_folder_needs_a_common_trigger(walk: Path, plain: Path, tmp_path: Path) -> None:
    result = vo_convert(walk, tmp_path / "late", "--to", "folder")
    assert result.exit_code == 1 and not (tmp_path / "late").exists()
    assert "those of others differ by up to 20.0 ms; use --to euroc" in result.stderr
    assert vo_convert(plain, tmp_path / "a", "--to", "folder").exit_code == 0
    assert_same_images(frames_of(plain), frames_of(tmp_path / "a"))


def test_kitti_is_refused_in_one_line(plain: Path, tmp_path: Path) -> None:
    result = vo_convert(plain, tmp_path / "a", "--to", "kitti")
    assert result.exit_code == 1 and result.stderr.count("\n") == 1
    assert "but there are 3" in result.stderr
