"""Writer of plain folders of images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from data_synth.records import Recording, Shot
from data_synth.writers.encoding import SUFFIXES, write_images
from data_synth.writers.tables import (
    seconds_text,
    write_lines,
    write_movers,
    written_stamps,
    written_truth,
)
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.formats.trajectory import write_tum

_NAMES = {1: ("",), 2: ("left", "right")}


def write(path: Path, recording: Recording, shots: Iterator[Shot], codec: str) -> None:
    """Write `left/` and `right/`, of more cameras `cam0/`, `cam1/`, …, of one the images alone.

    Files are named by the number of the frame, so that both images of a pair have the same name;
    `times.txt` has a line for each left image. Also `calibration.yaml`, `groundtruth.tum` and, if
    present, `depth/` (float32 TIFF) and `movers.csv`.

    Raises:
        OSError: a file cannot be written.
        OutputError: the same, of the truth or the calibration.
    """
    count = len(recording.rig.cameras)
    names = _NAMES.get(count) or tuple(f"cam{number}" for number in range(count))
    folders = [path / name for name in names]
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
    if recording.has_depth:
        (path / "depth").mkdir()
    write_lines(path / "times.txt", map(seconds_text, written_stamps(recording, 0)))
    write_calibration(path / "calibration.yaml", recording.rig)
    write_tum(path / "groundtruth.tum", written_truth(recording))
    write_movers(path / "movers.csv", recording)
    suffix = SUFFIXES[codec]
    write_images(
        shots,
        codec,
        lambda camera, index: folders[camera] / f"{index:06d}{suffix}",
        lambda index: path / "depth" / f"{index:06d}.tiff",
    )
