"""The chain of keyframes with inertial states, as it grows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from inertial_flight import (
    GYRO_BIAS,
    IMU_FROM_CAM,
    NOISE,
    Samples,
    Sensor,
    keyframe_stamps,
    sensor,
    step_covariance,
    visual_poses,
    world_from_cam,
)

from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.types import Floats
from vo.engine.inertial.chain import InertialChain
from vo.engine.inertial.initialisation import NotYet
from vo.engine.inertial.keyframe_states import KeyframeStates, Node, certain
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import ACCEL_BIAS as ACCEL_COLUMNS
from vo.engine.inertial.states import GYRO_BIAS as GYRO_COLUMNS
from vo.engine.inertial.states import ROTATION

_SCALE = 0.5


def _chain(source: Sensor) -> InertialChain:
    return InertialChain(SampleReader(source), NOISE, IMU_FROM_CAM, is_metric=False)


def _nodes(count: int, poses: Floats, segments: list[int] | None = None) -> list[Node]:
    stamps = keyframe_stamps(count)
    covariance = step_covariance(1, _SCALE)[0]
    return [
        Node(
            k, 10 * k, int(stamps[k]), 0 if segments is None else segments[k], poses[k], covariance
        )
        for k in range(count)
    ]


def _camera_positions(solved: KeyframeStates) -> Floats:
    states = solved.estimate.states
    return states.position + states.rotation @ IMU_FROM_CAM[:3, 3]


def _error_m(solved: KeyframeStates, count: int) -> float:
    """Largest error of a position relative to the first and its heading."""
    truth = world_from_cam(keyframe_stamps(count))
    first = inverse(truth[solved.nodes[0].keyframe])
    expected = (first @ truth)[[node.keyframe for node in solved.nodes], :3, 3]
    states = solved.estimate.states
    start = states.rotation[0] @ IMU_FROM_CAM[:3, :3]
    found = (_camera_positions(solved) - _camera_positions(solved)[0]) @ start
    return float(np.abs(found - expected).max())


def test_exact_measurements_give_the_exact_path() -> None:
    chain = _chain(sensor(seconds=25.0))
    poses = visual_poses(world_from_cam(keyframe_stamps(45)), _SCALE)
    for node in _nodes(45, poses):
        chain.set(node)
        chain.update()
    solved = chain.finish()
    assert solved is not None and chain.reason is None
    assert len(solved.nodes) == 45 and _error_m(solved, 45) < 2e-3
    assert chain.initialised_frame is not None and 30 <= chain.initialised_frame <= 150
    np.testing.assert_allclose(solved.estimate.states.gyro_bias, [GYRO_BIAS] * 45, atol=5e-5)


def test_window_says_what_all_keyframes_together_say() -> None:
    """What was eliminated from the window stays in its prior."""
    chain = _chain(sensor(noise=1.0, seconds=25.0))
    poses = visual_poses(world_from_cam(keyframe_stamps(45)), _SCALE, noise=1.0)
    newest = None
    for node in _nodes(45, poses):
        chain.set(node)
        newest = chain.update()
    assert newest is not None and len(newest.nodes) == 12
    window, together = newest.estimate, chain.finish()
    assert together is not None
    sigma = np.sqrt(np.diagonal(together.estimate.covariance[-1]))
    step = window.states.rows(slice(-1, None)).since(
        together.estimate.states.rows(slice(-1, None))
    )[0]
    assert np.abs(step / sigma)[6:].max() < 0.4  # velocity, biases and scale
    ratio = np.sqrt(np.diagonal(window.covariance[-1])) / sigma
    # At the end the errors of the motions are found, and are smaller than assumed before.
    assert ratio[6:].min() > 0.9 and ratio[6:].max() < 1.7


def test_drifting_scale_is_followed() -> None:
    truth = world_from_cam(keyframe_stamps(45))
    steps = inverse(truth[:-1]) @ truth[1:]
    drift = 0.5 * np.exp(0.002 * np.arange(44))  # 9 % in all
    poses = [np.eye(4)]
    for k, step in enumerate(steps):
        moved = step.copy()
        moved[:3, 3] /= drift[k]
        poses.append(poses[-1] @ moved)
    chain = _chain(sensor(noise=1.0, seconds=25.0))
    for node in _nodes(45, np.stack(poses)):
        chain.set(node)
        chain.update()
    solved = chain.finish()
    assert solved is not None
    found = np.exp(solved.estimate.states.log_scale[:-1])
    assert np.abs(found / drift - 1.0).max() < 0.015


def test_segments_are_joined_across_a_short_gap() -> None:
    count, first = 40, 20
    truth = world_from_cam(keyframe_stamps(count))
    later = visual_poses(truth[first + 2 :], 2.0)  # 1.5 s later, in another scale
    poses = np.concatenate(
        [visual_poses(truth[: first + 2], _SCALE)[:first], np.zeros((2, 4, 4)), later]
    )
    segments = [0] * (first + 2) + [1] * (count - first - 2)
    nodes = _nodes(count, poses, segments)
    chain = _chain(sensor(noise=1.0, seconds=22.0))
    for node in (*nodes[:first], *nodes[first + 2 :]):
        chain.set(node)
        chain.update()
    solved = chain.finish()
    assert solved is not None and len(solved.nodes) == count - 2 and solved.world == 0
    assert certain(solved) == list(range(count - 2))
    np.testing.assert_allclose(np.exp(solved.estimate.states.log_scale[-1]), 2.0, rtol=0.02)
    truth_m = truth[[n.keyframe for n in solved.nodes], :3, 3]
    found = _camera_positions(solved)
    spread = np.linalg.norm(found[-1] - found[0]) / np.linalg.norm(truth_m[-1] - truth_m[0])
    assert abs(spread - 1.0) < 0.02


def _begun_late(first: Floats) -> KeyframeStates:
    """A run whose first segment has no states; its poses (n, 4, 4) are given."""
    count, truth = len(first), world_from_cam(keyframe_stamps(40))
    poses = np.concatenate([first, visual_poses(truth[count:], 2.0)])
    chain = _chain(sensor(noise=1.0, seconds=22.0))
    for node in _nodes(40, poses, [0] * count + [1] * (40 - count)):
        if node.keyframe != count:  # lost
            chain.set(node)
            chain.update()
    solved = chain.finish()
    assert solved is not None and chain.agreement.contradiction is None
    again = chain.smoothed()
    assert again is not None and again.nodes == solved.nodes
    return solved


def test_a_segment_from_before_the_first_states_is_joined_at_the_end() -> None:
    truth = world_from_cam(keyframe_stamps(40))
    solved = _begun_late(visual_poses(truth[:5], _SCALE))
    assert len(solved.nodes) == 39 and (solved.world, solved.origin) == (0, 0)
    assert certain(solved) == list(range(39))
    np.testing.assert_allclose(np.exp(solved.estimate.states.log_scale[0]), _SCALE, rtol=0.02)
    assert _error_m(solved, 40) < 0.05


def _wrong_from_the_third(count: int) -> Floats:
    """Poses of a segment whose third to last ones are turned by 0.2 rad."""
    poses = visual_poses(world_from_cam(keyframe_stamps(40))[:count], _SCALE)
    poses[2:, :3, :3] = poses[2:, :3, :3] @ se3_exp(np.array([0, 0.2, 0, 0, 0, 0.0]))[:3, :3]
    return poses


def test_a_short_segment_that_contradicts_the_samples_is_placed_by_these() -> None:
    solved = _begun_late(_wrong_from_the_third(5))
    assert (len(solved.nodes), solved.world, solved.origin, solved.doubted) == (39, 0, 0, 5)
    assert set(certain(solved)) >= set(range(39))
    truth = world_from_cam(keyframe_stamps(40))[[node.keyframe for node in solved.nodes]]
    found = inverse(_cameras(solved)[0]) @ _cameras(solved)[5]
    expected = inverse(truth[0]) @ truth[5]
    sigma = np.sqrt(np.trace(solved.estimate.covariance[5, 3:6, 3:6]))
    assert np.linalg.norm(found[:3, 3] - expected[:3, 3]) < 3.0 * sigma < 0.3
    assert np.abs(found[:3, :3] - expected[:3, :3]).max() < 0.005  # images: 0.2


def _cameras(solved: KeyframeStates) -> Floats:
    """(n, 4, 4) poses of the camera."""
    poses = np.tile(np.eye(4), (len(solved.nodes), 1, 1))
    poses[:, :3, :3] = solved.estimate.states.rotation
    poses[:, :3, 3] = solved.estimate.states.position
    return np.asarray(poses @ IMU_FROM_CAM)


def test_a_longer_segment_that_contradicts_the_samples_stays_apart() -> None:
    solved = _begun_late(_wrong_from_the_third(12))
    assert len(solved.nodes) == 27 and (solved.world, solved.origin) == (1, 13)


def test_a_long_gap_begins_a_new_world() -> None:
    count = 50
    truth = world_from_cam(keyframe_stamps(count))
    segments = [0] * 20 + [1] * 30
    poses = np.concatenate([visual_poses(truth[:20], _SCALE), visual_poses(truth[20:], 1.0)])
    nodes = _nodes(count, poses, segments)
    chain = _chain(sensor(seconds=27.0))
    for node in (*nodes[:20], *nodes[31:]):  # 6 s
        chain.set(node)
        chain.update()
    solved = chain.finish()
    assert solved is not None and solved.world == 1 and solved.nodes[0].keyframe == 31


def test_frames_tracked_anew_are_forgotten() -> None:
    chain = _chain(sensor())
    poses = visual_poses(world_from_cam(keyframe_stamps(20)), _SCALE)
    nodes = _nodes(20, poses)
    for node in nodes:
        chain.set(node)
        chain.update()
    chain.remove_from(150)
    assert not chain.is_initialised
    for node in nodes[15:]:
        chain.set(replace(node, keyframe=node.keyframe + 10))
        chain.update()
    solved = chain.finish()
    assert solved is not None and _error_m(replace(solved, nodes=tuple(nodes)), 20) < 2e-3


def test_missing_samples_are_bridged_by_images() -> None:
    source = sensor(seconds=25.0)
    given = source.samples
    kept = (given.stamps_ns < given.stamps_ns[0] + 12_000_000_000) | (
        given.stamps_ns > given.stamps_ns[0] + 13_000_000_000
    )
    holed = Samples(given.stamps_ns[kept], given.gyro[kept], given.accel[kept])
    chain = _chain(replace(source, samples=holed))
    poses = visual_poses(world_from_cam(keyframe_stamps(45)), _SCALE)
    for node in _nodes(45, poses):
        chain.set(node)
        chain.update()
    solved = chain.finish()
    assert solved is not None and len(solved.nodes) == 45 and _error_m(solved, 45) < 5e-3


def test_states_follow_a_replaced_time_offset() -> None:
    """Samples of a clock that is 40 ms ahead of that of the images."""
    source = sensor(noise=1.0, seconds=25.0)
    late = replace(source.samples, stamps_ns=source.samples.stamps_ns + 40_000_000)
    clock = SampleReader(replace(source, samples=late))
    poses = visual_poses(world_from_cam(keyframe_stamps(45)), _SCALE, noise=1.0)
    chain = InertialChain(clock, NOISE, IMU_FROM_CAM, is_metric=False)
    for node in _nodes(45, poses):
        chain.set(node)
        chain.update()
    clock.time_offset_s = 0.04
    chain.read_again()
    if not chain.is_initialised:
        chain.update()
    solved, expected = chain.finish(), _finished(_chain(source), _nodes(45, poses))
    assert solved is not None and len(solved.nodes) == 45
    np.testing.assert_allclose(
        solved.estimate.states.position, expected.estimate.states.position, atol=5e-3
    )
    assert abs(solved.estimate.misfit - expected.estimate.misfit) < 0.02


def test_first_states_are_searched_anew_by_another_offset() -> None:
    source = sensor(seconds=15.0)
    late = replace(source.samples, stamps_ns=source.samples.stamps_ns + 40_000_000)
    clock = SampleReader(replace(source, samples=late))
    poses = visual_poses(world_from_cam(keyframe_stamps(20)), _SCALE)
    chain = InertialChain(clock, NOISE, IMU_FROM_CAM, is_metric=False)
    for node in _nodes(20, poses):
        chain.set(node)
        chain.update()
    clock.time_offset_s = 0.04
    chain.restart()
    assert not chain.is_initialised and chain.initialised_frame is None
    solved = chain.update()
    assert solved is not None and chain.initialised_frame == 190
    np.testing.assert_allclose(np.exp(solved.estimate.states.log_scale), _SCALE, rtol=2e-3)


def _finished(chain: InertialChain, nodes: list[Node]) -> KeyframeStates:
    for node in nodes:
        chain.set(node)
        chain.update()
    solved = chain.finish()
    assert solved is not None
    return solved


def test_reason_is_known_before_first_states() -> None:
    chain = _chain(sensor())
    assert chain.reason is NotYet.FEW_KEYFRAMES and chain.finish() is None


def _dense_chain(count: int) -> tuple[InertialChain, list[int]]:
    """A chain with a keyframe every 0.2 s; the keyframes after which it has states."""
    stamps = keyframe_stamps(count, 0.2)
    poses = visual_poses(world_from_cam(stamps), _SCALE)
    chain, known = _chain(sensor(seconds=15.0)), []
    for k in range(count):
        covariance = step_covariance(1, _SCALE)[0]
        chain.set(Node(k, k, int(stamps[k]), 0, poses[k], covariance))
        if chain.update() is not None:
            known.append(k)
    return chain, known


def test_first_states_are_searched_once_a_second_while_more_motion_is_needed() -> None:
    """The search takes longer than everything else in the chain."""
    chain, known = _dense_chain(17)
    # Searched after keyframes 3, 8 and 13, next after 18; 16 would be enough.
    assert known == [] and chain.reason is NotYet.NO_MOTION
    assert chain.update() is None
    chain.restart()  # by another time offset: at once
    assert chain.update() is not None and chain.initialised_frame == 16
    assert _dense_chain(20)[1] == [18, 19]


def test_a_new_world_begins_with_the_biases_of_the_one_before() -> None:
    count, first, gap = 44, 24, 11
    truth = world_from_cam(keyframe_stamps(count))
    source = sensor(noise=1.0, seconds=25.0)
    poses = np.concatenate(
        [
            visual_poses(truth[:first], _SCALE, noise=1.0),
            visual_poses(truth[first:], 1.0, noise=1.0),
        ]
    )
    nodes = _nodes(count, poses, [0] * first + [1] * (count - first))
    later = nodes[first + gap : first + gap + 9]  # after 6 s

    def added(chain: InertialChain, rows: list[Node]) -> KeyframeStates:
        for node in rows:
            chain.set(node)
            chain.update()
        solved = chain.finish()
        assert solved is not None and solved.world == 1
        return solved

    alone = added(_chain(source), later)
    after = added(_chain(source), [*nodes[:first], *later])
    assert [n.keyframe for n in after.nodes] == [n.keyframe for n in alone.nodes]
    for columns, least in ((GYRO_COLUMNS, 1.5), (ACCEL_COLUMNS, 2.0), (ROTATION, 1.5)):
        sigma = [
            np.sqrt(np.trace(p.estimate.covariance[-1][columns, columns])) for p in (alone, after)
        ]
        assert sigma[0] > least * sigma[1]
    error = after.estimate.states.gyro_bias[-1] - GYRO_BIAS
    stated = np.sqrt(np.diag(after.estimate.covariance[-1])[GYRO_COLUMNS])
    assert np.abs(error / stated).max() < 3.0
