"""Frames that are not simply tracked: misled, frozen, rescued and lost ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from vo.base.failures import Failure, FailureReason, ImageDefect
from vo.base.types import Floats, State
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.map_alignment import MapAlignment
from vo.engine.map_creator import MapCreator
from vo.engine.map_updater import MapUpdater
from vo.engine.mapping.keyframe import FrameId
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.tracking.frozen_camera import FrozenCamera
from vo.engine.tracking.rescue import Rescue
from vo.engine.tracking.tracker import Tracker

if TYPE_CHECKING:
    from vo.engine.inertial.prediction import InertialPredictor

_MAX_MISSING_RATIO = 0.5  # of the rows of an image
_MAX_PREDICTED_S = 1.5  # lost frames that an inertial sensor predicts


class AnyFrame(Protocol):
    """A preprocessed frame."""

    @property
    def index(self) -> int:
        """Its number in the source."""
        ...

    @property
    def stamp_ns(self) -> int:
        """Its time."""
        ...

    def start_features(self) -> None:
        """Start to extract features, in a thread where there is one."""
        ...


FrameT = TypeVar("FrameT", bound=AnyFrame)


class LossPolicy:
    """Gives up after a number of lost frames; later while an inertial sensor predicts the pose."""

    def __init__(self, recover_frames: int, predictor: InertialPredictor | None) -> None:
        self._recover_frames = recover_frames
        self._predictor = predictor

    def gives_up(self, lost: Sequence[AnyFrame]) -> bool:
        """Whether to give up the map after these lost frames."""
        if len(lost) <= self._recover_frames:
            return False
        first_ns, last_ns = lost[0].stamp_ns, lost[-1].stamp_ns
        if self._predictor is None or last_ns - first_ns >= _MAX_PREDICTED_S * 1e9:
            return True
        return not self._predictor.has_samples(first_ns, last_ns)


class Segments(Generic[FrameT]):
    """Begins a new segment where too many frames are lost, and tracks them again; knows the state.

    Attributes:
        state: whether there is a map, and whether the newest frame was tracked in it.
        segment: number of the segment of the newest frame.

    Args:
        give_up: the map, before a new segment.
    """

    def __init__(self, policy: LossPolicy, give_up: Callable[[], None]) -> None:
        self.state = State.STARTING
        self.segment = 0
        self._policy = policy
        self._give_up = give_up
        self._lost: list[FrameT] = []  # the newest frames, since tracking was lost

    def frames(self, frame: FrameT) -> Iterator[FrameT]:
        """Frames to track one after the other: a new one, and lost ones after it.

        A map in which too many were lost is given up, as a new one may hold them.
        """
        yield frame
        if self._policy.gives_up(self._lost):
            self._give_up()
            lost, self._lost = self._lost, []
            self.state = State.STARTING
            self.segment += 1
            yield from lost

    def found(self) -> None:
        """Go on from a frame that was tracked."""
        self.state, self._lost = State.TRACKING, []

    def lose(self, frame: FrameT) -> None:
        """Keep a frame that was not tracked."""
        self.state = State.LOST
        self._lost.append(frame)


class Recovery(Segments[PreprocessedFrame]):
    """Decides what to do with frames that mislead, repeat or are lost."""

    def __init__(
        self,
        tracker: Tracker,
        rescue: Rescue,
        creator: MapCreator,
        updater: MapUpdater,
        map_alignment: MapAlignment,
        policy: LossPolicy,
    ) -> None:
        super().__init__(policy, self._give_up_map)
        self._tracker = tracker
        self._rescue = rescue
        self._creator = creator
        self._updater = updater
        self._map_alignment = map_alignment
        self._frozen_camera = FrozenCamera(tracker)

    def frames(self, frame: PreprocessedFrame) -> Iterator[PreprocessedFrame]:
        """Frames to track one after the other: a new one, misled ones before it, lost ones after.

        Those that were misled are forgotten first.
        """
        misled = frame.misled if self._forget(frame.misled) else ()
        for each in (*misled, frame):
            yield from super().frames(each)

    def why_useless(self, frame: PreprocessedFrame) -> Failure | None:
        """Why a frame is not tracked: it repeats the one before as the camera moves, or lacks rows.

        Poses of images that lack more than half are inaccurate: 14 mm in a hall with one camera in
        which those of whole images have 6 mm.
        """
        if frame.missing_ratio > _MAX_MISSING_RATIO:
            return Failure(FailureReason.IMAGE_DEFECT, defect=ImageDefect.CUT)
        is_frozen = self._frozen_camera.is_frozen(frame, self.segment)
        return Failure(FailureReason.REPEATED_IMAGE) if is_frozen else None

    def resume(self, tracked: TrackedFrame) -> list[FrameId]:
        """The frozen frames before a tracked one that have the last pose after all."""
        return self._frozen_camera.resume(tracked)

    def track(
        self, frame: PreprocessedFrame, last_from_cam: Floats | None
    ) -> tuple[PreprocessedFrame, TrackedFrame | Failure]:
        """Track a frame with features of either kind; the frame with those of the map's kind."""
        is_lost = self.state is State.LOST or self._frozen_camera.has_withheld
        frame = self._rescue.of_map(frame)
        tracked = self._tracker.track(frame, last_from_cam, is_lost=is_lost)
        if isinstance(tracked, Failure):
            frame, tracked = self._rescue.track(frame, tracked)
        if isinstance(tracked, Failure):
            self.lose(frame.of_kind(is_second=False))
        else:
            self.found()
        return frame, tracked

    def start(self, frame: PreprocessedFrame) -> PreprocessedFrame:
        """Track in a new map from now on; its frame with features of the map's kind."""
        self.found()
        return self._rescue.of_map(frame)

    def _forget(self, misled: Sequence[PreprocessedFrame]) -> bool:
        """Go back to before misled frames; whether that was possible."""
        if not misled or not self._updater.forget_from(misled[0], self.segment):
            return False
        self._map_alignment.forget_from(misled[0].index)
        self._creator.restart()
        self.state, self._lost = State.STARTING, []
        return True

    def _give_up_map(self) -> None:
        self._updater.apply()
        self._tracker.forget_last_frame()
        self._creator.restart()
