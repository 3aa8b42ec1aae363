"""Second sessions in the map of a first one."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import vo
from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.writers import euroc
from vo.base.config import load_config
from vo.base.errors import ConfigError, OutputError, SourceError
from vo.base.types import Floats, Trajectory
from vo.cli.app import app
from vo.engine.maps.map_file import MapFile, write_map
from vo.engine.places.records import MarkerVisit
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

END = 45


def _render(folder: Path, session: int) -> Path:
    """A part of a round through a room at 10 Hz, as EuRoC, in stereo images of 301 x 192."""
    settings = ["motion=loop", "seconds=40", "fps=10", "scale=0.4", f"session={session}"]
    plan = make_plan(load_recipe("demo", settings))
    taken = slice(END)
    truth = plan.recording.cam0_truth
    recording = replace(
        plan.recording,
        stamps_ns=tuple(stamps[taken] for stamps in plan.recording.stamps_ns),
        dropped=tuple(dropped[taken] for dropped in plan.recording.dropped),
        cam0_truth=Trajectory(truth.stamps_ns[taken], truth.world_from_cam[taken]),
    )
    with ThreadPoolExecutor() as pool:
        euroc.write(folder, recording, render_frames(plan, pool, range(END)), "png")
    return folder


def _run(recording: Path, output: Path, *settings: str, **options: Any) -> dict[str, Any]:
    run(
        recording,
        output,
        config=load_config("default", ["memory.loops=true", *settings]),
        **options,
    )
    summary: dict[str, Any] = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    return summary


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the first session, and its map."""
    folder = tmp_path_factory.mktemp("maps")
    _render(folder / "room", 0)
    _run(folder / "room", folder / "out", save_map=folder / "room.map", mode="stereo")
    return folder


@pytest.fixture(scope="module")
def second(first: Path) -> Path:
    """The second session: other light, noise and path."""
    return _render(first / "again", 1)


def _world_from_map(recording: Path) -> Floats:
    """Pose of the map frame in the true world: the first pose of the first session."""
    return np.asarray(read_tum(recording / "groundtruth.tum").world_from_cam[0])


def _errors(output: Path, recording: Path, world_from_map: Floats) -> Floats:
    """Position errors in metres, in the world of the map, without alignment."""
    path, truth = read_tum(output / "trajectory.tum"), read_tum(recording / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, path.stamps_ns)
    positions = (world_from_map @ path.world_from_cam)[:, :3, 3]
    return np.asarray(np.linalg.norm(positions - truth.world_from_cam[rows][:, :3, 3], axis=1))


@pytest.mark.parametrize("localize", [False, True])
def test_a_second_session_is_in_the_world_of_the_map(
    first: Path, second: Path, tmp_path: Path, localize: bool
) -> None:
    file = first / "room.map"
    before = file.read_bytes()
    saved = tmp_path / "both.map"
    options = {} if localize else {"save_map": saved}
    settings = [f"memory.map={json.dumps(str(file))}", f"memory.localize={json.dumps(localize)}"]
    summary = _run(second, tmp_path / "out", *settings, mode="stereo", **options)
    assert summary["map"]["met"] == [0]
    loops = [loop for loop in summary["loops"] if loop["kind"] == "session"]
    assert len(loops) >= 3
    assert {loop["earlier_session"] for loop in loops} == {0}
    (found,) = summary["relocalisations"]
    assert found["earlier_session"] == 0 and found["frame"] <= 40
    errors = _errors(tmp_path / "out", second, _world_from_map(first / "room"))
    assert len(errors) >= 0.9 * END
    assert np.median(errors) < 0.03
    assert file.read_bytes() == before
    if localize:
        assert len(loops) == len(summary["loops"])
        return
    with MapFile(file) as old, MapFile(saved) as both:
        assert both.header.sessions == (str(first / "room"), str(second))
        assert {key.session for key in both.keys} == {0, 1}
        assert set(old.keys) <= set(both.keys)
        assert set(both.placed.world.tolist()) == {0}
        row_of = {key: n for n, key in enumerate(both.keys)}
        kept = both.placed.world_from_cam[[row_of[key] for key in old.keys]]
        np.testing.assert_allclose(kept, old.placed.world_from_cam, atol=1e-6)


def test_a_run_that_never_meets_the_map_keeps_its_own_world_and_says_so(
    first: Path, second: Path, tmp_path: Path
) -> None:
    setting = f"memory.map={json.dumps(str(first / 'room.map'))}"
    summary = _run(second, tmp_path / "with", setting, mode="stereo", end=4)
    _run(second, tmp_path / "without", mode="stereo", end=4)
    assert summary["map"]["met"] == []
    assert any("no segment was merged with the map" in text for text in summary["warnings"])
    for name in ("trajectory.tum", "causal.tum", "covariance.csv"):
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()


def test_maps_of_another_kind_are_refused(first: Path, tmp_path: Path) -> None:
    file = first / "room.map"
    setting = f"memory.map={json.dumps(str(file))}"
    with pytest.raises(ConfigError, match=r"made with stereo or depth, this run has one camera"):
        _run(first / "room", tmp_path / "mono", setting, mode="mono")
    with pytest.raises(SourceError, match=r"cannot read the map .*none\.map"):
        _run(first / "room", tmp_path / "none", 'memory.map="none.map"')
    cut = tmp_path / "cut.map"
    cut.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(SourceError, match="damaged or cut off"):
        _run(first / "room", tmp_path / "cut", f"memory.map={json.dumps(str(cut))}")


