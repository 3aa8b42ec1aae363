"""Loops by markers: simulated paths, and a rendered room to which only a marker leads back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from marker_course import LAP, SEVEN, THREE, TRUTH, marker_at, simulate
from room_course import DICTIONARY, LENGTH_M, ate, run_rounds

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse
from vo.engine.geometry import sim3
from vo.engine.places.records import Loop, PlaceKey
from vo.recordings.formats.trajectory import read_tum
from vo.runs.scaling.scale_sources import ScaleOptions


@pytest.mark.parametrize("is_metric", [True, False])
def test_exact_views_give_exact_loops(is_metric: bool) -> None:
    course = simulate({7: [SEVEN]}, noise=0.0, is_metric=is_metric)
    # The third visit is connected with the first and with the second one.
    frames = [(loop.earlier.keyframe, loop.later.keyframe) for loop in course.loops]
    assert [(a // LAP, b // LAP) for a, b in frames] == [(0, 1), (0, 2), (1, 2)]
    for loop in course.loops:
        true = inverse(TRUTH[loop.earlier.keyframe]) @ TRUTH[loop.later.keyframe]
        np.testing.assert_allclose(loop.earlier_from_later, true, atol=1e-6)
        assert loop.scale == pytest.approx(1.0, abs=1e-6)
        assert (loop.marker, loop.inliers >= 4) == (7, True)
    assert course.placed().rejected == ()


@pytest.mark.parametrize(("is_metric", "ratio"), [(True, 0.5), (False, 0.3)])
def test_a_marker_seen_again_takes_the_drift_away(is_metric: bool, ratio: float) -> None:
    before, after = [], []
    for seed in range(6):
        course = simulate({7: [SEVEN], 3: [THREE]}, seed=seed, is_metric=is_metric)
        registered = course.placed()
        assert registered.rejected == ()
        before.append(course.error_m(course.odometry))
        after.append(course.error_m(registered.world_from_cam))
    assert np.mean(after) < ratio * np.mean(before)


def test_the_covariance_of_a_loop_holds_its_error() -> None:
    squared = []
    for seed in range(10):
        for loop in simulate({7: [SEVEN], 3: [THREE]}, seed=seed).loops:
            true = inverse(TRUTH[loop.earlier.keyframe]) @ TRUTH[loop.later.keyframe]
            error = sim3.local(sim3.inverse(loop.earlier_from_later) @ true)[:6]
            squared.append(error @ np.linalg.solve(loop.covariance[:6, :6], error))
    assert len(squared) >= 30
    assert 0.1 < np.mean(squared) < 7.0  # of six numbers: the drift of the path is overestimated
    assert np.max(squared) < 29.9


def test_a_marker_that_was_moved_closes_no_loop_and_is_named() -> None:
    course = simulate({7: [SEVEN, marker_at(TRUTH, 8, 1.0)]}, moved_at=60)
    registered = course.placed()
    assert len(registered.rejected) == len(course.loops) == 3  # also the true one
    np.testing.assert_array_equal(registered.world_from_cam, course.odometry)
    (note,) = course.markers.notes
    assert note.startswith("marker 7 closes no loop") and "it was moved" in note


def test_another_marker_closes_its_loops_beside_one_that_was_moved() -> None:
    course = simulate({7: [SEVEN, marker_at(TRUTH, 8, 1.0)], 3: [THREE]}, moved_at=60)
    registered = course.placed()
    assert {loop.marker for loop in registered.rejected} == {7}
    assert len(course.loops) == 4
    assert course.error_m(registered.world_from_cam) < course.error_m(course.odometry)


def test_two_markers_of_one_id_close_no_loop() -> None:
    course = simulate({7: [SEVEN, THREE]}, moved_at=0)
    registered = course.placed()
    assert len(registered.rejected) == len(course.loops) > 3
    np.testing.assert_array_equal(registered.world_from_cam, course.odometry)
    assert len(course.markers.notes) == 1


def test_two_markers_of_one_id_in_one_image_take_its_loops_back() -> None:
    course = simulate({7: [SEVEN]})
    assert course.placed().rejected == ()
    course.markers.see(2 * LAP + 19, [], [7])  # a second one appears beside it
    assert len(course.placed().rejected) == len(course.loops) == 3
    assert course.markers.repeated == (7,)


@pytest.mark.parametrize("is_metric", [True, False])
def test_segments_that_see_the_same_marker_become_one_world(is_metric: bool) -> None:
    course = simulate({7: [SEVEN]}, is_metric=is_metric, cut=90)
    registered = course.placed()
    assert set(registered.world.tolist()) == {0}
    assert course.error_m(registered.world_from_cam) < 0.3  # m, of a path of 88 m


def test_segments_are_merged_by_three_keyframes_not_by_two() -> None:
    for cut, views, worlds in ((LAP + 9, 3, {0}), (LAP + 10, 2, {0, 1})):
        course = simulate({7: [SEVEN]}, cut=cut, keyframes=LAP + 30)
        assert [loop.support for loop in course.loops if loop.later.keyframe == cut] == [views] * 2
        assert set(course.placed().world.tolist()) == worlds


def test_a_marker_is_not_believed_against_the_look_of_places() -> None:
    """One that was moved by less than the drift of the path, which other loops show."""
    course = simulate({7: [SEVEN, marker_at(TRUTH, 8, 0.6)]}, is_metric=False, moved_at=60)
    by_marker = course.loops[:1]
    course.loops = by_marker
    assert course.placed().rejected == ()
    for earlier in (12, 30, 60):
        later = earlier + LAP
        relation = inverse(TRUTH[earlier]) @ TRUTH[later]
        units = np.linalg.norm(np.diff(course.odometry[:, :3, 3], axis=0), axis=1) / np.linalg.norm(
            np.diff(TRUTH[:, :3, 3], axis=0), axis=1
        )
        relation[:3, 3] *= units[earlier]
        ends = PlaceKey(0, earlier), PlaceKey(0, later)
        scale = float(units[earlier] / units[later])
        sigma = np.diag(np.r_[np.full(3, 2e-3), np.full(3, 0.01), 0.01] ** 2)
        course.loops.append(Loop(*ends, relation, scale, sigma, 100))
    assert [loop.marker for loop in course.placed().rejected] == [7]


def test_a_marker_leads_back_to_a_place_that_looks_different(
    changed_room: Path, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    options = ScaleOptions(marker_length_m=LENGTH_M, marker_dictionary=DICTIONARY)
    summary = run_rounds(changed_room, output, "memory.loops=true", end=172, scale=options)
    assert {(loop["kind"], loop["marker"]) for loop in summary["loops"]} == {("merge", 7)}
    (segment,) = summary["segments"]
    assert segment["frames"] > 140  # the second map begins ten frames after the black ones
    found, truth = read_tum(output / "trajectory.tum"), read_tum(changed_room / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, found.stamps_ns)
    fit = umeyama(found.positions, truth.positions[rows], with_scale=True)
    assert fit.scale == pytest.approx(1.0, abs=0.02)
    assert ate(output, changed_room) < 0.05
