"""Markers that maps keep, and second sessions that only markers place in the map."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marker_course import LAP, SEVEN, THREE, TRUTH, Course, marker_at, simulate
from room_course import CHANGED, DICTIONARY, LENGTH_M, run_rounds
from typer.testing import CliRunner

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse
from vo.base.records.metric_scale import MetricScale, ScaleFindings, without_metric
from vo.base.types import Floats
from vo.cli.app import app
from vo.engine.maps.map_file import MapFile
from vo.engine.maps.markers import at_keyframes
from vo.recordings.formats.trajectory import read_tum
from vo.runs.scaling.scale_sources import ScaleOptions
from vo.tools.maps.contents import map_contents

MARKERS = ScaleOptions(marker_length_m=LENGTH_M, marker_dictionary=DICTIONARY)
ONE = marker_at(TRUTH, 75)


def _worlds(course: Course) -> tuple[set[int], Floats]:
    """Worlds of the run in its map, and the errors (m) of its keyframes relative to the first."""
    placed = course.placed()
    own = [n for n, key in enumerate(placed.keys) if key.session == 1]
    first = placed.world_from_cam[0]
    errors = [
        np.linalg.norm(
            (inverse(first) @ placed.world_from_cam[n])[:3, 3]
            - (inverse(TRUTH[0]) @ TRUTH[placed.keys[n].keyframe])[:3, 3]
        )
        for n in own
    ]
    return set(placed.world[own].tolist()), np.array(errors)


@pytest.mark.parametrize("is_metric", [True, False])
def test_a_session_is_placed_in_the_map_by_its_markers(is_metric: bool) -> None:
    markers = {7: [SEVEN], 3: [THREE]}
    first = simulate(markers, keyframes=LAP, noise=0.0, is_metric=is_metric)
    second = simulate(markers, keyframes=LAP, noise=0.0, is_metric=is_metric, before=first)
    worlds, errors = _worlds(second)
    assert worlds == {0}
    assert errors.max() < 1e-4
    assert {loop.earlier.session for loop in second.loops} == {0}
    assert second.markers.notes == ()
    # Those of both sessions are kept.
    assert [(each.id, each.key.session) for each in second.markers.known] == [
        *((3, 0), (3, 1)),
        *((7, 0), (7, 1)),
    ]


def test_a_marker_that_was_moved_since_then_is_refused_and_named() -> None:
    first = simulate({7: [SEVEN], 3: [THREE], 1: [ONE]}, keyframes=LAP)
    moved = marker_at(TRUTH, 75, 1.0)
    second = simulate({7: [SEVEN], 3: [THREE], 1: [moved]}, seed=1, keyframes=LAP, before=first)
    worlds, errors = _worlds(second)
    assert worlds == {0}
    assert np.sqrt(np.mean(errors**2)) < 0.1
    assert {loop.marker for loop in second.placed().rejected} == {1}
    (note,) = second.markers.notes
    assert note.startswith("marker 1 of the map is not used") and "it was moved" in note
    assert {each.id for each in second.markers.known} == {3, 7}  # the next session learns it anew


def test_two_markers_that_contradict_each_other_place_nothing() -> None:
    first = simulate({7: [SEVEN], 3: [THREE]}, keyframes=LAP)
    moved = marker_at(TRUTH, 50, 1.0)
    second = simulate({7: [SEVEN], 3: [moved]}, seed=1, keyframes=LAP, before=first)
    placed = second.placed()
    assert set(placed.world.tolist()) == {0, 1}
    assert len(second.markers.notes) == 2


@pytest.mark.parametrize(
    "changes", [{"length_m": 0.25}, {"dictionary": "APRILTAG_36H11"}], ids=["length", "dictionary"]
)
def test_another_marker_of_the_same_id_is_not_the_one_of_the_map(changes: dict[str, Any]) -> None:
    first = simulate({7: [SEVEN]}, keyframes=LAP)
    second = simulate({7: [SEVEN]}, keyframes=LAP, before=first, **changes)
    assert second.loops == []
    (note,) = second.markers.notes
    assert note.startswith("marker 7 of the map is not used: it is of 4X4_50 with sides of 0.3 m")


def test_a_marker_is_kept_although_the_map_leaves_its_keyframe_out() -> None:
    course = simulate({7: [SEVEN]}, keyframes=30, noise=0.0)
    placed = course.placed()
    (marker,) = course.markers.known
    known = {key for key in placed.keys if key.keyframe % 10 == 9}
    (moved,) = at_keyframes([marker], placed, known)
    assert moved.key in known and moved.key != marker.key
    poses = TRUTH[marker.key.keyframe], TRUTH[moved.key.keyframe]
    expected = inverse(poses[1]) @ poses[0] @ marker.cam_from_marker
    np.testing.assert_allclose(moved.cam_from_marker, expected, atol=1e-9)
    assert at_keyframes([marker], placed, set()) == []


def test_the_metres_of_a_loaded_map_are_kept() -> None:
    scales = tuple(MetricScale(n, 1.02, 0.003, "markers 7") for n in range(2))
    kept = without_metric(ScaleFindings(scales), (1,))
    assert kept.scales == scales[:1]
    (note,) = kept.notes
    assert "in segment 1 all lengths would be +2.0% longer by markers 7" in note
    exact = ScaleFindings((MetricScale(1, 1.005, 0.003, "markers 7"),))
    assert without_metric(exact, (1,)) == ScaleFindings()


@pytest.fixture(scope="module")
def surveyed(changed_room: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the results of the first session, and its map."""
    folder = tmp_path_factory.mktemp("surveyed")
    saved = folder / "room.map"
    run_rounds(
        *(changed_room, folder / "out", "memory.loops=true"),
        end=60,
        scale=MARKERS,
        save_map=saved,
    )
    return folder


