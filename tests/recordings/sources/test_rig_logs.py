"""Logs with the images of more than two cameras."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from camera_logs import FISHEYE, LENS, OnTopic, calibration, fixed, images, log
from mcap_logs import DIALECTS

from vo.base.errors import SourceError
from vo.base.geometry.transforms import inverse, se3_exp
from vo.recordings.sources.registry import open_source

NAMES = ("FRONT", "FRONT_LEFT", "BACK")
BODY_FROM_CAMS = [
    se3_exp(np.array([0.01, yaw, 0.02, 0.3 * i, 0.1, 1.0])) for i, yaw in enumerate((0.0, 0.9, 3.0))
]


def rig_parts(names: Iterable[str] = NAMES, joined: int = 3) -> list[OnTopic]:
    """Cameras as in logs of nuScenes: a namespace, a calibration and a frame each."""
    parts: list[OnTopic] = []
    for number, name in enumerate(names):
        parts += images(f"/{name}/image_raw", name)
        lens = FISHEYE if number == 2 else LENS
        parts.append(calibration(f"/{name}/camera_info", name, lens))
    pairs = list(zip(names, BODY_FROM_CAMS, strict=False))[:joined]
    parts.append(fixed(*(("base_link", name, pose) for name, pose in pairs)))
    return sorted(parts, key=lambda part: part[1].stamp_ns)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_all_cameras_that_transforms_join_are_a_rig(tmp_path: Path, dialect: str) -> None:
    source = open_source(log(tmp_path, rig_parts(), dialect=dialect))
    # The one that looks ahead comes first.
    expected = inverse(BODY_FROM_CAMS[0]) @ np.stack([BODY_FROM_CAMS[i] for i in (0, 2, 1)])
    np.testing.assert_allclose(source.rig.cam0_from_cams, expected, atol=1e-9)
    assert source.rig.cameras == (LENS, FISHEYE, LENS)
    frames = list(source.frames())
    assert len(frames) == 4
    assert all(each is not None for frame in frames for each in frame.images)


def test_topics_in_their_order_are_the_cameras(tmp_path: Path) -> None:
    path = log(tmp_path, rig_parts())
    topics = [f"/{name}/image_raw" for name in ("BACK", "FRONT", "FRONT_LEFT")]
    rig = open_source(path, topics=topics).rig
    assert rig.cameras == (FISHEYE, LENS, LENS)
    np.testing.assert_allclose(
        rig.cam0_from_cams[1], inverse(BODY_FROM_CAMS[2]) @ BODY_FROM_CAMS[0], atol=1e-9
    )
    assert len(open_source(path, topics=topics[:1]).rig.cameras) == 1
    with pytest.raises(SourceError, match="gives /BACK/image_raw twice"):
        open_source(path, topics=[topics[0], topics[1], topics[0]])


def test_cameras_without_a_pose_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    names = ("cam0", "cam1", "cam2", "cam3")
    path = log(tmp_path, rig_parts(names, joined=3))
    assert len(open_source(path).rig.cameras) == 3
    assert "/cam3/image_raw is not used: no calibration" not in caplog.text
    assert "/cam3/image_raw is not used: no transforms connect its frame" in caplog.text


def test_cameras_that_nothing_joins_are_still_asked_for(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="which of 3 cameras"):
        open_source(log(tmp_path, rig_parts(joined=2)))


def test_a_third_camera_of_another_name_leaves_a_pair(tmp_path: Path) -> None:
    path = log(tmp_path, rig_parts(("infra1", "infra2", "color")))
    assert len(open_source(path).rig.cameras) == 2
