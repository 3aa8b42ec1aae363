"""Frames of rigs of which any camera, the first too, may lack images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from camera_logs import log
from layouts import STAMPS_NS
from test_rig_datasets import write_kitti_360, write_nuscenes
from test_rig_logs import rig_parts
from test_rigs import kalibr, write_mav

from vo.base.errors import SourceError
from vo.base.types import with_image0
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.rig_frames import rig_frames

MS = 1_000_000


def shots(stamps_ms: Sequence[float]) -> list[Shot]:
    return [Shot(round(s * MS), ImageFile(Path(f"{s:g}.png")), "here") for s in stamps_ms]


def rows(*cameras_ms: Sequence[float]) -> list[list[float]]:
    """Of each frame its time, and those of its images by camera, -1 without one, in ms."""
    found = rig_frames(shots(cameras_ms[0]), [shots(each) for each in cameras_ms[1:]])
    for own_ns, camera in zip(found.stamps_ns[1:], found.others, strict=True):
        assert [ns >= 0 for ns in own_ns.tolist()] == [image is not None for image in camera]
    stamps = np.stack([[shot.stamp_ns for shot in found.first], *found.stamps_ns], axis=1)
    return np.where(stamps < 0, -1, stamps / MS).tolist()


def test_other_cameras_make_the_frames_that_camera_0_lacks() -> None:
    times = [0.0, 100.0, 200.0, 300.0, 400.0]
    some = [0.0, 100.0, 400.0]
    assert rows(some, times, times) == [[t, t if t in some else -1, t, t] for t in times]
    # The second fills in for the first two, before, between and behind their images.
    assert rows([100.0, 200.0, 400.0], [100.0, 200.0, 300.0, 400.0], [*times, 500.0]) == [
        [0, -1, -1, 0], [100, 100, 100, 100], [200, 200, 200, 200], [300, -1, 300, 300],
        [400, 400, 400, 400], [500, -1, -1, 500],
    ]  # fmt: skip


def test_frames_without_camera_0_are_at_the_time_that_its_image_would_have() -> None:
    late = [30.0 + 100.0 * i for i in range(5)]
    found = rows([0.0, 100.0, 300.0, 400.0], late)
    assert found[2] == [200, -1, 230]
    assert [row[0] for row in found] == [0, 100, 200, 300, 400]


def test_cameras_of_a_higher_rate_or_another_clock_make_no_frames() -> None:
    slow = [100.0 * i for i in range(8)]
    fast = [33.0 * i for i in range(24)]
    assert [row[0] for row in rows(slow, fast)] == slow
    gap = slow[:3] + slow[6:]  # in which frames keep about the rate of camera 0
    assert len(rows(gap, fast)) == 8
    other = [1e6 + t for t in slow]
    assert rows(slow, other) == [[t, t, -1] for t in slow]
    free_running = [47.0 + 91.0 * i for i in range(9)]
    assert [row[0] for row in rows(slow, free_running)] == slow


def write_incomplete(root: Path) -> Path:
    """Four cameras; one image of camera 0 is not listed, the next one damaged."""
    path = write_mav(root / "log", 4)
    (path / "calibration.yaml").write_text(yaml.safe_dump(kalibr(4)), encoding="utf-8")
    table = path / "mav0" / "cam0" / "data.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join([*lines[:2], *lines[3:]]), encoding="utf-8")
    (path / "mav0" / "cam0" / "data" / f"{STAMPS_NS[3]}.png").write_bytes(b"\x89PNG")
    return path


def test_a_folder_of_which_camera_0_has_lost_images(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_incomplete(tmp_path)
    source = open_source(path, calibration=path / "calibration.yaml")
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == STAMPS_NS
    for frame in frames:
        found = [each is not None and int(each[0, 1]) for each in frame.images]
        assert found == [False if frame.index in (2, 3) else 0, 1, 2, 3]
        assert all(each is None or each[0, 0] == frame.index for each in frame.images)
    assert (source.unpaired, source.skipped) == (2, [])
    assert "frame 3 used without its cam0 image" in caplog.text
    assert "frame 2" not in caplog.text  # nothing is wrong with an image that is not there
    assert [frame.index for frame in with_image0(frames)] == [0, 1, 4, 5]
    for number in (1, 2, 3):
        (path / "mav0" / f"cam{number}" / "data" / f"{STAMPS_NS[3]}.png").write_bytes(b"\x89PNG")
    assert [frame.index for frame in source.frames()] == [0, 1, 2, 4, 5]
    assert [skipped.index for skipped in source.skipped] == [3]


def test_a_camera_0_that_begins_late_has_its_size_from_its_own_images(tmp_path: Path) -> None:
    path = write_mav(tmp_path / "log", 3)
    (path / "chain.yaml").write_text(yaml.safe_dump(kalibr(3)), encoding="utf-8")
    table = path / "mav0" / "cam0" / "data.csv"
    table.write_text("\n".join(table.read_text("utf-8").splitlines()[3:]), encoding="utf-8")
    source = open_source(path, calibration=path / "chain.yaml")
    assert len(list(source.frames())) == len(source) == 6
    assert source.first_image.name.endswith(f"{STAMPS_NS[3]}.png")


def test_a_log_of_which_camera_0_has_lost_messages(tmp_path: Path) -> None:
    lost = "/FRONT/image_raw", STAMPS_NS[2]
    parts = [part for part in rig_parts() if (part[0], part[1].stamp_ns) != lost]
    frames = list(open_source(log(tmp_path, parts)).frames())
    assert [frame.stamp_ns for frame in frames] == STAMPS_NS[:4]
    assert [frame.images[0] is None for frame in frames] == [False, False, True, False]
    assert all(each is not None for frame in frames for each in frame.images[1:])


def test_datasets_of_which_camera_0_has_lost_images(tmp_path: Path) -> None:
    tables = write_nuscenes(tmp_path / "nuscenes")
    front = sorted((tmp_path / "nuscenes" / "sweeps" / "CAM_FRONT").iterdir())
    front[1].unlink()
    frames = list(open_source(tables / "scene-0061").frames())
    assert [frame.images[0] is None for frame in frames] == [False, False, True, False]
    drive = write_kitti_360(tmp_path / "kitti", range(5))
    (drive / "image_00" / "data_rect" / f"{2:010d}.png").unlink()
    frames = list(open_source(drive).frames())
    assert [frame.images[0] is None for frame in frames] == [False, False, True, False, False]
    assert frames[2].stamp_ns - frames[1].stamp_ns == 100_000_000
    assert all(each is not None for frame in frames for each in frame.images[1:])


def test_a_camera_0_without_any_image_is_refused(tmp_path: Path) -> None:
    path = write_incomplete(tmp_path)
    for image in (path / "mav0" / "cam0" / "data").iterdir():
        image.write_bytes(b"\x89PNG")
    with pytest.raises(SourceError, match="none of 5 images can be read"):
        open_source(path, calibration=path / "calibration.yaml")
