from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.cache import cached_sequence
from data_synth.plan import FIRST_STAMP_NS, make_plan
from data_synth.recipe import Recipe, load_recipe
from data_synth.sequence import make_sequence
from vo.base.errors import CalibrationError, ConfigError, OutputError
from vo.recordings.formats.trajectory import read_euroc, read_tum
from vo.recordings.sources.registry import open_source

SMALL = ["seconds=0.3", "fps=10", "scale=0.25"]


def _recipe(*settings: str, preset: str = "demo") -> Recipe:
    return load_recipe(preset, ["motion=handheld", *SMALL, *settings])


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synth") / "walk"
    make_sequence(folder, _recipe())
    return folder


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_bytes_of_a_recording_depend_on_the_seed_only(sequence: Path, tmp_path: Path) -> None:
    make_sequence(tmp_path / "again", _recipe())
    make_sequence(tmp_path / "other", _recipe("seed=1"))
    first, again, other = (_digests(p) for p in (sequence, tmp_path / "again", tmp_path / "other"))
    assert first == again
    images = [name for name in first if name.endswith(".png")]
    assert len(images) == 6
    assert all(first[name] != other[name] for name in images)


def test_another_process_gives_the_same_bytes(sequence: Path, tmp_path: Path) -> None:
    program = (
        "import sys; from data_synth.recipe import load_recipe\n"
        "from data_synth.sequence import make_sequence\n"
        "make_sequence(sys.argv[1], load_recipe(sys.argv[2]))"
    )
    recipe = str(sequence / "recipe.yaml")
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    command = [sys.executable, "-c", program, str(tmp_path / "again"), recipe]
    subprocess.run(command, check=True, env=environment)
    assert _digests(tmp_path / "again") == _digests(sequence)


def test_recording_is_complete_and_no_temporary_file_remains(sequence: Path) -> None:
    assert [p.name for p in sequence.parent.iterdir()] == ["walk"]
    stamps = [FIRST_STAMP_NS + i * 100_000_000 for i in range(3)]
    for camera in ("cam0", "cam1"):
        files = sorted((sequence / "mav0" / camera / "data").iterdir())
        assert [p.name for p in files] == [f"{s}.png" for s in stamps]
        assert cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED).shape == (100, 160)


def test_body_truth_and_camera_truth_agree(tmp_path: Path) -> None:
    recording = make_sequence(tmp_path / "made", _recipe("imu.rate_hz=100"))
    camera = read_tum(tmp_path / "made" / "groundtruth.tum")
    home = tmp_path / "made" / "mav0" / "state_groundtruth_estimate0"
    body = read_euroc(home / "data.csv")
    _, mine, theirs = np.intersect1d(camera.stamps_ns, body.stamps_ns, return_indices=True)
    assert len(mine) == 3
    np.testing.assert_allclose(
        body.world_from_cam[theirs] @ recording.body_from_cam0,
        camera.world_from_cam[mine],
        atol=1e-6,
    )


def test_recording_opens_as_a_rectified_stereo_source_with_truth(sequence: Path) -> None:
    source = open_source(sequence)
    assert source.format == "euroc"
    assert source.rig.is_stereo and not source.rig.cam0.is_distorted
    assert source.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(source.rig.cam1_from_cam0[:3, 3], (-0.12, 0, 0), atol=1e-12)
    truth = read_tum(sequence / "groundtruth.tum")
    assert len(truth) == 3
    assert [frame.image1 is not None for frame in source.frames()] == [True] * 3


def test_black_and_lost_frames_match_the_plan(tmp_path: Path) -> None:
    effects = ["effects.blackout=2", "effects.drops=40", "effects.noise=0", "seconds=1"]
    recording = make_sequence(tmp_path / "made", _recipe(*effects))
    means = {}
    for frame in open_source(tmp_path / "made", mode="mono").frames():
        means[frame.stamp_ns] = float(frame.image0.mean())
    stamps = recording.stamps_ns[0]
    assert set(means) == set(stamps[~recording.dropped[0]].tolist())
    assert 0 < recording.dropped[0].sum() < 10
    black = [bool(means[s] == 0.0) for s in stamps[4:6].tolist() if s in means]
    assert black and all(black)
    assert all(mean > 20 for stamp, mean in means.items() if stamp not in stamps[4:6])


def test_another_session_has_its_own_path_and_light_in_the_same_world() -> None:
    first, again = (make_plan(_recipe(f"session={n}")) for n in (0, 1))
    worlds = first.scene.world, again.scene.world
    np.testing.assert_array_equal(worlds[0].shapes, worlds[1].shapes)
    np.testing.assert_array_equal(worlds[0].atlas.texels, worlds[1].atlas.texels)
    assert not np.array_equal(worlds[0].lights.values, worlds[1].lights.values)
    paths = first.recording.cam0_truth.positions, again.recording.cam0_truth.positions
    assert np.linalg.norm(paths[0] - paths[1], axis=1).min() > 0.001


