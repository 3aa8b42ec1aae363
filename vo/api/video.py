"""A run as a video."""

from __future__ import annotations

import tempfile
from pathlib import Path

from vo.base.config import load_config
from vo.base.errors import SourceError
from vo.outputs.report.run_folder import RunRecord, read_run
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.runs.progress import NullProgress, Progress
from vo.runs.run_recording import run as track
from vo.tools.rendering.film import Filmed, FilmOptions, FilmRecorder


def video(
    run: str | Path,
    source: str | Path | None = None,
    output: str | Path = "run.mp4",
    *,
    width: int = 1280,
    speed: float = 1.0,
    start: int | None = None,
    end: int | None = None,
    progress: Progress | None = None,
) -> Filmed:
    """Write a video of a run: features and matches, and beside them the path, as `vo video`.

    The frames are tracked again with the settings of the run, which
    gives the same features; the path is that of the run.

    Args:
        run: folder of the run.
        source: its recording, None for where it was.
        output: `.mp4`, `.mkv`, `.mov` or `.avi`.
        width: in pixels.
        speed: 2 for twice that of the recording.
        start: first frame to show.
        end: frame to stop before.
        progress: told of each frame.

    Raises:
        SourceError: the run or its recording cannot be read.
        ConfigError: the width or the speed is out of range.
        OutputError: the video cannot be written.
    """
    chosen = FilmOptions(width, speed, start, end)
    record = read_run(Path(run))
    recording = str(record.summary["source"] if source is None else source)
    target = Path(output)
    refuse_to_overwrite([Path(recording)], [target])
    recorder = FilmRecorder(record, target, chosen)
    try:
        _track_again(record, recording, recorder, progress or NullProgress())
    finally:
        recorder.close()
    done = recorder.result()
    if not done.images:
        raise SourceError(f"{recording}: no frame of the run could be read; name its recording")
    return done


def _track_again(
    record: RunRecord, recording: str, recorder: FilmRecorder, progress: Progress
) -> None:
    """Track the recording of a run with its settings, and draw it."""
    summary = record.summary
    calibration = summary.get("calibration")
    with tempfile.TemporaryDirectory(prefix="vo-video-") as folder:
        track(
            recording,
            Path(folder),
            config=load_config(record.path / "config.yaml"),
            mode="mono" if summary["mode"] == "mono" else "auto",
            start=int(summary["start"]),
            end=recorder.end,
            stride=int(summary["stride"]),
            calibration=None if calibration is None else Path(calibration),
            format=str(summary["format"]),
            topics=tuple(summary.get("topics", ())),
            right_offset_ns=summary.get("right_offset_ns"),
            recorder=recorder,
            progress=progress,
        )
