"""States of one camera with frames between its keyframes, after the last frame.

Motions that are quicker than keyframes follow each other, such as the steps of somebody who walks,
are in the samples and in the poses of the frames between them. A tracked pose has errors of its own
beside those of its landmarks, which move with the keyframe: what is measured is where images saw
the camera, the state moved by that error. Neighbouring frames share most of it.

Source: Forster et al. 2017 (factors); Gelb, "Applied Optimal Estimation", 1974, sec. 3.6 (errors
that are correlated in time as further states).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import adjoint, inverse, make_transform
from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.inertial.chain_solver import Equations
from vo.engine.inertial.estimation import (
    HUBER,
    ChainProblem,
    Estimate,
    Prior,
    image_errors,
    most_probable,
)
from vo.engine.inertial.factor_kernels import add_factors
from vo.engine.inertial.keyframe_states import KeyframeStates, Node
from vo.engine.inertial.preintegration import Interval, Preintegrated, preintegrate
from vo.engine.inertial.states import GRAVITY, LOG_SCALE, WIDTH, MapErrors, States, Steps
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.tracked_frame import TrackedFrame

_PERIOD_NS = 95_000_000  # from one such frame to the next at least: 0.1 s by stamps that vary
# Errors of their own: standard deviations in those that tracking states for independent errors of
# all landmarks, and the time after which 1/e is left of them.
_ERROR, _KEPT_S = 0.5, 0.15
_EXACT = np.diag(np.full(6, 1e-14))  # covariance of those of keyframes
_LAST_STEP = 0.1  # of the iterations, in standard deviations
_MAX_MISFIT = 1.5
# Where they add less, errors that the model lacks change the scale by more than they tell of it.
_MAX_RATIO = 0.9  # of the standard deviations of the scale with and without frames
_MAX_SIGMA = 3.0  # change of the scale, in standard deviations of that without frames


class TrackedPose(NamedTuple):
    """A frame between two keyframes."""

    frame_index: int
    stamp_ns: int
    keyframe: int  # number of the frame of the one before it
    keyframe_from_cam: Floats  # (4, 4) in units of the map
    information: Floats  # (6, 6) tangent on the right, rotation first


class TrackedPoses:
    """Frames between keyframes, a tenth of a second apart; none of metric paths."""

    def __init__(self, *, is_metric: bool) -> None:
        self._is_metric = is_metric
        self._poses: list[TrackedPose] = []

    def see(self, frame: PreprocessedFrame, tracked: TrackedFrame, newest: Keyframe) -> None:
        """Keep a frame after the newest keyframe."""
        if self._is_metric or tracked.information is None:
            return
        motion = inverse(newest.world_from_cam) @ tracked.world_from_cam
        place = frame.index, frame.stamp_ns, newest.frame.index
        self.add(TrackedPose(*place, motion, tracked.information))

    def add(self, pose: TrackedPose) -> None:
        """Keep a frame, if the one before it is not too near."""
        last = self._poses[-1] if self._poses else None
        is_near = last is not None and pose.stamp_ns < last.stamp_ns + _PERIOD_NS
        if last is None or not is_near or last.keyframe != pose.keyframe:
            self._poses.append(pose)

    def forget_from(self, frame_index: int) -> None:
        """Forget a frame and all after it."""
        self._poses = [pose for pose in self._poses if pose.frame_index < frame_index]

    def follow(self, frames: Ints, world_from_cam: Floats) -> None:
        """Take the poses of a path, which windows have improved since; n numbers of its frames."""
        row = {frame: n for n, frame in enumerate(frames.tolist())}
        for n, pose in enumerate(self._poses):
            if pose.keyframe in row and pose.frame_index in row:
                first, last = world_from_cam[[row[pose.keyframe], row[pose.frame_index]]]
                self._poses[n] = pose._replace(keyframe_from_cam=inverse(first) @ last)

    def by_keyframe(self) -> dict[int, list[TrackedPose]]:
        """All of them by number of the frame of the keyframe before them."""
        found: dict[int, list[TrackedPose]] = {}
        for pose in self._poses:
            found.setdefault(pose.keyframe, []).append(pose)
        return found


@frozen(eq=False)
class _Woven:
    """A chain of n keyframes and frames between them.

    Attributes:
        world_from_cam: (n, 4, 4) poses by images.
        states: n, to begin with.
        steps: between them; the scale of their covariances is that of `errors`.
        errors: of the motions by images, as of `image_errors`.
        own: (n, 6, 6) covariances of the errors of the poses by images, tangent on the right.
        kept: (n - 1,) part of that error which the next one has, too.
        keyframes: rows of the keyframes.
    """

    world_from_cam: Floats
    states: States
    steps: Steps
    errors: tuple[Floats, Floats]
    own: Floats
    kept: Floats
    keyframes: Ints

    def with_errors(self, errors: MapErrors, solved: KeyframeStates) -> _Woven:
        """The same with other errors of the motions between the keyframes of `solved`."""
        steps = replace(solved.estimate.steps, errors=errors)
        shared = _shared_errors(steps, self.world_from_cam, self.keyframes, self.steps.duration_s)
        return replace(self, errors=shared)


def with_frames(
    solved: KeyframeStates,
    tracked: Mapping[int, Sequence[TrackedPose]],
    between: Callable[[int, int], Interval | None],
    prior: Prior,
    noise: ImuNoise,
) -> Estimate:
    """States of the keyframes with the scale and the vertical by the frames between them, too.

    The path keeps its shape, which images and loops measure better. As they are where frames
    disagree, or hardly make the scale more certain: with slow motions.

    Args:
        solved: states without them.
        tracked: frames by number of the frame of the keyframe before them.
        between: samples between the times of two images.
        prior: of the first state.
        noise: of the sensor.
    """
    estimate = solved.estimate
    woven = _woven(solved, tracked, between, noise)
    if len(woven.keyframes) == woven.states.number:
        return estimate
    variance = estimate.covariance[:, LOG_SCALE, LOG_SCALE]
    try:
        problem = _WovenProblem(woven, prior, noise)
        found = most_probable(problem, woven.states, last_step=_LAST_STEP)
        ratio = found.covariance[woven.keyframes, LOG_SCALE, LOG_SCALE] / variance
        if found.misfit > _MAX_MISFIT or median(ratio) > _MAX_RATIO**2:
            return estimate
        # Covariances are those of the largest drift of the scale that is not improbable, with
        # which states would follow errors of single frames.
        woven = woven.with_errors(estimate.errors, solved)
        problem = _WovenProblem(woven, prior, noise)
        found = most_probable(problem, found.states, last_step=_LAST_STEP)
    except np.linalg.LinAlgError:
        return estimate
    states = States(*(field[woven.keyframes] for field in found.states))
    change = states.log_scale - estimate.states.log_scale
    if (change**2 > _MAX_SIGMA**2 * variance).any():
        return estimate
    of_scale = estimate.covariance[:, :, LOG_SCALE]
    less = ((1.0 - ratio).clip(0.0) / variance)[:, None, None]
    covariance = estimate.covariance - less * of_scale[:, :, None] * of_scale[:, None]
    moved = _as_whole(estimate.states, states, median(change))
    return replace(estimate, states=moved, covariance=covariance)


def _as_whole(states: States, others: States, change: float) -> States:
    """States scaled and turned to the mean directions of others, with the biases of these.

    `change`: of the logarithm of the scale.
    """
    u, _, vt = np.linalg.svd(np.einsum("kij,klj->il", others.rotation, states.rotation))
    turn, unit, first = u @ vt, np.exp(change), states.position[0]
    return others._replace(
        rotation=turn @ states.rotation,
        position=first + unit * (states.position - first) @ turn.T,
        velocity=unit * states.velocity @ turn.T,
        log_scale=states.log_scale + change,
    )


def _woven(
    solved: KeyframeStates,
    tracked: Mapping[int, Sequence[TrackedPose]],
    between: Callable[[int, int], Interval | None],
    noise: ImuNoise,
) -> _Woven:
    """The chain with those frames that samples lead to and from."""
    nodes, states, steps = solved.nodes, solved.estimate.states, solved.estimate.steps
    poses, own = [nodes[0].world_from_cam], [_EXACT]
    parts, keyframes = [states.rows(slice(0, 1))], [0]
    inertial: list[Preintegrated | None] = []
    durations: list[float] = []
    for k, (before, after) in enumerate(pairwise(nodes)):
        chosen = _usable(before, after, tracked.get(before.frame_index, ()))
        if k < solved.doubted or steps.inertial[k] is None or not steps.is_visual[k]:
            chosen = []
        stamps = [before.stamp_ns, *(pose.stamp_ns for pose in chosen), after.stamp_ns]
        intervals = [i for i in (between(*ends) for ends in pairwise(stamps)) if i is not None]
        if not chosen or len(intervals) <= len(chosen):
            chosen, stamps = [], [before.stamp_ns, after.stamp_ns]
            inertial.append(steps.inertial[k])
        else:
            biases = states.gyro_bias[-1], states.accel_bias[-1]
            measured = [preintegrate(interval, *biases, noise) for interval in intervals]
            parts += _placed(states.rows(slice(k, k + 1)), chosen, measured, steps.imu_from_cam)
            inertial += measured
        durations += [1e-9 * (end - begin) for begin, end in pairwise(stamps)]
        poses += [before.world_from_cam @ pose.keyframe_from_cam for pose in chosen]
        own += [_ERROR**2 * np.linalg.inv(pose.information) for pose in chosen]
        parts.append(states.rows(slice(k + 1, k + 2)))
        poses.append(after.world_from_cam)
        own.append(_EXACT)
        keyframes.append(len(poses) - 1)
    world_from_cam, duration_s, ends = np.stack(poses), np.array(durations), np.array(keyframes)
    motion = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    visual = inverse(world_from_cam[:-1]) @ world_from_cam[1:]
    is_visual = steps.is_visual[motion]
    given = replace(
        steps,
        duration_s=duration_s,
        inertial=tuple(inertial),
        visual=visual,
        is_visual=is_visual,
    )
    errors = _shared_errors(steps, world_from_cam, ends, duration_s)
    kept = np.exp(-duration_s / _KEPT_S)
    kept[ends[:-1]] = kept[ends[1:] - 1] = 0.0
    begun = States(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    return _Woven(world_from_cam, begun, given, errors, np.stack(own), kept, ends)


def _usable(before: Node, after: Node, tracked: Sequence[TrackedPose]) -> list[TrackedPose]:
    """Frames that are not too near to the keyframes before and after them."""
    begin, end = before.stamp_ns + _PERIOD_NS // 2, after.stamp_ns - _PERIOD_NS // 2
    return [pose for pose in tracked if begin < pose.stamp_ns < end]


def _placed(
    keyframe: States,
    chosen: Sequence[TrackedPose],
    measured: Sequence[Preintegrated],
    imu_from_cam: Floats,
) -> list[States]:
    """States (1) of frames by that of the keyframe before them and the samples since."""
    result, last = [], keyframe
    world_from_imu = make_transform(keyframe.rotation[0], keyframe.position[0])
    for pose, samples in zip(chosen, measured, strict=False):
        relative = pose.keyframe_from_cam.copy()
        relative[:3, 3] *= np.exp(keyframe.log_scale[0])
        placed = world_from_imu @ imu_from_cam @ relative @ inverse(imu_from_cam)
        velocity = last.velocity + GRAVITY * samples.duration_s
        velocity = velocity + last.rotation[0] @ samples.velocity
        last = last._replace(
            rotation=placed[None, :3, :3], position=placed[None, :3, 3], velocity=velocity
        )
        result.append(last)
    return result


def _shared_errors(
    steps: Steps, world_from_cam: Floats, keyframes: Ints, duration_s: Floats
) -> tuple[Floats, Floats]:
    """As of `image_errors`: each part of a motion has its share of the variances, by its time."""
    covariance, sigma_scale = image_errors(steps)
    motion = np.repeat(np.arange(len(covariance)), np.diff(keyframes))
    share = duration_s / steps.duration_s[motion]
    rotation = world_from_cam[:, :3, :3]
    turn = np.zeros((len(motion), 6, 6))
    turn[:, :3, :3] = np.swapaxes(rotation[1:], 1, 2) @ rotation[keyframes[motion + 1]]
    turn[:, 3:, 3:] = turn[:, :3, :3]
    turned = turn @ covariance[motion] @ np.swapaxes(turn, 1, 2)
    return share[:, None, None] * turned, sigma_scale[motion] * np.sqrt(share)


class _WovenProblem(ChainProblem):
    """Measurements of such a chain; each pose by images has an error of its own as a state."""

    width = WIDTH + 6

    def __init__(self, woven: _Woven, prior: Prior, noise: ImuNoise) -> None:
        super().__init__(woven.steps, prior, noise, errors=woven.errors)
        count = len(woven.own)
        self._error = np.zeros((count, 6))
        self._rows = np.arange(count - 1)
        self._back = -adjoint(inverse(woven.steps.visual))
        # An error is what is kept of the one before it, and something new.
        self._kept = woven.kept[:, None]
        new = np.concatenate([[1.0], 1.0 - woven.kept**2])
        self._information = np.linalg.inv(new[:, None, None] * woven.own)
        self._first, self._second = np.zeros((2, count - 1, 6, self.width))
        self._first[:, :, WIDTH:] = -woven.kept[:, None, None] * np.eye(6)
        self._second[:, :, WIDTH:] = np.eye(6)

    def follow(self, step: Floats) -> None:
        """See `ChainProblem.follow`."""
        self._error += step[:, WIDTH:]

    def _add_visual(self, equations: Equations, states: States) -> float:
        rows, error = self.visual_rows, self._error
        seen = self.visual(states)
        back = self._back[rows]
        residual = seen.residual + error[rows + 1] + (back @ error[rows, :, None])[..., 0]
        first = np.concatenate([seen.first, back], axis=2)
        second = np.concatenate([seen.second, self._second[rows, :, WIDTH:]], axis=2)
        information = self.visual_information
        total = add_factors(rows, residual, first, second, information, HUBER, equations)
        change = error[1:] - self._kept * error[:-1]
        of_errors = self._rows, change, self._first, self._second, self._information[1:], np.inf
        self.cost += float(add_factors(*of_errors, equations))
        equations.before[0, WIDTH:, WIDTH:] += self._information[0]
        equations.gradient_before[0, WIDTH:] += self._information[0] @ error[0]
        return float(total)
