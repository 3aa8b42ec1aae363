"""Lost cameras that are found again in what was stored before."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from room_course import FILES, ate, run_rounds
from rrd import STATIC, read_rrd
from typer.testing import CliRunner

from vo.base.geometry.transforms import inverse
from vo.base.types import Estimate, Frame
from vo.cli.app import app
from vo.engine.odometry import Odometry
from vo.outputs.recorders import entities
from vo.outputs.recorders.exports import Exports
from vo.outputs.report.entry import Entry
from vo.outputs.report.plots.paths import draw_above
from vo.outputs.report.run_folder import read_run
from vo.outputs.report.shown_paths import shown_paths
from vo.recordings.formats.trajectory import read_tum

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

    monkeypatch.setattr("vo.engine.rig.creation.Odometry", Changed)


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


@pytest.fixture(scope="module")
def joined(rounds: Path) -> Path:
    """Results of a camera that was covered, with loops; recording and exports are beside."""
    output = rounds.parent / "joined"
    exports = Exports(colmap=rounds.parent / "joined-model", ply=rounds.parent / "joined.ply")
    outputs = {"exports": exports, "rrd": rounds.parent / "joined.rrd", "rrd_images": "none"}
    with pytest.MonkeyPatch.context() as patch:
        _changes_frames(patch, _black)
        run_rounds(rounds, output, "memory.loops=true", **outputs)
    return output


def _without_pose(summary: dict[str, object]) -> set[int]:
    ranges = summary["without_pose"]
    assert isinstance(ranges, list)
    return {frame for r in ranges for frame in range(r["first"], r["last"] + 1)}


def test_a_camera_that_was_covered_is_found_again(
    rounds: Path, joined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_rounds(rounds, tmp_path / "plain", "memory.loops=false")
    _changes_frames(monkeypatch, _black)
    apart = run_rounds(rounds, tmp_path / "apart", "memory.loops=false", end=BLACK[-1] + 30)
    assert [s["segment"] for s in apart["segments"]] == [0, 1]
    summary = json.loads((joined / "summary.json").read_text(encoding="utf-8"))
    assert [s["segment"] for s in summary["segments"]] == [0]
    assert "merge" in [loop["kind"] for loop in summary["loops"]]
    assert summary["verdict"] == "not to be trusted"  # joined only by what places look like
    assert set(BLACK) <= _without_pose(summary)
    assert ate(joined, rounds) < 1.5 * ate(tmp_path / "plain", rounds)


def test_merged_segments_are_one_colmap_model(rounds: Path, joined: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    folder = rounds.parent / "joined-model" / "sparse"
    assert [each.name for each in folder.iterdir()] == ["0"]
    model = pycolmap.Reconstruction(str(folder / "0"))
    path = read_tum(joined / "trajectory.tum")
    resumed_ns = read_tum(rounds / "groundtruth.tum").stamps_ns[BLACK[-1] + 1]
    images_after, counts, errors_px = 0, [], []
    for image in model.images.values():
        stamp_ns = int(image.name.removesuffix(".png"))
        (row,) = np.flatnonzero(path.stamps_ns == stamp_ns)
        np.testing.assert_allclose(image.projection_center(), path.positions[row], atol=1e-6)
        images_after += stamp_ns >= resumed_ns
        camera, cam_from_world = model.cameras[image.camera_id], image.cam_from_world()
        seen = [each for each in image.points2D if each.has_point3D()]
        counts.append(len(seen))
        for each in seen:
            in_cam = cam_from_world * model.points3D[each.point3D_id].xyz
            errors_px.append(np.linalg.norm(camera.img_from_cam(in_cam) - each.xy))
    assert images_after >= 20 and len(counts) - images_after >= 10
    # The second map has another unit: without its scale, some images have no point at all.
    assert min(counts) > 100
    assert np.mean(errors_px) < 0.3
    header = (rounds.parent / "joined.ply").read_bytes().split(b"end_header")[0]
    assert int(header.split(b"element vertex ")[1].split()[0]) >= model.num_points3D()


def test_the_recording_and_the_report_have_one_world_and_a_gap(
    rounds: Path, joined: Path, tmp_path: Path
) -> None:
    path = read_tum(joined / "trajectory.tum")
    resumed_ns = read_tum(rounds / "groundtruth.tum").stamps_ns[BLACK[-1] + 1]
    first = int(np.searchsorted(path.stamps_ns, resumed_ns))
    logged = read_rrd(rounds.parent / "joined.rrd", "strips")[entities.SMOOTHED_PATH]
    (strips,) = [values for frame, values in logged if frame == STATIC and values]
    assert [len(strip) for strip in strips] == [first, len(path) - first]
    np.testing.assert_allclose(np.concatenate(strips), path.positions, atol=1e-5)
    errors = read_rrd(rounds.parent / "joined.rrd", "scalars")[f"{entities.ERROR_PLOT}/smoothed"]
    rms = np.sqrt(np.mean(np.square([value for _, value in errors])))
    np.testing.assert_allclose(rms, ate(joined, rounds), rtol=1e-6)

    run = read_run(joined)
    assert set(run.segment_of(path.stamps_ns).tolist()) == {0}
    (shown,) = shown_paths([Entry("joined", 0, run)])
    figure = draw_above(shown)
    drawn = np.asarray(figure.axes[0].lines[0].get_xydata())
    assert len(drawn) == len(path) + 1
    assert np.flatnonzero(np.isnan(drawn[:, 0])).tolist() == [first]


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


def test_after_a_cut_to_a_place_of_the_local_map_it_goes_on_at_once(
    rounds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _changes_frames(monkeypatch, _cut)
    summary = run_rounds(rounds, tmp_path / "out")
    # Depending on the frame of the cut, the first one after it is lost, or none.
    assert summary["lost"] <= 1 and summary["relocalisations"] == []
    assert len(summary["segments"]) == 1
    assert ate(tmp_path / "out", rounds) < 0.02


def test_after_a_cut_the_old_world_goes_on_from_the_frame_that_is_named(
    rounds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _changes_frames(monkeypatch, _cut)
    small = ("smoothing.window=6", "smoothing.fixed=4")  # the place has left the local map
    summary = run_rounds(rounds, tmp_path / "out", "memory.loops=true", *small)
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

    again = run_rounds(rounds, tmp_path / "again", "memory.loops=true", "threads=1", *small)
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
    run_rounds(rounds, tmp_path / "without", "memory.loops=false", **options)
    assert with_loops["relocalisations"] == [] and with_loops["loops"] == []
    for name in FILES:
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()
