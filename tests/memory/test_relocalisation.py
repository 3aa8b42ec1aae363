"""Lost cameras that are found again in what was stored before."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from room_course import FILES, ate, run_rounds
from typer.testing import CliRunner

from vo.cli.app import app
from vo.formats.trajectory import read_tum
from vo.geometry.transforms import inverse
from vo.odometry import Odometry
from vo.types import Estimate, Frame

BLACK = range(70, 84)
FOREIGN = range(70, 125)
CUT = range(60, 128)


def _changes_frames(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[Frame], Frame | None]
) -> None:
    """Have the odometry of a run receive other frames, or fewer."""

    class Changed(Odometry):
        def track_all(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
            changed = map(change, frames)
            yield from super().track_all(frame for frame in changed if frame is not None)

    monkeypatch.setattr("vo.run_recording.Odometry", Changed)


def _black(frame: Frame) -> Frame:
    if frame.index not in BLACK:
        return frame
    return replace(frame, images=(np.zeros_like(frame.image0), None))


def _foreign(frame: Frame) -> Frame:
    """A mirror image: a place of another world, consistent in itself."""
    if frame.index not in FOREIGN:
        return frame
    return replace(frame, images=(frame.image0[:, ::-1].copy(), None))


def _cut(frame: Frame) -> Frame | None:
    return None if frame.index in CUT else frame


def _without_pose(summary: dict[str, object]) -> set[int]:
    ranges = summary["without_pose"]
    assert isinstance(ranges, list)
    return {frame for r in ranges for frame in range(r["first"], r["last"] + 1)}


def test_a_camera_that_was_covered_is_found_again(
    rounds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_rounds(rounds, tmp_path / "plain")
    _changes_frames(monkeypatch, _black)
    apart = run_rounds(rounds, tmp_path / "apart", end=BLACK[-1] + 30)
    assert [s["segment"] for s in apart["segments"]] == [0, 1]
    joined = run_rounds(rounds, tmp_path / "joined", "memory.loops=true")
    assert [s["segment"] for s in joined["segments"]] == [0]
    assert "merge" in [loop["kind"] for loop in joined["loops"]]
    assert joined["verdict"] == "not to be trusted"  # joined only by what places look like
    assert set(BLACK) <= _without_pose(joined)
    assert ate(tmp_path / "joined", rounds) < 1.5 * ate(tmp_path / "plain", rounds)


def test_a_camera_in_a_foreign_place_is_not_found_and_back_again_it_is(
    rounds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _changes_frames(monkeypatch, _foreign)
    summary = run_rounds(rounds, tmp_path / "out", "memory.loops=true")
    assert [s["segment"] for s in summary["segments"]] == [0, 1]
    for loop in summary["loops"]:
        assert loop["frame"] not in FOREIGN and loop["earlier_frame"] not in FOREIGN
    (found,) = summary["relocalisations"]
    assert found["segment"] == 2
    assert FOREIGN[-1] < found["earlier_frame"] + 126 and FOREIGN[-1] < found["keyframe"]
    assert found["loops"] >= 3 and found["inliers"] >= 25


def test_after_a_cut_the_old_world_goes_on_from_the_frame_that_is_named(
    rounds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _changes_frames(monkeypatch, _cut)
    summary = run_rounds(rounds, tmp_path / "out", "memory.loops=true")
    (found,) = summary["relocalisations"]
    assert found["segment"] == 1 and summary["segments"][0]["last_frame"] == 189
    # Three keyframes are evidence enough; two results are used three and five frames later.
    assert CUT[-1] < found["keyframe"] < found["frame"] <= CUT[-1] + 40
    assert found["correction_m"] > 0.0 and 0.0 < found["correction_deg"] < 180.0

    causal, truth = read_tum(tmp_path / "out" / "causal.tum"), read_tum(rounds / "groundtruth.tum")
    frame = np.searchsorted(truth.stamps_ns, causal.stamps_ns)
    assert not np.isin(frame, CUT).any()
    # Relative to a frame before the cut, poses have the true direction from the named frame on.
    first = int(np.flatnonzero(frame == 40)[0])
    moved = inverse(causal.world_from_cam[first]) @ causal.world_from_cam
    true = inverse(truth.world_from_cam[40]) @ truth.world_from_cam[frame]
    trace = np.trace(np.swapaxes(moved, 1, 2)[:, :3, :3] @ true[:, :3, :3], axis1=1, axis2=2)
    angle_deg = np.degrees(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
    late = frame >= found["frame"]
    assert angle_deg[late].max() < 2.0
    assert angle_deg[(frame > CUT[-1]) & ~late].min() > 10.0

    page = tmp_path / "report.html"
    done = CliRunner().invoke(app, ["report", str(tmp_path / "out"), "-o", str(page)])
    assert done.exit_code == 0, done.output
    row = f'<th scope="row">{found["frame"]}</th><td>1</td><td>{found["earlier_frame"]}</td>'
    assert row in page.read_text(encoding="utf-8")

    again = run_rounds(rounds, tmp_path / "again", "memory.loops=true", "threads=1")
    for name in FILES:
        first_bytes = (tmp_path / "out" / name).read_bytes()
        assert (tmp_path / "again" / name).read_bytes() == first_bytes
    assert again["relocalisations"] == summary["relocalisations"]


def test_without_a_place_seen_before_nothing_is_found(
    rounds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _changes_frames(monkeypatch, _black)
    options = {"end": BLACK[-1] + 35}
    with_loops = run_rounds(rounds, tmp_path / "with", "memory.loops=true", **options)
    run_rounds(rounds, tmp_path / "without", **options)
    assert with_loops["relocalisations"] == [] and with_loops["loops"] == []
    for name in FILES:
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()
