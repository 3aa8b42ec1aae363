"""The same images give the same trajectory, byte for byte, in each container."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from mcap_logs import DIALECTS, write_log

from vo.base.config import load_config
from vo.recordings.formats.calibration.own import write_calibration
from vo.recordings.formats.messages import CompressedImageMessage, ImageMessage, Message
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FRAMES = 6


@pytest.fixture(scope="module")
def expected(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    output = tmp_path_factory.mktemp("expected")
    run(synthetic_stereo, output, config=load_config("fast"), end=FRAMES)
    return (output / "trajectory.tum").read_bytes()


def messages(recording: Path, codec: str) -> Iterator[tuple[str, Message]]:
    for frame in open_source(recording).frames(end=FRAMES):
        for number, image in enumerate((frame.image0, frame.image1)):
            assert image is not None
            topic, name = f"/cam{number}/image_raw", f"cam{number}"
            height, width = image.shape
            if codec == "raw":
                data = image.tobytes()
                yield topic, ImageMessage(frame.stamp_ns, name, width, height, "mono8", data)
            else:
                data = cv2.imencode(".png", image)[1].tobytes()
                yield topic, CompressedImageMessage(frame.stamp_ns, name, "png", data)


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("codec", ["raw", "png"])
def test_mcap(
    synthetic_stereo: Path, expected: bytes, tmp_path: Path, dialect: str, codec: str
) -> None:
    log = write_log(tmp_path / "log.mcap", messages(synthetic_stereo, codec), DIALECTS[dialect])
    write_calibration(tmp_path / "rig.yaml", open_source(synthetic_stereo).rig)
    summary = run(
        log, tmp_path / "out", config=load_config("fast"), calibration=tmp_path / "rig.yaml"
    )
    assert (summary.tracked, summary.facts.format) == (FRAMES, "mcap")
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == expected
