"""Records the frames of a live run as an MCAP file, from which `vo run` reads the same frames.

Topics, with Foxglove's messages: `/camN/image_raw` (grey, not rectified, not compressed),
`/camN/camera_info` for each image, and `/tf_static` with the right camera's pose.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from google.protobuf.message import Message as PbMessage
from mcap.well_known import MessageEncoding
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from vo.base.errors import OutputError
from vo.base.files.complete_file import writing
from vo.base.geometry.rectification import rectified_projections
from vo.base.geometry.transforms import inverse
from vo.base.types import Frame, Rig
from vo.outputs.recorders.durable_file import DurableFile
from vo.recordings.formats.foxglove import as_protobuf
from vo.recordings.formats.messages import (
    CalibrationMessage,
    FrameTransform,
    ImageMessage,
    Message,
    TransformsMessage,
)

_QUEUE_BYTES = 64 * 2**20
_MIN_FRAMES = 4
_FLUSH_S = 0.5
_TIMEOUT_S = 20.0  # without progress, until the end no longer waits for the disk

_log = logging.getLogger(__name__)


class FrameLog:
    """Writes frames in a thread; never lets the caller wait.

    At most 64 MiB of images wait for the disk. While that is full, frames are left out and counted.
    A chunk of the file ends after half a second at the latest: if the process is killed, what is in
    the file by then can be read. On a full disk the file ends with a complete chunk.

    `unrecorded`: frames so far that were left out. `path`: the file, which must not exist.

    Raises:
        OutputError: the file exists, its name does not end in `.mcap`, or it cannot be written.
        CalibrationError: the pair cannot be rectified.
    """

    def __init__(self, path: Path, rig: Rig) -> None:
        self.unrecorded = 0
        self._path, self._rig = path, rig
        self._projections = rectified_projections(rig)
        pixels = sum(camera.width * camera.height for camera in rig.cameras)
        size = max(_QUEUE_BYTES // pixels, _MIN_FRAMES)
        self._queue: queue.Queue[Frame | None] = queue.Queue(size)
        self._channels: dict[str, int] = {}
        self._written = 0  # frames
        self._file = _new_file(path)
        # A daemon thread: a disk that hangs must not prevent the program from ending.
        self._thread = threading.Thread(target=self._work, name="frame-log", daemon=True)
        self._thread.start()

    def add(self, frame: Frame) -> None:
        """Take a frame to be written, or leave it out."""
        try:
            if self._thread.is_alive():
                self._queue.put_nowait(frame)
                return
        except queue.Full:
            if not self.unrecorded:
                _log.warning("%s: frames are left out, because the disk is too slow", self._path)
        self.unrecorded += 1

    def close(self) -> None:
        """Write what waits, and close the file; one without frames is removed."""
        give_up, written = time.monotonic() + _TIMEOUT_S, self._written
        is_ended = False
        while self._thread.is_alive() and time.monotonic() < give_up:
            if not is_ended:
                is_ended = self._try_to_end()
            self._thread.join(0.05)
            if self._written != written:
                give_up, written = time.monotonic() + _TIMEOUT_S, self._written
        if self._thread.is_alive():
            _log.warning("%s: the disk hangs; the recording is incomplete", self._path)
        elif not self._written:
            self._path.unlink(missing_ok=True)

    def _try_to_end(self) -> bool:
        try:
            self._queue.put_nowait(None)
        except queue.Full:
            return False
        return True

    def _work(self) -> None:
        try:
            self._write_all()
        except OSError as error:
            self._file.cut()
            _log.warning("%s: recording ended: %s", self._path, error.strerror or error)

    def _write_all(self) -> None:
        self._writer = Writer(self._file, compression=CompressionType.LZ4)  # type: ignore[arg-type]
        self._writer.start(library="vo")
        self._end_chunk()
        while (frame := self._next()) is not None:
            if not self._written:
                self._write_transform(frame.stamp_ns)
            for topic, message in self._messages(frame):
                self._write(topic, message, frame.stamp_ns)
            self._written += 1
            if time.monotonic() - self._flushed_at >= _FLUSH_S:
                self._end_chunk()
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def _next(self) -> Frame | None:
        """The next frame; while there is none, everything is on disk."""
        try:
            return self._queue.get(timeout=_FLUSH_S)
        except queue.Empty:
            self._end_chunk()
            return self._queue.get()

    def _end_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._flushed_at = time.monotonic()

    def _messages(self, frame: Frame) -> Iterator[tuple[str, Message]]:
        for number, camera in enumerate(self._rig.cameras):
            image, name = frame.images[number], f"cam{number}"
            if image is None:
                continue
            rotation, projection = self._projections[number]
            yield (
                f"/{name}/camera_info",
                CalibrationMessage(frame.stamp_ns, name, camera, rotation, projection),
            )
            size, data = (camera.width, camera.height), image.tobytes()
            yield f"/{name}/image_raw", ImageMessage(frame.stamp_ns, name, *size, "mono8", data)

    def _write_transform(self, stamp_ns: int) -> None:
        if self._rig.cam1_from_cam0 is not None:
            cam0_from_cam1 = inverse(self._rig.cam1_from_cam0)
            transform = FrameTransform("cam0", "cam1", cam0_from_cam1)
            self._write("/tf_static", TransformsMessage(stamp_ns, (transform,)), stamp_ns)

    def _write(self, topic: str, message: Message, stamp_ns: int) -> None:
        encoded: PbMessage = as_protobuf(message)
        if topic not in self._channels:
            schema = register_schema(self._writer, type(encoded))
            self._channels[topic] = self._writer.register_channel(
                topic, MessageEncoding.Protobuf, schema
            )
        data = encoded.SerializeToString()
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns)


def _new_file(path: Path) -> DurableFile:
    if path.suffix != ".mcap":
        raise OutputError(f"`record` writes MCAP files: {path} needs a name that ends in .mcap")
    if path.exists():
        raise OutputError(f"{path} exists; give `record` another name, or remove it")
    with writing(f"recording {path}", "choose another `record`"):
        path.parent.mkdir(parents=True, exist_ok=True)
        return DurableFile(path)