def test_kidnapped_recording_has_black_frames_and_no_inertial_measurements(tmp_path: Path) -> None:
    effects = ["effects.kidnap=1", "effects.kidnap_black=2", "effects.noise=0", "seconds=2"]
    recording = make_sequence(tmp_path / "made", _recipe(*effects))
    frames = list(open_source(tmp_path / "made", mode="mono").frames())
    black = [k for k, frame in enumerate(frames) if not frame.image0.any()]
    assert black == [9, 10, 14, 15]
    steps = np.linalg.norm(np.diff(recording.cam0_truth.positions, axis=0), axis=1)
    assert steps[8] > 3.0 * np.median(steps)
    assert recording.imu is None
    assert len(recording.body_truth.stamps_ns) == 20


def test_bodies_that_would_hit_the_camera_are_removed(tmp_path: Path) -> None:
    recording = make_sequence(
        tmp_path / "made", _recipe("world=corridor", "effects.movers=3", "seconds=2")
    )
    assert recording.movers
    camera = recording.cam0_truth.positions[:, :2]
    for mover in recording.movers:
        apart = np.linalg.norm(mover.world_from_mover[:, :2, 3] - camera, axis=1)
        assert apart.min() > 0.5
    assert (tmp_path / "made" / "movers.csv").is_file()


def test_readout_time_is_in_the_calibration_with_a_rolling_shutter_only(tmp_path: Path) -> None:
    rolling = make_sequence(tmp_path / "rolling", _recipe("effects.rolling_shutter=1.5"))
    assert open_source(tmp_path / "rolling").rig.cam0.readout_s == pytest.approx(0.03)
    assert rolling.rig.cam1 is not None and rolling.rig.cam1.readout_s == pytest.approx(0.03)
    make_sequence(tmp_path / "global", _recipe())
    assert open_source(tmp_path / "global").rig.cam0.readout_s == 0.0
    for file in (tmp_path / "global").rglob("*.yaml"):
        assert "readout_s" not in file.read_text()


def test_progress_is_reported_after_each_frame(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    make_sequence(
        tmp_path / "out", _recipe(), on_frame=lambda done, total: seen.append((done, total))
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize("format", ["euroc", "mcap"])
def test_interruption_leaves_no_files(tmp_path: Path, format: str) -> None:
    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_sequence(tmp_path / "out", _recipe(f"format={format}"), on_frame=stop)
    assert list(tmp_path.iterdir()) == []


def test_refuses_existing_output_and_replaces_it_only_by_force(tmp_path: Path) -> None:
    make_sequence(tmp_path / "out", _recipe())
    with pytest.raises(OutputError, match=r"exists already; choose another path, or `force`"):
        make_sequence(tmp_path / "out", _recipe())
    make_sequence(tmp_path / "out", _recipe("seconds=0.2"), force=True)
    assert len(read_tum(tmp_path / "out" / "groundtruth.tum")) == 2


def test_force_does_not_remove_other_folders(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not a synthetic recording"):
        make_sequence(tmp_path, _recipe(), force=True)
    assert (tmp_path / "note.txt").read_text() == "mine"


def test_unwritable_path_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        make_sequence(tmp_path / "file" / "out", _recipe())


def test_full_disk_is_an_output_error_and_leaves_no_files(tmp_path: Path) -> None:
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))  # each file may have 4 kB
    try:
        with pytest.raises(OutputError, match="cannot be written: File too large"):
            make_sequence(tmp_path / "out", _recipe())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("seconds=-1", "setting 'seconds'"),
        ("fps=0", "setting 'fps'"),
        ("fps=.nan", "setting 'fps'"),
        ("world=moon", "setting 'world'"),
        ("effects.blur=-2", "setting 'effects.blur'"),
        ("effects.blurr=1", "did you mean 'effects.blur'"),
        ("camera=eurok", "no camera named 'eurok'; .*did you mean 'euroc'"),
        ("codec=raw", "format euroc does not support codec raw"),
    ],
)
def test_infeasible_settings_are_config_errors(tmp_path: Path, setting: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_sequence(tmp_path / "out", _recipe(setting))
    assert list(tmp_path.iterdir()) == []


def test_error_of_an_unknown_preset_suggests_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match="no preset named 'kiti'; .*did you mean 'kitti'"):
        load_recipe("kiti")


def test_error_of_a_loop_that_does_not_fit_contains_its_duration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="s or more at this speed; 0.3 s are too short"):
        make_sequence(tmp_path / "out", _recipe("motion=loop", "world=warehouse"))


def test_invalid_camera_file_is_a_calibration_error(tmp_path: Path) -> None:
    camera = tmp_path / "camera.yaml"
    camera.write_text("cam0: {resolution: [640, 480], intrinsics: [-5, 500, 320, 240]}")
    with pytest.raises(CalibrationError):
        make_sequence(tmp_path / "out", _recipe(f"camera={camera}"))


def test_cached_recording_is_made_once_for_each_recipe(tmp_path: Path) -> None:
    first = cached_sequence(_recipe(), tmp_path, "walk")
    made = (first / "groundtruth.tum").stat().st_mtime_ns
    assert cached_sequence(_recipe(), tmp_path, "walk") == first
    assert (first / "groundtruth.tum").stat().st_mtime_ns == made
    assert cached_sequence(_recipe("seed=1"), tmp_path, "walk") != first
