"""Records a run as an MCAP file for Foxglove.

Topics: `/tf` (world, cam0 and the camera of the images), `/pose` (causal), `/path` (causal, moved
with keyframes that are re-posed; smoothed at the end), `/map` (landmarks of the local map),
`/image`, `/calibration` and `/features` of each frame.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from google.protobuf.message import Message as PbMessage
from mcap.well_known import MessageEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from vo.base.files.complete_file import writing
from vo.base.records.snapshot import FeatureState, Snapshot, View
from vo.base.types import Estimate, Floats, KeyframePose, Landmarks, Rig, Trajectory
from vo.outputs.recorders.durable_file import DurableFile
from vo.outputs.recorders.keyframe_history import KeyframeHistory
from vo.outputs.recorders.reconstruction import camera_of, dimmed
from vo.outputs.recorders.recorder import NO_FINDINGS, Findings, TakeSnapshot
from vo.recordings.formats.foxglove import as_protobuf
from vo.recordings.formats.foxglove_scene import Colour, cloud_message, marks_message, path_message
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    FrameTransform,
    Message,
    PoseMessage,
    TransformsMessage,
)

_WORLD, _CAM0, _IMAGE0 = "world", "cam0", "cam0_image"
_JPEG_QUALITY = 80
_MARK_PX = 3.0
_GROWTH = 1.05  # factor by which the path grows before the whole of it is written again
_MID_GREY = 128
_FLUSH_S = 0.5
# Of Okabe and Ito (2008), as in the viewer and the report.
_COLOURS = {
    FeatureState.NEW: Colour(0.34, 0.71, 0.91),
    FeatureState.TRACKED: Colour(0.0, 0.62, 0.45),
    FeatureState.REJECTED: Colour(0.84, 0.37, 0.0),
}


class McapRecorder:
    """Writes a run with Foxglove's protobuf messages, in chunks packed with zstd.

    A chunk ends after half a second at the latest: if the run is killed, what is in the file by
    then can be read. On a full disk the file ends with a complete chunk.

    `path`: the file; an existing one is replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._poses: list[Floats] = []
        self._keyframe: list[int] = []  # frame number of the newest keyframe at each pose
        self._keyframes = KeyframeHistory()
        self._poses_written = 0
        self._stamp_ns = 0
        self._channels: dict[str, int] = {}

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Open the file.

        Raises:
            OutputError: the file cannot be written.
        """
        with writing(f"recording {self._path}", "choose another `mcap`"):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = DurableFile(self._path)
            with self._cut_after_an_error():
                self._writer = Writer(self._file)  # type: ignore[arg-type]
                self._writer.start(library="vo")
                self._writer.add_metadata("recording", {"name": name, "library": "vo"})
                self._flush()

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Write one frame.

        Raises:
            OSError: the disk is full.
        """
        current = snapshot()
        with self._cut_after_an_error():
            self._record(estimate, current)
            if time.monotonic() - self._flushed >= _FLUSH_S:
                self._flush()

    def flush(self) -> None:
        """End the chunk.

        Raises:
            OSError: the disk is full.
        """
        with self._cut_after_an_error():
            self._flush()

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Write the smoothed path and close the file.

        Raises:
            OSError: the disk is full.
        """
        with self._cut_after_an_error():
            if len(smoothed):
                self._write_path(smoothed.world_from_cam)
            self._flush()
            self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    @contextmanager
    def _cut_after_an_error(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            self._file.cut()
            raise

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._flushed = time.monotonic()

    def _record(self, estimate: Estimate, current: Snapshot) -> None:
        self._stamp_ns = estimate.stamp_ns
        pose = estimate.world_from_cam0
        self._update_path(estimate.keyframes, current)
        self._write_transforms(current.view, pose)
        if pose is not None:
            self._write("/pose", PoseMessage(self._stamp_ns, _WORLD, pose))
            self._poses.append(pose)
            self._keyframe.append(self._keyframes.newest)
        self._write_image(current.view)
        if current.landmarks is not None:
            self._write_landmarks(current.landmarks)
        if len(self._poses) > _GROWTH * self._poses_written:
            self._write_path(np.stack(self._poses))
            self._poses_written = len(self._poses)

    def _update_path(self, keyframes: Sequence[KeyframePose], snapshot: Snapshot) -> None:
        """Move earlier poses with keyframes that were re-posed."""
        moves = self._keyframes.update(keyframes, snapshot).moves
        if not moves:
            return
        self._poses = [
            moves[keyframe] @ pose if keyframe in moves else pose
            for keyframe, pose in zip(self._keyframe, self._poses, strict=True)
        ]
        self._poses_written = 0  # write the whole path again

    def _write_landmarks(self, landmarks: Landmarks) -> None:
        grey = landmarks.grey
        if grey is None:
            grey = np.full(len(landmarks.ids), _MID_GREY, dtype=np.uint8)
        self._send("/map", cloud_message(self._stamp_ns, _WORLD, landmarks.xyz, grey))

    def _write_transforms(self, view: View, pose: Floats | None) -> None:
        cam0_from_image0 = np.eye(4) if view.cam0_from_image0 is None else view.cam0_from_image0
        transforms = [FrameTransform(_CAM0, _IMAGE0, cam0_from_image0)]
        if pose is not None:
            transforms.append(FrameTransform(_WORLD, _CAM0, pose))
        self._write("/tf", TransformsMessage(self._stamp_ns, tuple(transforms)))

    def _write_image(self, view: View) -> None:
        stamp_ns, camera = self._stamp_ns, camera_of(view)
        shown = dimmed(view.image0, view.masks[0])
        done, data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        assert done
        self._write("/image", CompressedImageMessage(stamp_ns, _IMAGE0, "jpeg", data.tobytes()))
        projection = np.column_stack([view.camera_matrix, np.zeros(3)])
        calibration = CalibrationMessage(stamp_ns, _IMAGE0, camera, np.eye(3), projection)
        self._write("/calibration", calibration)
        marks = {colour: view.xy[view.feature_state == state] for state, colour in _COLOURS.items()}
        self._send("/features", marks_message(stamp_ns, marks, _MARK_PX))

    def _write_path(self, poses: Floats) -> None:
        self._send("/path", path_message(self._stamp_ns, _WORLD, poses))

    def _write(self, topic: str, message: Message) -> None:
        self._send(topic, as_protobuf(message))

    def _send(self, topic: str, message: PbMessage) -> None:
        if topic not in self._channels:
            schema = register_schema(self._writer, type(message))
            self._channels[topic] = self._writer.register_channel(
                topic, MessageEncoding.Protobuf, schema
            )
        data = message.SerializeToString()
        self._writer.add_message(self._channels[topic], self._stamp_ns, data, self._stamp_ns)
