"""KITTI raw: stamps, rectified and unrectified images, colour pair, GPS/INS ground truth."""

from __future__ import annotations

import shutil
from pathlib import Path

import layouts
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.base.geometry.transforms import se3_exp
from vo.recordings.sources.oxts import mercator, read_date_stamps, rotation_from_roll_pitch_yaw
from vo.recordings.sources.registry import open_source


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    layouts.write_kitti_raw(path)
    return path


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["2011-09-26 13:02:25.964389445"], [1317042145964389445]),
        (["1970-01-01 00:00:01.5"], [1_500_000_000]),
        (  # without leading zeros: .009658 is written as .9658000
            [f"2011-09-26 13:02:25.{ns}" for ns in (9658000, 109658000, 209658000)],
            [1317042145_009658000 + i * 10**8 for i in range(3)],
        ),
    ],
)
def test_stamps_are_exact(tmp_path: Path, texts: list[str], expected: list[int]) -> None:
    (tmp_path / "a.txt").write_text("\n".join(texts))
    assert read_date_stamps(tmp_path / "a.txt") == expected


@pytest.mark.parametrize("text", ["26.9.2011 13:02", "2011-19-26 13:02:25.9"])
def test_other_dates_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(SourceError, match=r"a\.txt:1: stamp '.*' is not a number .* or a date"):
        read_date_stamps(tmp_path / "a.txt")


def test_calibration_of_the_date_is_found(drive: Path) -> None:
    for path in drive.glob("calib_*.txt"):
        path.rename(drive.parent / path.name)
    source = open_source(drive)
    assert source.rig.is_stereo
    assert source.ground_truth is not None
    np.testing.assert_allclose(source.ground_truth.world_from_cam, layouts.truth(), atol=1e-9)


def test_unrectified_images_have_the_unrectified_calibration(drive: Path) -> None:
    for path in drive.glob("image_0?/data/*.png"):
        layouts.write_image(path, np.zeros((512, 1392), np.uint8))
    rig = open_source(drive).rig
    assert (rig.cam0.width, rig.cam0.fx) == (1392, 900)
    assert rig.cam0.distortion == (-0.3, 0.1, 0.001, 0.0005, -0.02)
    assert rig.is_stereo


def test_colour_pair_is_used_without_a_grey_one(drive: Path) -> None:
    for i in range(2):
        (drive / f"image_0{i}").rename(drive / f"image_0{i + 2}")
    text = (drive / "calib_cam_to_cam.txt").read_text()
    shifted = text.replace("_00:", "_02:").replace("_01:", "_03:")
    fx = layouts.INTRINSICS[0]
    lines = [line for line in shifted.splitlines() if not line.startswith("P_rect")]
    for number, shift_m in (("02", 0.06), ("03", 0.06 - layouts.BASELINE_M)):
        numbers = [fx, 0, 31.5, fx * shift_m, 0, 51.0, 23.5, 0, 0, 0, 1, 0]
        lines.append(f"P_rect_{number}: {layouts.numbers(numbers)}")
    layouts.write_text(drive / "calib_cam_to_cam.txt", "\n".join([text, *lines]))
    source = open_source(drive)
    assert source.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(source.rig.cam1_from_cam0[0, 3], -layouts.BASELINE_M, atol=1e-9)
    assert source.ground_truth is not None
    # Camera 02 sits 6 cm to the left of camera 00, where the inertial unit is.
    expected = np.stack(layouts.truth()) @ se3_exp(np.array([0, 0, 0, -0.06, 0, 0]))
    np.testing.assert_allclose(source.ground_truth.world_from_cam, expected, atol=1e-9)


def test_missing_image_does_not_shift_the_stamps(drive: Path) -> None:
    (drive / "image_00/data/0000000002.png").unlink()
    stamps = [f.stamp_ns for f in open_source(drive).frames()]
    assert stamps == layouts.STAMPS_NS[:2] + layouts.STAMPS_NS[3:]