def test_a_map_of_another_camera_is_not_saved_and_the_run_does_not_begin(
    first: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.map"
    with MapFile(first / "room.map") as stored:
        camera = replace(stored.header.camera, fx=1.01 * stored.header.camera.fx)
        keyframes = [(key, stored.encoded(key)) for key in stored.keys]
        write_map(other, replace(stored.header, camera=camera), keyframes, stored.placed)
    setting = f"memory.map={json.dumps(str(other))}"
    with pytest.raises(OutputError, match="made with another camera"):
        _run(first / "room", tmp_path / "out", setting, mode="stereo", save_map=other)
    assert not list((tmp_path / "out").glob("*.*"))


def test_settings_that_contradict_each_other_are_refused(first: Path, tmp_path: Path) -> None:
    setting = f"memory.map={json.dumps(str(first / 'room.map'))}"
    with pytest.raises(ConfigError, match="leave out `memory.loops=false`"):
        _run(first / "room", tmp_path / "a", setting, "memory.loops=false")
    with pytest.raises(ConfigError, match="`memory.map=FILE`"):
        _run(first / "room", tmp_path / "b", "memory.localize=true")
    with pytest.raises(ConfigError, match="leave out `save_map`"):
        _run(
            *(first / "room", tmp_path / "c", setting, "memory.localize=true"),
            save_map=tmp_path / "x.map",
        )


def test_two_maps_of_a_place_are_merged_into_one_world(
    first: Path, second: Path, tmp_path: Path
) -> None:
    other, both = tmp_path / "again.map", tmp_path / "both.map"
    _run(second, tmp_path / "out", save_map=other, mode="stereo")
    maps = [
        _with_marker(path, number, tmp_path / f"{number}.map")
        for number, path in ((7, first / "room.map"), (8, other))
    ]
    done = CliRunner().invoke(app, ["map", "merge", *map(str, maps), "-o", str(both)])
    assert done.exit_code == 0, done.output
    assert "keyframes recognised in both maps" in done.stdout
    contents = vo.maps.info(both)
    assert contents["sessions"] == [str(first / "room"), str(second)]
    only = {"world": 0, "keyframes": contents["keyframes"], "length_unit": "m"}
    assert contents["worlds"] == [only]
    assert [(each["id"], each["world"]) for each in contents["markers"]] == [(7, 0), (8, 0)]
    truth, world_from_map = read_tum(second / "groundtruth.tum"), _world_from_map(first / "room")
    with MapFile(first / "room.map") as old, vo.maps.load(both) as merged:
        poses = dict(zip(merged.placed.keys, merged.placed.world_from_cam, strict=True))
        for key, pose in zip(old.placed.keys, old.placed.world_from_cam, strict=True):
            np.testing.assert_allclose(poses[key], pose, atol=1e-9)
        errors = []
        assert [each.key.session for each in merged.markers] == [0, 1]
        for key in merged.keys:
            if key.session == 1:
                row = np.searchsorted(truth.stamps_ns, merged.place(key).frame.stamp_ns)
                position = (world_from_map @ poses[key])[:3, 3]
                errors.append(np.linalg.norm(position - truth.positions[row]))
    assert len(errors) >= 5 and np.median(errors) < 0.03
    # The merged map is one to continue in, and to export.
    setting = f"memory.map={json.dumps(str(both))}"
    again = _run(second, tmp_path / "in", setting, "memory.localize=true", mode="stereo")
    assert again["map"]["met"] == [0]
    assert vo.maps.export(both, tmp_path / "both.ply") > 1000


def _with_marker(path: Path, number: int, copy: Path) -> Path:
    """A copy of a map, with a marker at its first keyframe."""
    with MapFile(path) as stored:
        marker = MarkerVisit(stored.keys[0], number, "4X4_50", 0.16, np.eye(4), np.eye(7), 3)
        keyframes = [(key, stored.encoded(key)) for key in stored.keys]
        write_map(copy, stored.header, keyframes, stored.placed, stored.loops, [marker])
    return copy


def test_maps_that_share_no_place_are_not_merged(first: Path, second: Path, tmp_path: Path) -> None:
    mirrored = replace_images(second, tmp_path / "mirrored")
    other, both = tmp_path / "mirrored.map", tmp_path / "both.map"
    _run(mirrored, tmp_path / "out", save_map=other, mode="stereo")
    with pytest.raises(ConfigError, match="share no place that is recognised"):
        vo.maps.merge(first / "room.map", other, both)
    assert not both.exists()
    with pytest.raises(OutputError, match="is an input and would be replaced"):
        vo.maps.merge(first / "room.map", other, other)


def replace_images(recording: Path, folder: Path) -> Path:
    """A copy of a recording whose images are upside down: another place, consistent in itself."""
    shutil.copytree(recording, folder)
    for path in folder.rglob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[::-1])
    return folder
