from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.sequence import FIRST_STAMP_NS, body_from_cam0, make_sequence, stereo_rig
from vo.errors import ConfigError, OutputError
from vo.formats.trajectory import read_euroc, read_tum
from vo.sources.registry import open_source

SMALL = {"seconds": 0.3, "fps": 10.0, "width": 160, "height": 100}


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synth") / "walk"
    make_sequence(folder, **SMALL)
    return folder


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_same_seed_gives_same_bytes_and_another_seed_others(sequence: Path, tmp_path: Path) -> None:
    make_sequence(tmp_path / "again", **SMALL)
    make_sequence(tmp_path / "other", **SMALL, seed=1)
    first, again, other = (_digests(p) for p in (sequence, tmp_path / "again", tmp_path / "other"))
    assert len(first) == 3 * 2 + 2 * 2 + 2
    assert first == again
    images = [name for name in first if name.endswith(".png")]
    assert all(first[name] != other[name] for name in images)


def test_stands_complete_with_nothing_left_beside(sequence: Path) -> None:
    assert [p.name for p in sequence.parent.iterdir()] == ["walk"]
    stamps = [FIRST_STAMP_NS + i * 100_000_000 for i in range(3)]
    for camera in ("cam0", "cam1"):
        files = sorted((sequence / "mav0" / camera / "data").iterdir())
        assert [p.name for p in files] == [f"{s}.png" for s in stamps]
        assert cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED).shape == (100, 160)


def test_body_truth_and_camera_truth_agree(sequence: Path) -> None:
    camera = read_tum(sequence / "groundtruth.tum")
    body = read_euroc(sequence / "mav0" / "state_groundtruth_estimate0" / "data.csv")
    np.testing.assert_array_equal(camera.stamps_ns, body.stamps_ns)
    np.testing.assert_allclose(
        body.world_from_cam @ body_from_cam0(), camera.world_from_cam, atol=1e-7
    )


def test_body_velocity_is_the_change_of_its_position(tmp_path: Path) -> None:
    make_sequence(tmp_path / "next", seconds=8.0, fps=100 / 8, width=32, height=32)
    table = np.loadtxt(
        tmp_path / "next" / "mav0" / "state_groundtruth_estimate0" / "data.csv", delimiter=","
    )
    central = (table[2:, 1:4] - table[:-2, 1:4]) / (2 * 0.08)
    np.testing.assert_allclose(table[1:-1, 8:11], central, atol=0.05)


def test_opens_as_a_rectified_stereo_source_with_truth(sequence: Path) -> None:
    source = open_source(sequence)
    assert source.format == "euroc"
    assert source.rig.is_stereo and not source.rig.cam0.is_distorted
    assert source.rig.cam1_from_cam0 is not None
    expected = stereo_rig(160, 100).cam1_from_cam0
    np.testing.assert_allclose(source.rig.cam1_from_cam0, expected, atol=1e-9)
    assert source.ground_truth is not None
    truth = read_tum(sequence / "groundtruth.tum")
    np.testing.assert_allclose(source.ground_truth.positions, truth.positions, atol=1e-7)
    assert [frame.image1 is not None for frame in source.frames()] == [True] * 3


def test_reports_progress(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    make_sequence(
        tmp_path / "out", **SMALL, on_frame=lambda done, total: seen.append((done, total))
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_interruption_leaves_nothing(tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_sequence(tmp_path / "out", **SMALL, on_frame=stop)
    assert list(tmp_path.iterdir()) == []


def test_refuses_a_folder_with_something_in_it(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(OutputError, match="not an empty folder"):
        make_sequence(tmp_path, **SMALL)
    assert (tmp_path / "note.txt").read_text() == "mine"


def test_a_place_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        make_sequence(tmp_path / "file" / "out", **SMALL)


@pytest.mark.parametrize(
    "wrong", [{"seconds": -1.0}, {"fps": 0.0}, {"fps": float("nan")}, {"width": 0}, {"noise": -2.0}]
)
def test_impossible_numbers_are_config_errors(tmp_path: Path, wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"{next(iter(wrong))} is"):
        make_sequence(tmp_path / "out", **{**SMALL, **wrong})