def test_each_camera_has_its_own_stamps(drive: Path) -> None:
    late = "".join(f"{layouts.date(s + 1_400_000)}\n" for s in layouts.STAMPS_NS)
    layouts.write_text(drive / "image_01/timestamps.txt", late)
    frames = list(open_source(drive).frames())
    assert [f.stamp_ns for f in frames] == layouts.STAMPS_NS
    assert all(f.image1 is not None for f in frames)


def test_ground_truth_is_interpolated_at_the_stamps_of_the_images(drive: Path) -> None:
    def write(delay_ns: int) -> None:
        lines = "".join(f"{layouts.date(s + delay_ns)}\n" for s in layouts.STAMPS_NS)
        layouts.write_text(drive / "oxts/timestamps.txt", lines)

    write(-50_000_000)
    truth = open_source(drive).ground_truth
    assert truth is not None
    assert truth.stamps_ns.tolist() == layouts.STAMPS_NS[:-1]  # nothing is known after the last
    between = [0.5 * (a[:3, 3] + b[:3, 3]) for a, b in
               zip(layouts.truth(), layouts.truth()[1:], strict=False)]  # fmt: skip
    np.testing.assert_allclose(truth.positions, between, atol=2e-3)


def test_ground_truth_with_a_given_calibration(drive: Path, tmp_path: Path) -> None:
    layouts.write_text(tmp_path / "mine.yaml", layouts.CALIBRATION)
    truth = open_source(drive, calibration=tmp_path / "mine.yaml").ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_from_cam, layouts.truth(), atol=1e-9)


@pytest.mark.parametrize("missing", ["calib_imu_to_velo.txt", "calib_velo_to_cam.txt"])
def test_no_ground_truth_without_the_extrinsics_of_the_unit(
    drive: Path, missing: str, caplog: pytest.LogCaptureFixture
) -> None:
    (drive / missing).unlink()
    source = open_source(drive)
    assert source.ground_truth is None
    assert "ground truth not used" in caplog.text
    assert missing in caplog.text


def test_damaged_record_loses_only_the_ground_truth(
    drive: Path, caplog: pytest.LogCaptureFixture
) -> None:
    layouts.write_text(drive / "oxts/data/0000000003.txt", "49.0 8.4\n")
    assert open_source(drive).ground_truth is None
    assert "0000000003.txt is not a GPS/INS record" in caplog.text


def test_no_ground_truth_without_oxts(drive: Path, caplog: pytest.LogCaptureFixture) -> None:
    shutil.rmtree(drive / "oxts")
    assert open_source(drive).ground_truth is None
    assert not caplog.records


def test_error_for_inconsistent_stamps(drive: Path) -> None:
    layouts.write_text(drive / "image_00/timestamps.txt", layouts.date(0) + "\n")
    with pytest.raises(SourceError, match="6 images but 1 stamps"):
        open_source(drive)
    layouts.write_text(drive / "image_00/timestamps.txt", "noon\n" * 6)
    with pytest.raises(SourceError, match="timestamps.txt:1: stamp 'noon' is not a number"):
        open_source(drive)


def test_mercator_agrees_with_the_length_of_a_degree() -> None:
    # At 49 degrees a degree of longitude is cos(49) of one at the equator; so is Mercator's metre.
    here = np.array([[49.0, 8.4, 100.0], [49.0, 8.401, 101.0], [49.001, 8.4, 102.0]])
    steps = np.diff(mercator(here, 49.0), axis=0)
    degree_m = np.pi * 6378137.0 / 180
    expected = degree_m * 1e-3 * np.cos(np.deg2rad(49.0))
    np.testing.assert_allclose(steps[0], [expected, 0, 1], atol=1e-6)
    np.testing.assert_allclose(steps[0, :2] + steps[1, :2], [0, degree_m * 1e-3], atol=2e-3)


def test_rotation_from_roll_pitch_yaw() -> None:
    yaw = rotation_from_roll_pitch_yaw(0, 0, np.pi / 2)
    np.testing.assert_allclose(yaw @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    pitch = rotation_from_roll_pitch_yaw(0, np.pi / 2, 0)
    np.testing.assert_allclose(pitch @ [1, 0, 0], [0, 0, -1], atol=1e-12)
    turned = rotation_from_roll_pitch_yaw(0.1, -0.2, 0.3)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
