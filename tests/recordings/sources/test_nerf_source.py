"""Recordings with NeRF's transforms.json."""

from __future__ import annotations

import json
from pathlib import Path

import layouts
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.recordings.sources.registry import detect_format, open_source


def write(folder: Path, edit: dict[str, object]) -> Path:
    layouts.write_nerf(folder)
    path = folder / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | edit))
    return path


def test_images_without_a_pose_keep_their_place(tmp_path: Path) -> None:
    path = write(tmp_path, {})
    frames = json.loads(path.read_text())["frames"]  # in reverse order
    write(tmp_path, {"frames": [frame for i, frame in enumerate(frames) if i not in (1, 3)]})
    source = open_source(tmp_path)
    assert len(source) == layouts.COUNT
    assert source.ground_truth is not None
    kept = [0, 1, 3, 5]
    assert source.ground_truth.stamps_ns.tolist() == [layouts.STAMPS_NS[i] for i in kept]
    expected = [layouts.truth()[i] for i in kept]
    np.testing.assert_allclose(source.ground_truth.world_from_cam, expected, atol=1e-12)


def test_the_file_itself_and_names_without_suffix(tmp_path: Path) -> None:
    path = write(tmp_path, {})
    data = json.loads(path.read_text())
    for frame in data["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    path.write_text(json.dumps(data))
    assert detect_format(path) == "nerf"
    source = open_source(path)
    assert source.ground_truth is not None
    assert (len(source), len(source.ground_truth)) == (layouts.COUNT, layouts.COUNT)


def test_stamps_are_those_of_the_folder_of_images(tmp_path: Path) -> None:
    write(tmp_path, {})
    (tmp_path / "times.txt").unlink()
    calibration = tmp_path / "transforms.json"
    plain = open_source(tmp_path / "images", calibration=calibration)
    assert plain.stamps_ns.tolist() == open_source(tmp_path).stamps_ns.tolist()
    assert plain.rig.cam0 == open_source(tmp_path).rig.cam0


def test_errors(tmp_path: Path) -> None:
    path = write(tmp_path, {"frames": []})
    with pytest.raises(SourceError, match="has no list `frames` with poses"):
        open_source(tmp_path)
    frame = {"file_path": "../elsewhere/1.png", "transform_matrix": np.eye(4).tolist()}
    write(tmp_path, {"frames": [frame]})
    with pytest.raises(SourceError, match=r"image ../elsewhere/1.png is outside of the folder"):
        open_source(path)
