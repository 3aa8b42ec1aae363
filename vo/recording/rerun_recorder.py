"""Records a run as an `.rrd` file for the rerun viewer."""

from __future__ import annotations

import logging
from pathlib import Path

import rerun as rr

from vo.errors import OutputError
from vo.recording import entities
from vo.recording.blueprint import make_blueprint
from vo.recording.image_layer import ImageChoice, ImageLayer
from vo.recording.map_layer import MapLayer
from vo.recording.plot_layer import PlotLayer
from vo.recording.trajectories import RunIndex, log_trajectory
from vo.types import Estimate, Rig, Trajectory

_APPLICATION = "vo"
_FRAMES_PER_FLUSH = 30
_FLUSH_TIMEOUT_S = 5.0
# rerun's default of five chunks a second costs more in headers than in data.
_BATCHES = rr.ChunkBatcherConfig(flush_tick=1.0)

_logger = logging.getLogger(__name__)


class RerunRecorder:
    """Writes a run to an `.rrd` file as it goes on.

    The file opens up to the last second also when the run is killed. A disk that fills up ends
    the recording with a warning, never the run.

    Args:
        path: the file to write; one that exists is replaced.
        images: size at which images are recorded.
    """

    def __init__(self, path: Path, *, images: ImageChoice = "half") -> None:
        self._path = path
        self._images: ImageChoice = images
        self._stream: rr.RecordingStream | None = None

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Open the file.

        Raises:
            OutputError: the file cannot be written.
        """
        stream = self._open()
        stream.send_recording_name(name)
        self._image = ImageLayer(stream, self._images)
        self._map = MapLayer(stream, ground_truth, is_metric=rig.is_metric)
        self._plots = PlotLayer(stream)
        self._index = RunIndex()
        for layer in (self._image, self._map, self._plots):
            layer.log_styles()
        self._stream = stream

    def record(self, estimate: Estimate) -> None:
        """Log one frame; nothing once the recording has failed."""
        if self._stream is None:
            return
        try:
            self._log(self._stream, estimate)
        except (RuntimeError, OSError) as error:
            self._give_up(error)

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Log both whole paths and close the file."""
        if self._stream is None:
            return
        try:
            self._map.log_whole(smoothed, self._index)
            log_trajectory(self._stream, entities.CAUSAL_POSES, causal, self._index)
            log_trajectory(self._stream, entities.SMOOTHED_POSES, smoothed, self._index)
            self._stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
            self._stream.disconnect()
        except (RuntimeError, OSError) as error:
            self._give_up(error)
        self._stream = None

    def _open(self) -> rr.RecordingStream:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.open("wb").close()  # says what is wrong more clearly than rerun does
            stream = rr.RecordingStream(_APPLICATION, batcher_config=_BATCHES)
            stream.save(self._path, default_blueprint=make_blueprint())
        except (RuntimeError, OSError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(
                f"cannot write the recording {self._path}: {reason}; choose another file"
            ) from error
        stream.set_log_tick_enabled(False)
        stream.set_log_time_enabled(False)
        return stream

    def _log(self, stream: rr.RecordingStream, estimate: Estimate) -> None:
        self._index.add(estimate)
        self._index.set_time(stream, estimate)
        self._image.log(estimate.view)
        self._map.log(estimate)
        self._plots.log(estimate)
        if len(self._index) % _FRAMES_PER_FLUSH == 0:
            stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)  # raises if the file's writer has died

    def _give_up(self, error: Exception) -> None:
        _logger.warning("recording %s stopped: %s", self._path, error)
        # Not `disconnect`, which can wait for a dead writer for ever.
        self._stream = None
