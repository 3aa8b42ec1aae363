"""The chain of keyframes of a run with their inertial states, estimated as it grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, ImuNoise
from vo.engine.inertial.agreement import Agreement, agreement
from vo.engine.inertial.between_keyframes import TrackedPoses, with_frames
from vo.engine.inertial.earlier_states import with_earlier
from vo.engine.inertial.estimation import (
    ChainProblem,
    Estimate,
    KnownBiases,
    Prior,
    estimate_states,
    first_prior,
    weighed_states,
    with_weighed_images,
)
from vo.engine.inertial.initialisation import Keyframes, NotYet, initial_estimate
from vo.engine.inertial.keyframe_states import KeyframeStates, Node, certain, covariances
from vo.engine.inertial.preintegration import Interval, Preintegrated, preintegrate
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import (
    GRAVITY,
    States,
    Steps,
    joined,
    predicted_motion,
)
from vo.engine.inertial.world_alignment import placed_at_origin

_WINDOW_LAST_STEP = 3.0  # standard deviations
_WINDOW = 12  # newest keyframes whose states are estimated together
_MAX_FIRST = 40  # newest keyframes that first states are searched with
_RETRY_NS = 1_000_000_000  # after the motion did not determine the first states
_RARELY_TRIED = (NotYet.NO_MOTION, NotYet.NO_GRAVITY, NotYet.WRONG_GRAVITY, NotYet.OPPOSITE)
_MAX_BRIDGE_S = 5.0  # between segments without images
_MAX_BIAS_RAD_S = 0.003  # from which preintegration is repeated
_DOUBT = 32.0  # on standard deviations of motions by images that the samples contradict


class InertialChain:
    """Keyframes in time order, and the newest estimate of their states.

    Attributes:
        reason: why there is no estimate, None where there is one.
        initialised_frame: number of the frame at which first states were found, None before.
        agreement: of finished worlds, the first one that contradicts.
        finished: the worlds before the newest one.
        tracked: frames between the keyframes of one camera.
    """

    def __init__(
        self, reader: SampleReader, noise: ImuNoise, imu_from_cam: Floats, *, is_metric: bool
    ) -> None:
        self.reason: NotYet | None = NotYet.FEW_KEYFRAMES
        self.initialised_frame: int | None = None
        self.agreement = Agreement()
        self.finished: list[KeyframeStates] = []
        self.tracked = TrackedPoses(is_metric=is_metric)
        self._reader, self._noise = reader, noise
        self._imu_from_cam, self._is_metric = imu_from_cam, is_metric
        self._nodes: list[Node] = []
        self._intervals: list[Interval | None] = []  # before each node
        self._measured: list[Preintegrated | None] = []
        self._tried_ns: int | None = None  # time of the newest node when states were searched
        self._origin = 0  # row of the first node of the world
        self._begin = 0  # row of the first node of the estimate
        self._doubted = 0  # first nodes of the world whose images the samples contradict
        self._estimate: Estimate | None = None
        self._prior: Prior | None = None  # of the first node of the estimate
        self._biases: KnownBiases | None = None  # at the end of the world before
        self._moved_ns: Mapping[int, int] = {}  # other times than some stamps
        self._last: KeyframeStates | None = None  # what `finish` gave

    @property
    def is_initialised(self) -> bool:
        """Whether there is an estimate."""
        return self._estimate is not None

    @property
    def nodes(self) -> Sequence[Node]:
        """All keyframes."""
        return self._nodes

    @property
    def newest(self) -> KeyframeStates | None:
        """The newest keyframes with their states."""
        if self._estimate is None:
            return None
        return self._solved(self._begin, self._estimate)

    def set(self, node: Node) -> None:
        """Add a keyframe, or replace one by its newest pose."""
        for row in range(len(self._nodes) - 1, -1, -1):
            if self._nodes[row].keyframe == node.keyframe:
                kept = self._nodes[row].covariance if node.covariance is None else node.covariance
                self._nodes[row] = replace(node, covariance=kept)
                return
            if self._nodes[row].keyframe < node.keyframe:
                break
        interval = None
        if self._nodes:
            interval = self._reader.between(self._nodes[-1].stamp_ns, node.stamp_ns)
        self._nodes.append(node)
        self._intervals.append(interval)
        self._measured.append(None)

    def remove_from(self, frame_index: int) -> None:
        """Forget a frame and all after it, which are tracked anew; states are found anew, too."""
        self.tracked.forget_from(frame_index)
        self._last = None
        kept = sum(node.frame_index < frame_index for node in self._nodes)
        del self._nodes[kept:], self._intervals[kept:], self._measured[kept:]
        self._estimate = self._prior = self._tried_ns = self._biases = None
        self._origin = self._begin = 0
        self.finished.clear()

    def restart(self) -> None:
        """Search first states anew, with the samples by the newest time offset."""
        self.read_again()
        self.agreement = Agreement()
        self._estimate = self._prior = self.initialised_frame = self._biases = None
        self._origin = self._begin = 0
        self.finished.clear()

    def read_again(self, moved_ns: Mapping[int, int] | None = None) -> None:
        """Take all samples by the newest time offset, or by other times than some stamps.

        What follows has to be `finish`.
        """
        self._moved_ns, self._last = moved_ns or {}, None
        for row in range(1, len(self._nodes)):
            before, after = self._nodes[row - 1 : row + 1]
            self._intervals[row] = self._between(before.stamp_ns, after.stamp_ns)
        self._measured = [None] * len(self._nodes)
        self._tried_ns = None

    def update(self) -> KeyframeStates | None:
        """Estimate the states of the newest keyframes; None while that is impossible."""
        if self._estimate is not None:
            self._extend(self._estimate)
        if self._estimate is None:
            return self._initialise() if self._is_search_due() else None
        return self.newest

    def _is_search_due(self) -> bool:
        """Whether to search first states: at times only, where more motion is needed."""
        if self.reason not in _RARELY_TRIED or self._tried_ns is None:
            return True
        return self._nodes[-1].stamp_ns >= self._tried_ns + _RETRY_NS

    def finish(self) -> KeyframeStates | None:
        """Estimate all states of the newest world together, and keep the result."""
        solved = self._judged()
        if solved is not None:
            self._begin, self._estimate = self._origin, solved.estimate
            solved = self._last = self._reached_back(solved)
        return solved

    def _reached_back(self, solved: KeyframeStates) -> KeyframeStates:
        """The world with segments from before its first states, if they fit to it.

        Where images contradict the samples there, a few seconds are placed by the samples.
        """
        kept, begin = (self._origin, self.agreement), self._origin
        while begin > 0 and not self.finished and self._is_bridged(begin):
            begin -= 1
        if self.agreement.contradiction or self._nodes[begin].segment == solved.world:
            return solved
        before_s = 1e-9 * (self._nodes[kept[0]].stamp_ns - self._nodes[begin].stamp_ns)
        for self._doubted in (0, kept[0] - begin) if before_s < _MAX_BRIDGE_S else (0,):
            self._origin, self.agreement = begin, kept[1]
            longer, added = self._judged(is_last=False), kept[0] - begin
            is_certain = longer is not None and certain(longer)[:added] == list(range(added))
            if not self.agreement.contradiction:
                if longer is None or not is_certain:
                    break
                self._begin, self._estimate = begin, longer.estimate
                return longer
        self._doubted, (self._origin, self.agreement) = 0, kept
        return solved

    def _is_bridged(self, row: int) -> bool:
        """Whether samples lead from the keyframe before, and images unless it is near."""
        between = self._intervals[row]
        is_near = between is not None and between.duration_s <= _MAX_BRIDGE_S
        return between is not None and (is_near or self._is_visual(row))

    def _judged(self, *, is_last: bool = True) -> KeyframeStates | None:
        """All states of the newest world, which is complete, after a test of their agreement."""
        try:
            solved = self._weighed()
        except np.linalg.LinAlgError:
            if is_last:  # one of few states that a long gap ends may have no solution
                self.agreement = Agreement(NotYet.DISAGREEMENT.value)
            return self.newest
        if solved is not None:
            states = solved.estimate.states
            prior = self._first_prior(states)
            problem = ChainProblem(solved.estimate.steps, prior, self._noise)
            if self.agreement.contradiction is None:
                self.agreement = agreement(problem, states)
            if self.agreement.contradiction is not None:
                return solved
            if self._is_metric:
                estimate = with_weighed_images(solved.estimate, prior, self._noise)
            else:
                tracked = self.tracked.by_keyframe()
                estimate = with_frames(solved, tracked, self._between, prior, self._noise)
            solved = replace(solved, estimate=estimate)
        return solved

    def _between(self, *images_ns: int) -> Interval | None:
        """Samples between the times of two images."""
        return self._reader.between(*(self._moved_ns.get(each, each) for each in images_ns))

    def smoothed(self) -> KeyframeStates | None:
        """All states of the newest world, in the frame of its first camera; None without any."""
        return self._weighed() if self._last is None else self._last

    def _weighed(self) -> KeyframeStates | None:
        if self._estimate is None:
            return None
        biases = self._estimate.states
        count = self._begin + biases.number
        for row in range(self._origin + 1, count):
            self._preintegrate(row, biases.gyro_bias[-1], biases.accel_bias[-1])
        states = placed_at_origin(self._whole_history(), self._imu_from_cam)
        prior = self._first_prior(states)
        estimate = weighed_states(states, self._steps(self._origin, count), prior, self._noise)
        return self._solved(self._origin, estimate)

    def _initialise(self) -> KeyframeStates | None:
        """Search first states with the newest keyframes of one segment."""
        begin, count = self._unbroken_begin(), len(self._nodes)
        intervals = [i for i in self._intervals[begin + 1 :] if i is not None]
        if len(intervals) < 3:
            self.reason = NotYet.FEW_KEYFRAMES
            return None
        nodes = self._nodes[begin:]
        self._tried_ns = nodes[-1].stamp_ns
        keyframes = Keyframes(
            np.stack([n.world_from_cam for n in nodes]),
            covariances(nodes[1:]),
            tuple(intervals),
            self._is_metric,
            self._imu_from_cam,
            self._noise,
            self._biases_at(begin),
        )
        found = initial_estimate(keyframes)
        if isinstance(found, NotYet):
            self.reason = found
            return None
        self.reason = None
        if self.initialised_frame is None:
            self.initialised_frame = nodes[-1].frame_index
        self._origin = self._begin = begin
        self._estimate = found
        self._prior = self._first_prior(found.states)
        for row in range(begin + 1, count):
            self._preintegrate(row, found.states.gyro_bias[-1], found.states.accel_bias[-1])
        return self.newest

    def _biases_at(self, row: int) -> KnownBiases | None:
        """What the world before says of the biases at a keyframe."""
        if self._biases is None:
            return None
        return self._biases.at(self._nodes[row].stamp_ns, self._noise)

    def _first_prior(self, states: States) -> Prior:
        """What is known of the first of the states of the world."""
        first, biases = states.rows(slice(0, 1)), self._biases_at(self._origin)
        return first_prior(first, is_metric=self._is_metric, biases=biases)

    def _unbroken_begin(self) -> int:
        """Row of the first of the newest keyframes of one segment without missing samples."""
        begin = len(self._nodes) - 1
        oldest = max(0, len(self._nodes) - _MAX_FIRST)
        while begin > oldest and self._is_visual(begin) and self._intervals[begin] is not None:
            begin -= 1
        return max(begin, 0)

    def _is_visual(self, row: int) -> bool:
        """Whether a keyframe and the one before it are of one segment."""
        return self._nodes[row].segment == self._nodes[row - 1].segment

    def _extend(self, estimate: Estimate) -> None:
        """Add the new keyframes to the estimate, and drop the oldest ones from it."""
        count = self._begin + estimate.states.number
        while self._estimate is not None and count < len(self._nodes):
            states = self._predicted(count, self._estimate.states)
            if states is None:  # neither images nor samples lead here: a new world begins
                self._biases = estimate.last_biases(
                    self._nodes[self._begin + estimate.states.number - 1].stamp_ns
                )
                self._estimate = estimate
                finished = self._judged(is_last=False)
                if finished is not None:
                    self.finished.append(finished)
                self._estimate = self._prior = None
                self.reason = NotYet.FEW_KEYFRAMES
                return
            count += 1
            self._estimate = replace(self._estimate, states=states)
        assert self._estimate is not None
        states = self._estimate.states
        begin = max(self._begin, count - _WINDOW)
        if begin > self._begin:
            self._prior = estimate.prior_of(begin - self._begin)
            states = states.rows(slice(begin - self._begin, None))
            self._begin = begin
        assert self._prior is not None
        steps = self._steps(begin, count)
        try:
            # Every keyframe brings another iteration with all states of the window.
            self._estimate = estimate_states(
                states, steps, self._prior, self._noise, last_step=_WINDOW_LAST_STEP
            )
        except np.linalg.LinAlgError:
            self._estimate = self._prior = None
            self.reason = NotYet.DISAGREEMENT
            self.agreement = Agreement(NotYet.DISAGREEMENT.value)

    def _predicted(self, row: int, states: States) -> States | None:
        """States with one more, at a keyframe after the last; None without measurements of it."""
        last = states.rows(slice(-1, None))
        measured = self._preintegrate(row, last.gyro_bias[0], last.accel_bias[0])
        if self._is_visual(row):
            world_from_cam = np.eye(4)
            world_from_cam[:3, :3] = last.rotation[0] @ self._imu_from_cam[:3, :3]
            before, after = self._nodes[row - 1], self._nodes[row]
            motion = inverse(before.world_from_cam) @ after.world_from_cam
            motion[:3, 3] *= np.exp(last.log_scale[0])
            lever = self._imu_from_cam[:3, 3]
            world_from_cam[:3, 3] = last.position[0] + last.rotation[0] @ lever
            pose = world_from_cam @ motion @ inverse(self._imu_from_cam)
            rotation, position = pose[:3, :3], pose[:3, 3]
            velocity = last.velocity[0]
            if measured is not None:
                velocity = velocity + GRAVITY * measured.duration_s
                velocity = velocity + last.rotation[0] @ measured.velocity
        elif measured is None or measured.duration_s > _MAX_BRIDGE_S:
            return None
        else:
            rotation, position, velocity = predicted_motion(last, measured)
        added = last._replace(
            rotation=rotation[None], position=position[None], velocity=velocity[None]
        )
        return joined(states, added)

    def _whole_history(self) -> States:
        """Starting states of all keyframes of the world."""
        assert self._estimate is not None
        if self._begin == self._origin:
            return self._estimate.states
        poses = np.stack([n.world_from_cam for n in self._nodes[self._origin : self._begin + 1]])
        steps = self._steps(self._origin, self._begin + 1)
        return with_earlier(self._estimate.states, poses, steps)

    def _preintegrate(
        self, row: int, gyro_bias: Floats, accel_bias: Floats
    ) -> Preintegrated | None:
        """Preintegrate the samples before a keyframe, unless that was done at these biases."""
        interval, measured = self._intervals[row], self._measured[row]
        if interval is None:
            return None
        if measured is None or np.abs(measured.gyro_bias - gyro_bias).max() > _MAX_BIAS_RAD_S:
            measured = preintegrate(interval, gyro_bias, accel_bias, self._noise)
            self._measured[row] = measured
        return measured

    def _steps(self, begin: int, end: int) -> Steps:
        """Measurements between the keyframes of some rows."""
        nodes = self._nodes[begin:end]
        poses = np.stack([n.world_from_cam for n in nodes])
        covariance = covariances(nodes[1:])
        covariance[: self._doubted] *= _DOUBT**2
        return Steps(
            1e-9 * np.diff([n.stamp_ns for n in nodes]),
            tuple(self._measured[begin + 1 : end]),
            inverse(poses[:-1]) @ poses[1:],
            covariance,
            np.array([self._is_visual(row) for row in range(begin + 1, end)], dtype=bool),
            self._is_metric,
            self._imu_from_cam,
        )

    def _solved(self, begin: int, estimate: Estimate) -> KeyframeStates:
        nodes = tuple(self._nodes[begin : begin + estimate.states.number])
        origin = self._nodes[self._origin]
        place = origin.segment, origin.keyframe
        return KeyframeStates(nodes, estimate, *place, self._doubted)
