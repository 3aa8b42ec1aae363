"""Images of several cameras in one folder."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import cv2
import layouts
import numpy as np
import pytest

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Bytes
from vo.recordings.sources.listing import list_images
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.series import find_cameras

COUNT = layouts.COUNT
STAMPS = [str(stamp) for stamp in layouts.STAMPS_NS]
COUNTERS = [f"{i:04d}" for i in range(COUNT)]
DECIMALS = [layouts.seconds(stamp) for stamp in layouts.STAMPS_NS]
LARGER = layouts.CALIBRATION.replace("64", "320").replace("48", "240")
PAIRS = [
    "{}_left {}_right",
    "left_{} right_{}",
    "left{} right{}",
    "cam0_{} cam1_{}",
    "cam1_{} cam2_{}",
    "camera_0_{} camera_1_{}",
    "{}_cam0 {}_cam1",
    "L{} R{}",
    "{}L {}R",
    "{}_L {}_R",
    "imgL_{} imgR_{}",
    "infra1_{} infra2_{}",
    "frame_{} frame_{}_right",
    "{}.left {}.right",
]


def write(folder: Path, names: str, keys: list[str], *, missing: int | None = None) -> Path:
    left, right = names.split()
    for i, key in enumerate(keys):
        layouts.write_image(folder / f"{left.format(key)}.png", layouts.image(i))
        if i != missing:
            layouts.write_image(folder / f"{right.format(key)}.png", layouts.image(i, right=True))
    layouts.write_text(folder / "calibration.yaml", layouts.CALIBRATION)
    return folder


@pytest.mark.parametrize("names", PAIRS)
@pytest.mark.parametrize("keys", [STAMPS, COUNTERS, DECIMALS], ids=["ns", "counters", "seconds"])
@pytest.mark.parametrize("given", ["folder", "pattern"])
def test_pairs_by_name(tmp_path: Path, names: str, keys: list[str], given: str) -> None:
    write(tmp_path, names, keys, missing=2)
    source = open_source(tmp_path if given == "folder" else tmp_path / "*.png")
    assert source.rig.is_stereo
    frames = list(source.frames())
    assert [frame.image0[0, 0] for frame in frames] == list(range(COUNT))
    right = [None if frame.image1 is None else int(frame.image1[0, 0]) for frame in frames]
    assert right == [None if i == 2 else 100 + i for i in range(COUNT)]
    if keys is not COUNTERS:
        assert source.stamps_ns.tolist() == layouts.STAMPS_NS
    assert not open_source(tmp_path, mode="mono").rig.is_stereo


def test_pair_with_stamps_of_its_own(tmp_path: Path) -> None:
    for i, stamp in enumerate(layouts.STAMPS_NS):
        layouts.write_image(tmp_path / f"cam0_{stamp}.png", layouts.image(i))
        layouts.write_image(tmp_path / f"cam1_{stamp + 300_000}.png", layouts.image(i, right=True))
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    frames = list(open_source(tmp_path).frames())
    assert [f.image1 is not None and int(f.image1[0, 0]) for f in frames] == [
        100 + i for i in range(COUNT)
    ]


DEPTHS = ["color_{} depth_{}", "rgb{} depth{}", "{}.color {}.depth", "{} {}_depth", "a_{} b_{}"]


@pytest.mark.parametrize("names", DEPTHS)
def test_depth_by_name_or_content(tmp_path: Path, names: str) -> None:
    colour, deep = names.split()
    for i, key in enumerate(COUNTERS):
        layouts.write_image(tmp_path / f"{colour.format(key)}.png", layouts.image(i))
        metres = np.full((layouts.HEIGHT, layouts.WIDTH), 1000 + 100 * i, np.uint16)
        layouts.write_image(tmp_path / f"{deep.format(key)}.png", metres)
    file = tmp_path / "calibration.yaml"
    layouts.write_text(file, layouts.CALIBRATION.replace("baseline_m: 0.12\n", ""))
    with pytest.raises(CalibrationError, match="`depth_per_metre: 1000`.* or leave"):
        open_source(tmp_path)
    assert not open_source(tmp_path, mode="mono").rig.has_depth
    file.write_text(file.read_text() + "depth_per_metre: 1000\n")
    source = open_source(tmp_path)
    assert source.rig.has_depth
    depths = [frame.depth for frame in source.frames()]
    assert [d is not None and float(d[0, 0]) for d in depths] == pytest.approx(
        [1 + 0.1 * i for i in range(COUNT)]
    )


REFUSED = ["a_{} b_{}", "{} {}_x", "cam0_{} cam1_{} cam2_{}", "left_{} right_{} top_{}", "{}a {}b"]


@pytest.mark.parametrize("names", REFUSED)
@pytest.mark.parametrize("keys", [STAMPS, COUNTERS, DECIMALS], ids=["ns", "counters", "s"])
def test_advice_where_names_do_not_say_the_role(
    tmp_path: Path, names: str, keys: list[str]
) -> None:
    for i, key in enumerate(keys):
        for camera, name in enumerate(names.split()):
            pixels = layouts.image(i)
            pixels[0, 0] = 10 * camera + i
            layouts.write_image(tmp_path / f"{name.format(key)}.png", pixels)
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    with pytest.raises(SourceError) as caught:
        open_source(tmp_path)
    patterns = re.findall(r"('[^']+') \(6 images\)", str(caught.value))
    assert len(patterns) == len(names.split())
    for camera, pattern in enumerate(patterns):
        frames = open_source(*shlex.split(pattern), mode="mono").frames()
        assert [int(frame.image0[0, 0]) for frame in frames] == [10 * camera + i for i in range(6)]


ONE_CAMERA = [
    [f"frame_{i}" for i in range(12)],
    [f"{1600000000 + i // 20}.{i % 20 * 50_000_000:09d}" for i in range(60)],
    [f"2020-03-24_17-{i // 60:02d}-{i % 60:02d}" for i in range(180)],
    [f"chunk_{i // 20}_{i % 20:03d}" for i in range(60)],
    [f"t{i // 20}.{i % 20 * 5:02d}" for i in range(60)],
    [f"IMG_{i:04d}" for i in range(9)] + ["vignette"],
    [f"frame_{i:04d}" for i in range(9)] + [f"img_{i:04d}" for i in range(9, 20)],
    ["a", "b", "c"],
]


@pytest.mark.parametrize("names", ONE_CAMERA, ids=lambda names: names[-1])
def test_one_camera_stays_one(names: list[str]) -> None:
    images = [Path("/x") / f"{name}.png" for name in names]
    found = find_cameras(images)
    assert found.left.images == tuple(images)
    assert found.right is found.depth is None


def test_masks_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path, "frame_{} frame_{}_mask", COUNTERS)
    assert len(open_source(tmp_path)) == COUNT
    assert "frame_0000_mask.png and 5 more: not used" in caplog.text


def views(right: bool, count: int) -> list[Bytes]:
    """Images of a wall along which two cameras climb, 60 pixels beside each other."""
    texture = np.random.default_rng(0).integers(0, 256, (280, 100), dtype=np.uint8)
    wall = cv2.resize(texture, (400, 1120)).astype(np.uint8)
    side = 60 if right else 0
    return [wall[70 * i : 70 * i + 240, side : side + 320] for i in range(count)]


NUMBERED = ["0_{} 1_{}", "{}_0 {}_1", "1_{} 2_{}", "frame{}-0 frame{}-1", "im0_{} im1_{}"]
NUMBERED += ["19443010_{} 19443021_{}"]  # serial numbers, no dates


@pytest.mark.parametrize("names", NUMBERED)
def test_pairs_by_content(tmp_path: Path, names: str) -> None:
    for name, right in zip(names.split(), (False, True), strict=True):
        for key, image in zip(COUNTERS, views(right, COUNT), strict=True):
            layouts.write_image(tmp_path / f"{name.format(key)}.png", image)
    found = find_cameras(list_images(tmp_path))
    left, right_name = names.split()
    assert [path.stem for path in found.left.images] == [left.format(key) for key in COUNTERS]
    assert found.right is not None
    assert [p.stem for p in found.right.images] == [right_name.format(key) for key in COUNTERS]


@pytest.mark.parametrize("is_in_turn", [True, False])
def test_images_of_two_cameras_in_turn_are_doubtful(
    tmp_path: Path, is_in_turn: bool, caplog: pytest.LogCaptureFixture
) -> None:
    for i in range(12):
        layouts.write_image(tmp_path / f"{i}.png", views(is_in_turn and i % 2 == 1, 12)[i])
    layouts.write_text(tmp_path / "calibration.yaml", LARGER)
    assert len(open_source(tmp_path)) == 12
    assert ("of two cameras in turn, and are read as one" in caplog.text) == is_in_turn


def test_one_camera_counted_in_parts_stays_one(tmp_path: Path) -> None:
    for i, image in enumerate(views(False, 12)):
        layouts.write_image(tmp_path / f"part_{i // 6}_{i % 6}.png", image)
    assert len(find_cameras(list_images(tmp_path)).left.images) == 12


def test_times_say_that_images_are_of_one_camera(tmp_path: Path) -> None:
    for i, image in enumerate(views(False, 12)):  # two images of each number
        layouts.write_image(tmp_path / f"{i // 2}_{i % 2}.png", image)
    layouts.write_text(tmp_path / "calibration.yaml", LARGER)
    with pytest.raises(SourceError, match="2 cameras; .* add times.txt with the time of each"):
        open_source(tmp_path)
    layouts.write_text(tmp_path / "times.txt", "".join(f"{0.1 * i:.1f}\n" for i in range(12)))
    assert len(open_source(tmp_path)) == 12


def test_images_of_one_name_with_two_suffixes_are_of_two_cameras(tmp_path: Path) -> None:
    for i in range(COUNT):
        layouts.write_image(tmp_path / f"{i}.jpg", layouts.image(i))
        layouts.write_image(tmp_path / f"{i}.png", np.full((48, 64), 1000 + i, np.uint16))
    found = find_cameras(list_images(tmp_path))
    assert found.depth is not None
    assert [path.name for path in found.left.images] == [f"{i}.jpg" for i in range(COUNT)]
