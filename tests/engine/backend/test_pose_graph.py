"""Pose graphs: true loops found, worlds merged, all keyframes placed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from graphs import (
    Laps,
    believed,
    cut,
    laps,
    to_first_lap,
    with_copy,
    with_drift,
    with_loops,
    with_wrong_motion,
)

from vo.engine.backend.chain_motion import motions_of
from vo.engine.backend.graph_problem import GraphProblem
from vo.engine.backend.graph_solution import optimise_graph
from vo.engine.backend.loop_edges import agrees_with_odometry, loop_edges
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.geometry import sim3
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.records import InertialPose, Loop, PathKeyframe, PlaceKey, RegisteredKeyframes


def test_nothing_moves_without_loops() -> None:
    problem = laps(0, loops=0).problem
    registered = optimise_graph(problem)
    np.testing.assert_array_equal(registered.world_from_cam, problem.odom_from_cam)
    assert set(registered.world.tolist()) == {0}
    assert np.isfinite(registered.covariance).all()


@pytest.mark.parametrize("scale_sigma", [0.0, 1e-9])
def test_exact_measurements_leave_no_error(scale_sigma: float) -> None:
    case = laps(0, noise=1e-6, scale_sigma=scale_sigma)
    registered = optimise_graph(case.problem)
    assert believed(registered, case.problem).all()
    assert case.error_m(registered) < 1e-5


@pytest.mark.parametrize("scale_sigma", [0.0, 0.005])
def test_true_loops_take_the_drift_away(scale_sigma: float) -> None:
    for seed in range(3):
        case = laps(seed, scale_sigma=scale_sigma)
        registered = optimise_graph(case.problem)
        assert believed(registered, case.problem).mean() > 0.95
        assert case.error_m(registered) < 0.5 * case.odometry_error_m()
        first = case.problem.odom_from_cam[0]
        np.testing.assert_allclose(registered.world_from_cam[0], first, rtol=0, atol=1e-12)
        if case.problem.is_metric.all():
            np.testing.assert_array_equal(registered.scale, 1.0)


@pytest.mark.parametrize("groups", [0, 1, 3])
@pytest.mark.parametrize("false_ratio", [0.2, 0.5])
def test_exactly_the_true_loops_are_kept(false_ratio: float, groups: int) -> None:
    for seed in range(5):
        case = laps(seed, false_ratio=false_ratio, groups=groups)
        kept = believed(optimise_graph(case.problem), case.problem)
        np.testing.assert_array_equal(kept, case.is_true)


def _long_laps(seed: int, radians: float) -> Laps:
    """Ten laps with loops to the first one, with odometry that drifts."""
    return with_drift(to_first_lap(laps(seed, keyframes=1000, loops=400)), radians)


def test_a_path_that_drifts_by_more_than_odometry_states_is_held_by_the_loops_before() -> None:
    for seed in range(2):
        case = _long_laps(seed, 1e-3)
        loops = loop_edges(case.problem)
        by_odometry = agrees_with_odometry(loops, motions_of(case.problem))
        assert by_odometry.mean() < 0.8
        registered = optimise_graph(case.problem)
        assert believed(registered, case.problem).mean() > 0.97
        assert case.error_m(registered) < 0.03 * case.odometry_error_m()


@pytest.mark.parametrize("shift_m", [2.0, 4.0, 16.0])
@pytest.mark.parametrize("radians", [0.0, 1e-3])
def test_a_copy_beside_loops_that_contradict_odometry_is_refused(
    radians: float, shift_m: float
) -> None:
    for at in (200, 850):
        case = _long_laps(at, radians)
        copied = with_copy(case, at, shift_m)
        kept = believed(optimise_graph(copied.problem), copied.problem)
        assert not kept[~copied.is_true].any()
        assert kept[copied.is_true].mean() > 0.97


@pytest.mark.parametrize("noise", [0.02, 0.3, 1.0])
def test_loops_do_not_harm_odometry_that_is_better(noise: float) -> None:
    """Loops of one part of a lap, less exact than odometry is, as stated."""
    errors = []
    for seed in range(6):
        case, exact = laps(seed, keyframes=110), laps(seed, keyframes=110, noise=noise)
        moved = replace(exact, problem=with_loops(exact.problem, case.problem.loops))
        errors.append((moved.error_m(optimise_graph(moved.problem)), moved.odometry_error_m()))
    with_them, without = np.sqrt(np.mean(np.square(errors), axis=0))
    assert with_them < 1.1 * without + 0.01


def test_false_loops_alone_change_nothing() -> None:
    case = laps(3, loops=20, false_ratio=1.0, groups=1)
    registered = optimise_graph(case.problem)
    assert len(registered.rejected) == 20
    np.testing.assert_array_equal(registered.world_from_cam, case.problem.odom_from_cam)


def test_drift_of_scale_is_found() -> None:
    case = laps(2, scale_sigma=0.005, loops=60)
    registered = optimise_graph(case.problem)
    steps = np.linalg.norm(np.diff(registered.world_from_cam[:, :3, 3], axis=0), axis=1)
    assert abs(steps[-50:].mean() - 1.0) < 0.02


def test_covariances_hold_the_errors() -> None:
    squared = []
    for seed in range(12):
        case = laps(seed)
        registered = optimise_graph(case.problem)
        error = sim3.local(sim3.inverse(registered.world_from_cam) @ case.truth)[:, :6]
        for n in (40, 120, 290):
            squared.append(error[n] @ np.linalg.solve(registered.covariance[n], error[n]))
    # Six in expectation; less, as the graph also expects systematic drift.
    assert 1.0 < np.mean(squared) < 8.0


def test_segments_that_meet_become_one_world() -> None:
    case = laps(4)
    registered = optimise_graph(cut(case.problem, 150))
    assert set(registered.world.tolist()) == {0}
    assert case.error_m(registered) < 0.3


def test_segments_of_one_camera_are_merged_with_their_scales() -> None:
    case = laps(4, scale_sigma=1e-9, noise=0.1)
    problem = cut(case.problem, 150)
    odom = problem.odom_from_cam.copy()
    odom[150:, :3, 3] *= 4.0
    loops = tuple(_in_new_unit(loop, 4.0) for loop in problem.loops)
    registered = optimise_graph(replace(problem, odom_from_cam=odom, loops=loops))
    assert set(registered.world.tolist()) == {0}
    np.testing.assert_allclose(registered.scale[150:], 0.25, rtol=0.02)
    assert case.error_m(registered) < 0.1


def _in_new_unit(loop: Loop, factor: float) -> Loop:
    relation, scale = loop.earlier_from_later.copy(), loop.scale
    if loop.earlier.keyframe >= 150:
        relation[:3, 3] *= factor
        scale *= factor
    if loop.later.keyframe >= 150:
        scale /= factor
    return replace(loop, earlier_from_later=relation, scale=scale)


WRONG = sim3.retract(np.array([0.02, 0.33, 0.0, 0.8, 0.0, 0.3, 0.0]))  # 19 degrees, 0.85 m
AT = 150


def _across(problem: GraphProblem) -> list[Loop]:
    return [loop for loop in problem.loops if loop.earlier.keyframe < AT <= loop.later.keyframe]


@pytest.mark.parametrize("scale_sigma", [0.0, 0.005])
def test_loops_mend_a_wrong_motion_that_was_doubted(scale_sigma: float) -> None:
    for seed in range(4, 7):
        case = laps(seed, scale_sigma=scale_sigma)
        right = optimise_graph(case.problem)
        problem = with_wrong_motion(case.problem, AT, WRONG)
        mended = optimise_graph(problem)
        assert mended.wrong == (PlaceKey(0, AT),)
        assert believed(mended, problem).mean() > 0.95
        assert case.error_m(mended) < 1.5 * case.error_m(right) + 0.05


def test_a_wrong_motion_that_nothing_doubts_stays() -> None:
    case = laps(4)
    problem = with_wrong_motion(case.problem, AT, WRONG, is_doubted=False)
    registered = optimise_graph(problem)
    assert registered.wrong == ()
    across = [loop for loop in _across(problem) if loop not in registered.rejected]
    assert not across


def test_a_doubted_motion_that_was_right_makes_no_difference() -> None:
    for seed in range(3):
        case = laps(seed, loops=60, scale_sigma=0.005)
        doubted = np.isin(np.arange(300), (80, 150, 151, 220))
        expected = optimise_graph(case.problem)
        registered = optimise_graph(replace(case.problem, is_doubted=doubted))
        assert registered.wrong == ()
        for name in ("world_from_cam", "scale", "covariance"):
            np.testing.assert_array_equal(getattr(registered, name), getattr(expected, name))


@pytest.mark.parametrize("groups", [0, 3])
def test_false_loops_across_doubted_motions_are_refused(groups: int) -> None:
    for seed in range(5):
        case = laps(seed, false_ratio=0.5, groups=groups)
        doubted = np.isin(np.arange(300), (AT, AT + 1))
        registered = optimise_graph(replace(case.problem, is_doubted=doubted))
        np.testing.assert_array_equal(believed(registered, case.problem), case.is_true)


@pytest.mark.parametrize("is_copied", [False, True])
@pytest.mark.parametrize("is_cut", [False, True])
def test_neither_two_loops_nor_loops_to_two_places_join_parts(
    is_cut: bool, is_copied: bool
) -> None:
    """Neither two segments, nor what lies beside a wrong motion."""
    problem = laps(4).problem
    problem = cut(problem, AT) if is_cut else with_wrong_motion(problem, AT, WRONG)
    loops = _across(problem)
    chosen = [*loops, *_copies(problem, loops)] if is_copied else loops[:2]
    registered = optimise_graph(with_loops(problem, tuple(chosen)))
    assert registered.wrong == () and set(registered.world.tolist()) == ({0, 1} if is_cut else {0})
    assert is_copied or len(registered.rejected) == 2
    np.testing.assert_array_equal(registered.world_from_cam, problem.odom_from_cam)


def test_several_wrong_motions_are_mended() -> None:
    case = laps(5, loops=60)
    problem = with_wrong_motion(case.problem, 60, WRONG)
    problem = with_wrong_motion(problem, AT, sim3.inverse(WRONG))
    problem = with_wrong_motion(problem, AT + 1, WRONG)
    registered = optimise_graph(problem)
    assert registered.wrong == tuple(PlaceKey(0, n) for n in (60, AT, AT + 1))
    error = np.linalg.norm(registered.world_from_cam[:, :3, 3] - case.truth[:, :3, 3], axis=1)
    assert np.median(error) < 0.5


@pytest.mark.parametrize("threads", [1, 2])
def test_only_repairs_that_images_do_not_confirm_are_taken_back(threads: int) -> None:
    case = laps(5, loops=60)
    problem = with_wrong_motion(case.problem, 60, WRONG)
    first = replace(case, problem=with_wrong_motion(problem, AT, WRONG, is_doubted=False))
    both = replace(case, problem=with_wrong_motion(problem, AT, WRONG))
    graph = _graph(both, threads)
    graph.submit(both.problem.loops)
    registered = graph.result(
        lambda registered: [key for key in registered.wrong if key.keyframe == AT]
    )
    graph.close()
    expected = _in_graph(first, threads)
    assert registered.wrong == expected.wrong == (PlaceKey(0, 60),)
    np.testing.assert_array_equal(registered.world_from_cam, expected.world_from_cam)


def test_a_removed_keyframe_hands_its_doubt_on() -> None:
    case = laps(4)
    problem = with_wrong_motion(case.problem, AT, WRONG)
    needed = {key.keyframe for loop in problem.loops for key in (loop.earlier, loop.later)}
    assert AT not in needed
    graph = _graph(replace(case, problem=problem), 1)
    graph.remove_keyframes([PlaceKey(0, AT)], problem.loops)
    graph.submit(problem.loops)
    assert graph.result().wrong == (PlaceKey(0, AT + 1),)


def _copies(problem: GraphProblem, loops: Sequence[Loop]) -> list[Loop]:
    """The loops to the same place once more, 16 m away."""
    shift = np.eye(4)
    shift[:3, 3] = 16.0, 0.0, 0.0
    copies = []
    for loop in loops:
        earlier = problem.odom_from_cam[loop.earlier.keyframe]
        relation = sim3.inverse(earlier) @ shift @ earlier @ loop.earlier_from_later
        copies.append(replace(loop, earlier_from_later=relation))
    return copies


def test_metric_and_other_segments_stay_apart() -> None:
    problem = cut(laps(4).problem, 150)
    is_metric = np.arange(300) < 150
    registered = optimise_graph(replace(problem, is_metric=is_metric))
    assert set(registered.world.tolist()) == {0, 1}


def test_unknown_covariances_do_no_harm() -> None:
    case = laps(5)
    covariance = case.problem.covariance.copy()
    covariance[::7] = np.nan
    registered = optimise_graph(replace(case.problem, covariance=covariance))
    assert believed(registered, case.problem).all()
    assert case.error_m(registered) < case.odometry_error_m()


def test_the_same_bits_come_out_again_and_of_another_thread() -> None:
    case = laps(6, false_ratio=0.3, groups=1)
    expected = _in_graph(case, threads=1)
    for threads in (1, 2, 2):
        found = _in_graph(case, threads)
        for name in ("world", "world_from_cam", "scale", "covariance"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        assert len(found.rejected) == len(expected.rejected) > 0


def test_a_loaded_map_stays_as_it_is() -> None:
    case = laps(4)
    rows = {name: value[:150] for name, value in vars(case.problem).items() if name != "loops"}
    first = replace(case.problem, **rows, loops=())
    stored = optimise_graph(first)
    graph = PoseGraph()
    graph.add_map(stored, is_metric=True)
    whole = cut(case.problem, 150)
    for n in range(150, 300):
        graph.add_keyframe(_place(whole, n, session=1, segment=0))
    graph.submit([replace(loop, later=PlaceKey(1, loop.later.keyframe)) for loop in _across(whole)])
    registered = graph.result()
    assert set(registered.world.tolist()) == {0}
    np.testing.assert_allclose(
        registered.world_from_cam[:150], stored.world_from_cam, rtol=0, atol=1e-9
    )
    apart = registered.world_from_cam[150:, :3, 3] - case.truth[150:, :3, 3]
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 2.0 * case.odometry_error_m()


def test_culled_keyframes_leave_the_others_where_they_are() -> None:
    case = laps(7)
    ends = {key for loop in case.problem.loops for key in (loop.earlier, loop.later)}
    expected = _in_graph(case, threads=1)
    graph = _graph(case, threads=1)
    graph.remove_keyframes([PlaceKey(0, n) for n in range(1, 299, 2)], case.problem.loops)
    graph.submit(case.problem.loops)
    registered = graph.result()
    left = [n for n in range(300) if n % 2 == 0 or n == 299 or PlaceKey(0, n) in ends]
    assert [key.keyframe for key in registered.keys] == left
    apart = registered.world_from_cam[:, :3, 3] - expected.world_from_cam[left, :3, 3]
    assert np.abs(apart).max() < 0.02


def test_inertial_poses_give_their_segment_metres_and_take_part_in_the_graph() -> None:
    """Keyframes without one follow; in a world of another segment they are in its chain."""
    case = laps(0, noise=1e-6, scale_sigma=1e-9)
    scaled = replace(case.problem, odom_from_cam=case.problem.odom_from_cam.copy())
    scaled.odom_from_cam[:, :3, 3] *= 0.5
    graph, loops = PoseGraph(), []
    for loop in scaled.loops:
        relation = sim3.rigid_part(loop.earlier_from_later)
        relation[:3, 3] *= 0.5
        loops.append(replace(loop, earlier_from_later=relation))
    for n in range(300):
        graph.add_keyframe(_place(scaled, n, session=0, segment=int(n >= 150)))
    known = [n for n in range(10, 300) if n % 3]
    graph.submit(loops, {PlaceKey(0, n): InertialPose(0, case.truth[n], 2.0) for n in known})
    registered = graph.result()
    assert set(registered.world.tolist()) == {0}
    assert not registered.rejected
    np.testing.assert_allclose(registered.world_from_cam, case.truth, rtol=0, atol=1e-4)
    np.testing.assert_allclose(registered.scale, 2.0, rtol=1e-4)
    assert np.isfinite(registered.covariance).all()


def test_a_loop_with_an_unknown_keyframe_is_an_error() -> None:
    problem = laps(1).problem
    stranger = replace(problem.loops[0], later=PlaceKey(5, 3))
    with pytest.raises(ValueError, match="not stored"):
        optimise_graph(with_loops(problem, (stranger,)))


def _in_graph(case: Laps, threads: int) -> RegisteredKeyframes:
    graph = _graph(case, threads)
    graph.submit(case.problem.loops)
    registered = graph.result()
    graph.close()
    return registered


def _graph(case: Laps, threads: int) -> PoseGraph:
    graph = PoseGraph(threads)
    for n in range(len(case.truth)):
        graph.add_keyframe(_place(case.problem, n, session=0, segment=0))
    return graph


def _place(problem: GraphProblem, n: int, session: int, segment: int) -> PathKeyframe:
    return PathKeyframe(
        PlaceKey(session, n),
        FrameId(n, n, segment),
        bool(problem.is_metric[n]),
        problem.odom_from_cam[n],
        problem.covariance[n],
        is_doubted=bool(problem.is_doubted[n]),
    )
