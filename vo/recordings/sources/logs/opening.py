"""Opening of a log as a source."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from vo.base.errors import CalibrationError, NoCalibration, SourceError, VoError
from vo.base.faults import Fault
from vo.base.types import Floats, Mode, Rig, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize, read_calibration
from vo.recordings.formats.calibration.checks import rig_of
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    ImageMessage,
    TransformsMessage,
)
from vo.recordings.formats.pixels import DEPTH_UNITS_PER_METRE
from vo.recordings.sources.assembly import RecordingContents, assemble, no_calibration
from vo.recordings.sources.imu import Imu, imu_of
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.choice import ChosenTopics, choose_topics
from vo.recordings.sources.logs.frame_tree import FrameTree, read_frame_tree
from vo.recordings.sources.logs.images import MessageImage, list_images, list_shots
from vo.recordings.sources.logs.imu import imu_topics, log_imus
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.poses import find_truth_topic, read_truth
from vo.recordings.sources.logs.realsense_bag import (
    extrinsics_topics,
    stream_of,
    stream_transforms,
)
from vo.recordings.sources.logs.rig import (
    LogCamera,
    are_apart,
    cam0_from_cam,
    cam1_from_cam0,
    find_camera,
)
from vo.recordings.sources.sequence import ImageSequence

_log = logging.getLogger(__name__)


def open_log(
    log: Log,
    format: str,
    calibration: Path | None,
    mode: Mode,
    topics: Sequence[str] = (),
    right_offset_ns: int | None = None,
    *,
    is_rig: bool = True,
) -> ImageSequence:
    """Create a source from a log.

    `calibration`: file that overrides the calibration in the log. `is_rig`: whether it may have
    more than two cameras.
    """
    may_be_rig = is_rig and calibration is None
    choice = choose_topics(log.topics, topics, mode, may_be_rig=may_be_rig)
    opened = ChosenLog(log, choice)
    own = None
    if may_be_rig and mode == "auto" and (choice.further or choice.doubt):
        choice, own = opened.rig_of_log()
    faults: list[Fault] = []
    _log.info("%s: images of %s", log.path, " and ".join(t.name for t in choice.cameras))
    left = list_images(log, choice.left, opened.entries[choice.left.name], faults)
    if own is None and calibration is None:
        try:
            own = opened.calibration_of_log(mode, may_be_apart=is_rig and mode == "auto")
        except NoCalibration as error:
            raise no_calibration(error, choice.right is not None, mode) from error
    right = None
    if choice.right is not None and mode != "mono" and (own is None or own.rig.is_stereo):
        right = list_images(log, choice.right, opened.entries[choice.right.name])
    many = choice.further if own is None or own.rig.further else ()

    def calibrate(size: ImageSize) -> Calibration:
        if own is not None:
            return own
        assert calibration is not None
        found = read_calibration(calibration, size)
        return replace(found, depth_per_metre=found.depth_per_metre or DEPTH_UNITS_PER_METRE)

    contents = RecordingContents(
        name=log.path.resolve().stem,
        format=format,
        left=left,
        right=right,
        calibrate=calibrate,
        read_truth=opened.truth,
        depth=opened.depth(),
        find_imus=opened.imus,
        right_offset_ns=right_offset_ns,
        faults=faults,
        further=[list_images(log, topic, opened.entries[topic.name]) for topic in many],
    )
    return assemble(contents, mode)


class ChosenLog:
    """The chosen topics of a log and the messages that describe its cameras."""

    def __init__(self, log: Log, choice: ChosenTopics) -> None:
        self._log = log
        self._choice = choice
        self._calibrations = _topics_of_type(log.topics, CalibrationMessage)
        transforms = _topics_of_type(log.topics, TransformsMessage)
        self._imus = imu_topics(log.topics, choice.imu)
        self._truth = find_truth_topic(log.topics, choice.truth)
        raw = _topics_of_type(log.topics, ImageMessage, CompressedImageMessage)
        self._depth = [topic for topic in raw if "depth" in topic.name.lower()]
        if choice.right is not None:
            self._depth = []
        topics = [*choice.cameras, self._truth]
        topics += [*self._calibrations, *transforms, *self._depth, *extrinsics_topics(log.topics)]
        names = dict.fromkeys(topic.name for topic in topics if topic is not None)
        self.entries: dict[str, list[Entry]] = log.entries(list(names))
        listed = [(topic, self.entries[topic.name]) for topic in transforms]
        self._frames: FrameTree = read_frame_tree(log, listed)
        self._frames.add(stream_transforms(log, log.topics, self.entries))

    def calibration_of_log(self, mode: Mode, *, may_be_apart: bool) -> Calibration:
        """Calibration of one or two cameras; an uncalibrated right one is left out in `auto`."""
        is_one = self._choice.right is None or mode == "mono"
        left = self._camera(self._choice.left)
        if self._choice.right is None or is_one:
            return Calibration(Rig(left.camera), depth_per_metre=DEPTH_UNITS_PER_METRE)
        try:
            right = self._camera(self._choice.right)
            transform = cam1_from_cam0(left, right, self._frames, may_be_apart=may_be_apart)
        except CalibrationError as error:
            if mode == "stereo":
                raise
            _log.warning("only the left camera is used: %s", error)
            return Calibration(Rig(left.camera), depth_per_metre=DEPTH_UNITS_PER_METRE)
        return Calibration(Rig(left.camera, right.camera, transform))

    def rig_of_log(self) -> tuple[ChosenTopics, Calibration | None]:
        """The cameras whose poses are known, and their calibration; None for a pair or one camera.

        Raises:
            SourceError: they are no rig, and names do not say which are a pair.
        """
        choice, reasons = self._choice, []
        found: list[tuple[Topic, LogCamera, Floats]] = []
        for topic in choice.cameras:
            try:
                camera = self._camera(topic)
                first = found[0][1] if found else camera
                found.append((topic, camera, cam0_from_cam(first, camera, self._frames)))
            except CalibrationError as error:
                reasons.append(f"{topic.name} is not used: {error}")
        is_rig = len(found) > 2 or (bool(choice.doubt) and are_apart([pose for *_, pose in found]))
        if not is_rig or found[0][0] is not choice.left:
            if choice.doubt:
                raise SourceError(choice.doubt)
            return choice, None
        for reason in reasons:
            _log.warning("%s", reason)
        topics, cameras, poses = zip(*found, strict=True)
        where = f"{self._log.path}: poses of {', '.join(topic.name for topic in topics)}"
        rig = rig_of(where, [each.camera for each in cameras], poses)
        used = replace(choice, right=topics[1], further=topics[2:], doubt="")
        return used, Calibration(rig)

    def depth(self) -> list[Shot] | None:
        """Depth registered to the left camera; None without such depth or with a right camera."""
        frame = self._frame(self._choice.left)
        for topic in self._depth if frame else ():
            found = self._frame(topic, 10)
            if found == frame:
                entries = self.entries[topic.name]
                images = [MessageImage(self._log, topic, entry, is_depth=True) for entry in entries]
                return list_shots(self._log, topic, entries, images.__getitem__)
            _log.debug("%s not used: frame %s, but camera frame %s", topic.name, found, frame)
        return None

    def truth(self, calibration: Calibration) -> Trajectory | None:
        """Ground-truth poses of cam0, or None."""
        if self._truth is None:
            return None
        entries = self.entries[self._truth.name]
        frame = self._frame(self._choice.left)
        return read_truth(self._log, self._truth, entries, frame, self._frames, calibration)

    def imus(self, calibration: Calibration | None) -> list[Imu]:
        """The inertial sensors."""
        return log_imus(self._log, self._imus, self.cam0_from, imu_of(calibration))

    def cam0_from(self, frame: str) -> Floats | None:
        """The (4, 4) pose of a frame in that of the left camera, None if it is unknown."""
        return self._frames.between(self._frame(self._choice.left), frame) if frame else None

    def _camera(self, image: Topic) -> LogCamera:
        return find_camera(self._log, image, self._frame(image), self._calibrations, self.entries)

    def _frame(self, image: Topic, tried: int | None = None) -> str:
        """The frame of the first readable image, perhaps of the first few only."""
        if stream := stream_of(image.name):
            return stream
        for entry in self.entries[image.name][:tried]:
            try:
                message = image.codec.decode(self._log.read(entry))
            except VoError:
                continue
            return str(getattr(message, "frame", "")).lstrip("/")
        return ""


def _topics_of_type(topics: Sequence[Topic], *kinds: type) -> list[Topic]:
    return [topic for topic in topics if issubclass(topic.codec.kind, kinds)]
