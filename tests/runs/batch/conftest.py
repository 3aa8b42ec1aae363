"""Very short recordings for batches."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

FRAMES = 8


def shorten(recording: Path, target: Path, first: int) -> None:
    """Copy some frames of a recording in EuRoC's layout."""
    for camera in sorted((recording / "mav0").glob("cam*")):
        copy = target / "mav0" / camera.name
        (copy / "data").mkdir(parents=True)
        shutil.copy(camera / "sensor.yaml", copy)
        head, *rows = (camera / "data.csv").read_text().splitlines()
        rows = rows[first : first + FRAMES]
        (copy / "data.csv").write_text("\n".join([head, *rows]) + "\n")
        for row in rows:
            shutil.copy(camera / "data" / row.partition(",")[2].strip(), copy / "data")
    for truth in recording.glob("groundtruth*"):
        shutil.copy(truth, target)


@pytest.fixture(scope="session")
def walks(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of three recordings of eight stereo frames; not to be written to."""
    folder = tmp_path_factory.mktemp("walks")
    for number in range(3):
        shorten(synthetic_stereo, folder / f"walk{number}", 7 * number)
    return folder
