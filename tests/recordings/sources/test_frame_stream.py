"""Runs on a stream of frames without known length or times."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from vo.base.config import load_config
from vo.base.errors import ConfigError, SourceError
from vo.base.faults import Fault
from vo.base.types import Estimate, Frame, Rig, Skipped, Trajectory
from vo.engine.mapping.keyframe_store import MemoryKeyframeStore
from vo.engine.stages import Components
from vo.recordings.sources.images import ImageKind
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import FrameStream, Recording
from vo.runs.run_recording import run

FAST = load_config("fast")
FRAMES = 8
RESULTS = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")


class Camera:
    """A camera: frames until it is unplugged, without known number or times."""

    def __init__(self, rig: Rig, frames: Iterator[Frame]) -> None:
        self.name, self.format, self.rig = "camera", "live", rig
        self.ground_truth: Trajectory | None = None
        self.skipped: list[Skipped] = []
        self.unpaired = 0
        self.faults: list[Fault] = []
        self._frames = frames

    def frames(
        self, start: int = 0, end: int | None = None, stride: int = 1, images: ImageKind = "grey"
    ) -> Iterator[Frame]:
        return islice(self._frames, start, end, stride)


class Watcher:
    """Records the progress of a run."""

    def __init__(self) -> None:
        self.total: int | None = None
        self.done: list[int] = []

    def begin(self, name: str, total: int) -> None:
        self.total = total

    def step(self, done: int, estimate: Estimate) -> None:
        self.done.append(done)

    def finish(self) -> None: ...


def camera(folder: Path, count: int = FRAMES) -> Camera:
    recording = open_source(folder)
    return Camera(recording.rig, islice(recording.frames(), count))


def test_recordings_are_streams_and_streams_are_no_recordings(synthetic_stereo: Path) -> None:
    assert isinstance(open_source(synthetic_stereo), FrameStream | Recording)
    assert isinstance(camera(synthetic_stereo), FrameStream)
    assert not isinstance(camera(synthetic_stereo), Recording)


def test_a_stream_gives_the_same_results_as_the_recording(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    run(synthetic_stereo, tmp_path / "recording", config=FAST, end=FRAMES)
    watcher = Watcher()
    summary = run(camera(synthetic_stereo), tmp_path / "stream", config=FAST, progress=watcher)
    for name in RESULTS:
        expected = (tmp_path / "recording" / name).read_bytes()
        assert (tmp_path / "stream" / name).read_bytes() == expected
    assert summary.frames == summary.tracked == FRAMES
    assert (watcher.total, watcher.done) == (0, list(range(1, FRAMES + 1)))
    written = json.loads((tmp_path / "stream" / "summary.json").read_text(encoding="utf-8"))
    assert (written["source"], written["format"]) == ("camera", "live")


def test_a_stream_can_end_at_a_given_frame(synthetic_stereo: Path, tmp_path: Path) -> None:
    assert run(camera(synthetic_stereo), tmp_path, config=FAST, end=3).tracked == 3


def test_a_stream_that_ends_before_its_first_frame_is_an_error(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    with pytest.raises(SourceError, match="camera: it ended before the first frame"):
        run(camera(synthetic_stereo, 0), tmp_path, config=FAST)


def test_a_stream_that_fails_keeps_the_results_so_far(
    synthetic_stereo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stream = camera(synthetic_stereo)

    def unplugged() -> Iterator[Frame]:
        yield from islice(stream.frames(), 4)
        raise SourceError("the camera does not respond")

    with pytest.raises(SourceError, match="does not respond"):
        run(Camera(stream.rig, unplugged()), tmp_path, config=FAST)
    written = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (written["status"], written["trusted"]) == ("failed", False)
    assert written["error"].endswith("the camera does not respond")
    assert caplog.messages[-1] == f"the run failed after 4 frames; what they gave is in {tmp_path}"
    assert written["tracked"] == 4
    assert len((tmp_path / "causal.tum").read_text(encoding="utf-8").splitlines()) == 4


def test_frames_of_a_stream_cannot_be_left_out_and_interpolated(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="tracking.every is 2; a stream needs 1"):
        run(camera(synthetic_stereo), tmp_path, config=load_config("fast", ["tracking.every=2"]))


def test_a_run_uses_the_components_that_it_is_given(synthetic_stereo: Path, tmp_path: Path) -> None:
    store = MemoryKeyframeStore()
    components = Components(keyframe_store=store)
    config = load_config("fast", ["keyframes.min_parallax_deg=0.2"])
    summary = run(synthetic_stereo, tmp_path, config=config, end=FRAMES, components=components)
    assert summary.keyframes > 1
    assert [k.id for k in store.keyframes] == list(range(summary.keyframes))