def test_a_marker_alone_leads_to_the_map_of_a_room_that_looks_different(
    surveyed: Path, changed_room: Path, tmp_path: Path
) -> None:
    file, saved, output = surveyed / "room.map", tmp_path / "both.map", tmp_path / "out"
    settings = ("memory.loops=true", f"memory.map={json.dumps(str(file))}")
    summary = run_rounds(
        *(changed_room, output, *settings), start=CHANGED, end=172, scale=MARKERS, save_map=saved
    )
    assert {(loop["kind"], loop["marker"]) for loop in summary["loops"]} == {("session", 7)}
    assert summary["map"]["met"] == summary["map"]["metric_worlds"] == [0]
    assert summary["scales"] == []  # the metres are those of the map
    assert summary["length_unit"] == "m"
    errors = _errors_in_map(surveyed / "out", output, changed_room)
    assert len(errors) > 30
    assert np.median(errors) < 0.03
    with MapFile(file) as old, MapFile(saved) as both:
        (before,), (after,) = (map_contents(each)["markers"] for each in (old, both))
        assert (before["id"], before["length_m"], before["visits"]) == (7, LENGTH_M, 1)
        assert (after["world"], after["visits"]) == (0, 2)
        np.testing.assert_allclose(after["position"], before["position"], atol=0.03)
        assert {each.key.session for each in both.markers} == {0, 1}


def _errors_in_map(first: Path, second: Path, recording: Path) -> Floats:
    """Position errors of the second session, if only the first one is fitted to its true path."""
    truth = read_tum(recording / "groundtruth.tum")
    paths = [read_tum(folder / "trajectory.tum") for folder in (first, second)]
    true = [truth.positions[np.searchsorted(truth.stamps_ns, p.stamps_ns)] for p in paths]
    fit = umeyama(paths[0].positions, true[0], with_scale=False)
    moved = fit.transform_poses(paths[1].world_from_cam)[:, :3, 3]
    return np.asarray(np.linalg.norm(moved - true[1], axis=1))


def test_a_map_shows_its_markers(surveyed: Path, tmp_path: Path) -> None:
    file, points = str(surveyed / "room.map"), tmp_path / "room.ply"
    lines = CliRunner().invoke(app, ["map", "info", file]).stdout.splitlines()
    (line,) = [line for line in lines if line.startswith("marker ")]
    assert line.startswith("marker 7 of 4X4_50, 0.3 m: at ") and line.endswith("in world 0")
    assert CliRunner().invoke(app, ["map", "export", file, "-o", str(points)]).exit_code == 0
    rows = points.read_bytes().split(b"end_header\n", 1)[1]
    corners = np.frombuffer(rows, np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)]))[-4:]
    sides = np.linalg.norm(np.diff(corners["xyz"], axis=0, append=corners["xyz"][:1]), axis=1)
    np.testing.assert_allclose(sides, LENGTH_M, rtol=0.02)
    assert (corners["rgb"] == 255).all()
