from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vo.base.failures import Failure, FailureReason, Gap, ImageDefect
from vo.base.faults import Fault, FaultKind
from vo.base.records.calibration_errors import CalibrationErrors, LensError
from vo.base.records.closed_loops import ClosedLoop, MapUse
from vo.base.records.inertial_use import InertialStates, InertialUse
from vo.base.records.metric_scale import MetricScale, ScaleFindings
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Estimate, KeyframePose, Skipped, State, Trajectory
from vo.outputs.results.live_summary import Delay, LiveState
from vo.outputs.results.run_statistics import RunStatistics
from vo.outputs.results.summary import RunFacts, Summary, summarise
from vo.outputs.results.tables import COVARIANCE_HEADING, covariance_line

DOCS = Path(__file__).resolve().parents[3] / "docs" / "outputs.md"


def few_matches(count: int) -> Failure:
    return Failure(FailureReason.FEW_MATCHES, count, 80)


def dark(camera: int = 0) -> Failure:
    return Failure(FailureReason.IMAGE_DEFECT, defect=ImageDefect.BLACK, camera=camera)


def estimate(
    frame: int,
    state: State = State.TRACKING,
    failure: Failure | None = None,
    ids: Sequence[int] | None = None,
    faults: Sequence[Fault] = (),
) -> Estimate:
    return Estimate(
        frame_index=frame,
        stamp_ns=frame * 10**8,
        state=state,
        failure=failure,
        segment=0,
        world_from_cam0=np.eye(4) if state is State.TRACKING else None,
        is_keyframe=False,
        features=1500,
        matches=100,
        inliers=90,
        keyframes=(),
        landmark_ids=None if ids is None else np.array(ids, np.int64),
        faults=tuple(faults),
    )


def facts(mode: str = "stereo") -> RunFacts:
    assert mode in ("mono", "stereo")
    return RunFacts("data", "kitti", mode, True, 0, 0, 100, 1, 100)  # type: ignore[arg-type]


def path_of(frames: Sequence[int], segments: Sequence[int] | None = None) -> PosedFrames:
    """A camera that moves 2 a frame along x."""
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, 0, 3] = 2.0 * np.array(frames)
    segment = np.zeros(len(frames), np.int64) if segments is None else np.array(segments)
    stamps_ns = np.array(frames, np.int64) * 10**8
    no = np.zeros(len(frames), dtype=bool)
    trajectory = Trajectory(stamps_ns, poses)
    return PosedFrames(np.array(frames, np.int64), segment, segment, no, no, trajectory)


def summary_of(
    estimates: Sequence[Estimate],
    poses: PosedFrames,
    skipped: Sequence[Skipped] = (),
    mode: str = "stereo",
    offset_px: float = 0.0,
    curve_px: float = 0.0,
    lens: LensError | None = None,
) -> Summary:
    statistics = RunStatistics()
    for each in estimates:
        statistics.add(each)
        statistics.add_times({"read": 1.0 + each.frame_index})
    return summarise(
        facts(mode),
        "finished",
        statistics,
        poses,
        CalibrationErrors(offset_px, curve_px, None, lens),
        keyframes=2,
        skipped=skipped,
        wall_s=2.0,
    )


def test_every_frame_has_a_pose_or_is_listed_once() -> None:
    states = [State.STARTING] * 3 + [State.TRACKING] * 3 + [State.LOST] * 2 + [State.TRACKING] * 2
    frames = [f for f in range(11) if f != 4]
    estimates = [estimate(f, s, few_matches(f)) for f, s in zip(frames, states, strict=True)]
    # Frame 2, the first of the monocular initial pair, gets its pose later.
    poses = path_of([2, 3, 5, 6, 9, 10])
    summary = summary_of(estimates, poses, [Skipped(4, 4 * 10**8, "cut off")])
    assert summary.frames == 11
    assert (summary.tracked, summary.starting, summary.lost) == (6, 2, 2)
    ranges = [(r.first, r.last, r.frames, r.state, r.reason) for r in summary.without_pose]
    assert ranges == [
        (0, 1, 2, "starting", "1 matches with the reference frame, 80 needed"),
        (4, 4, 1, "skipped", "cut off"),
        (7, 8, 2, "lost", "8 matches with the reference frame, 80 needed"),
    ]


def test_frames_with_a_stride_make_one_range() -> None:
    estimates = [estimate(f, State.LOST, dark()) for f in (10, 15, 20)]
    (only,) = summary_of(estimates, path_of([])).without_pose
    assert (only.first, only.last, only.frames) == (10, 20, 3)


def test_a_discarded_pose_is_listed_as_lost() -> None:
    summary = summary_of([estimate(0), estimate(1)], path_of([0]))
    assert (summary.frames, summary.lost) == (2, 1)
    assert summary.without_pose[0].reason == "its pose was discarded later"


def test_the_path_length_excludes_gaps_between_segments() -> None:
    frames, segments = [0, 1, 2, 50, 51], [0, 0, 0, 1, 1]
    summary = summary_of([estimate(f) for f in frames], path_of(frames, segments))
    assert [(s.frames, s.path_m) for s in summary.segments] == [(3, 4.0), (2, 2.0)]
    assert (summary.segments[1].first_frame, summary.segments[1].last_frame) == (50, 51)
    assert summary.segments[1].first_stamp_ns == 50 * 10**8
    assert summary.path_m == 6.0
    assert "2 segments, each in its own world frame" in summary.warnings


def test_a_path_that_loops_have_repaired_is_not_trusted() -> None:
    loop = ClosedLoop("loop", 90, 10, 0, 0, 80, None, 0.1, 0.2)
    summary = summary_of([estimate(0), estimate(1)], path_of([0, 1]))
    closed = replace(summary, loops=(loop,))
    assert closed.verdict.word == "complete" and not closed.warnings
    repaired = replace(summary, loops=(loop, replace(loop, kind="repair")))
    assert repaired.verdict.word == "not to be trusted"
    assert len(repaired.warnings) == 1 and "little of the map agreed" in repaired.warnings[0]


@pytest.mark.parametrize(("keyframes", "is_trusted"), [(9, False), (10, True)])
def test_parts_that_a_long_stretch_joins_are_trusted(keyframes: int, is_trusted: bool) -> None:
    merge = ClosedLoop("merge", 90, 10, 1, 0, 80, None, None, None)
    others = [
        replace(merge, kind="merge" if n < 3 else "loop", frame=90 + n, earlier_frame=10 + n)
        for n in range(1, keyframes)
    ]
    elsewhere = [replace(merge, kind="loop", segment=0)] * 20  # do not speak for the merge
    summary = summary_of([estimate(0), estimate(1)], path_of([0, 1]))
    joined = replace(summary, loops=(merge, *others, *elsewhere))
    assert joined.verdict.is_trusted is is_trusted
    assert joined.verdict.word == ("complete, with warnings" if is_trusted else "not to be trusted")
    assert "joined only by what places look like" in joined.warnings[0]


def test_incomplete_runs_have_warnings() -> None:
    lost = summary_of(
        [estimate(0), estimate(1, State.LOST, dark())], path_of([0]), [Skipped(2, 0, "cut off")]
    )
    assert "lost in 1 of 3 frames (33%)" in lost.warnings
    assert any("1 frame skipped" in w for w in lost.warnings)
    mono = summary_of([estimate(0)], path_of([0]), mode="mono")
    assert mono.length_unit == "map units"
    assert any("the scale is unknown" in w for w in mono.warnings)
    long = summary_of([estimate(0, State.STARTING), estimate(1)], path_of([1]))
    assert long.warnings == ("1 of 2 frames before the first map",)
    none = summary_of([estimate(0, State.STARTING, few_matches(3))], path_of([]))
    assert none.warnings == (
        "no frame was tracked (3 matches with the reference frame, 80 needed)",
    )
    assert summary_of([estimate(0)], path_of([0])).warnings == ()


def test_a_large_disparity_offset_is_reported_as_a_wrong_calibration() -> None:
    (slight,) = summary_of([estimate(0)], path_of([0]), offset_px=-0.26).warnings
    assert "-0.26 px and have been corrected" in slight
    fault = Fault(FaultKind.WRONG_STEREO_CALIBRATION, value=-343.0)
    wrong = summary_of([replace(estimate(0), faults=(fault,))], path_of([0]), offset_px=-2.9)
    (text,) = wrong.warnings
    assert "-343.0 px, too much for a slightly wrong calibration" in text
    assert "not corrected" in text
    assert not wrong.verdict.is_trusted


def test_a_lens_error_is_reported_with_advice() -> None:
    summary = summary_of(
        [estimate(0)], path_of([0]), mode="mono", lens=LensError(0.012345678, 6.4567)
    )
    assert summary.to_dict()["lens_error"] == {"k1": 0.01235, "edge_px": 6.4567}
    warning = summary.warnings[0]
    assert "k1 by +0.0123, +6.5 px at the image's edges" in warning
    assert "has been corrected" in warning
    assert "vo calibrate" in warning
    fault = Fault(FaultKind.WRONG_LENS, value=-116.0)
    wrong = summary_of(
        [replace(estimate(0), faults=(fault,))],
        path_of([0]),
        mode="mono",
        lens=LensError(-0.22, -116.0),
    )
    assert "the path is inaccurate" in wrong.warnings[0]
    assert not any("has been corrected" in sentence for sentence in wrong.warnings)
    assert not wrong.verdict.is_trusted
    right = summary_of([estimate(0)], path_of([0]), mode="mono")
    assert right.to_dict()["lens_error"] is None
    assert not any("lens" in sentence for sentence in right.warnings)


def test_a_disparity_error_that_grows_to_the_sides_is_reported() -> None:
    summary = summary_of([estimate(0)], path_of([0]), curve_px=-1.23456)
    assert summary.to_dict()["disparity_curve_px"] == -1.2346
    (warning,) = summary.warnings
    assert "wrong by up to -1.23 px (at one focal length" in warning


def test_a_scene_that_is_far_for_the_baseline_is_reported() -> None:
    estimates = [replace(estimate(f), median_disparity_px=1.2 + 0.05 * f) for f in range(3)]
    far = summary_of(estimates, path_of([0, 1, 2]))
    assert far.median_disparity_px == 1.25
    assert "far away" in far.warnings[0] and "lengths by 8%" in far.warnings[0]
    near = summary_of([replace(estimate(0), median_disparity_px=2.1)], path_of([0]))
    assert near.warnings == ()
    assert summary_of(estimates, path_of([0, 1, 2]), mode="mono").median_disparity_px is None


def test_landmarks_are_counted_once() -> None:
    estimates = [estimate(0, ids=[0, 1, 2]), estimate(1, ids=[]), estimate(2, ids=[1, 2, 7])]
    assert summary_of(estimates, path_of([0, 1, 2])).landmarks == 4


def test_the_most_frequent_reason_is_told() -> None:
    failures = [Failure(FailureReason.REFERENCE_FRAME)] * 5 + [few_matches(f) for f in range(4)]
    failures += [Failure(FailureReason.PURE_ROTATION)] * 2
    estimates = [estimate(f, State.STARTING, failures[f]) for f in range(len(failures))]
    summary = summary_of(estimates, path_of([]))
    assert summary.main_failure == few_matches(3)
    assert summary.warnings[0] == (
        "no frame was tracked (3 matches with the reference frame, 80 needed)"
    )


def test_stages_have_median_and_95th_percentile() -> None:
    estimates = [estimate(f) for f in range(101)]
    stage = summary_of(estimates, path_of(list(range(101)))).stages["read"]
    assert (stage.median_ms, stage.p95_ms) == (51.0, 96.0)


def test_every_key_is_documented_and_plain() -> None:
    fault = Fault(FaultKind.TWO_MOTIONS)
    frames = [estimate(0, faults=[fault]), estimate(1, State.LOST, few_matches(3))]
    summary = summary_of(frames, path_of([0]))
    keys = summary.to_dict()
    assert json.loads(json.dumps(keys, allow_nan=False)) == keys
    documented = set(re.findall(r"`(\w+)`", DOCS.read_text(encoding="utf-8")))
    nested = {k for name in ("without_pose", "segments", "faults") for k in keys[name][0]}
    assert (set(keys) | nested) <= documented
    assert keys["frames_per_s"] == 1.0
    assert keys["versions"]["gtsam"][0].isdigit()
    assert keys["peak_rss_mb"] > 10


def test_records_are_plain_and_rounded_in_the_file() -> None:
    plain = summary_of([estimate(0)], path_of([0]), mode="mono")
    states = InertialStates(1.23456789, 0.1, (0.0, 1 / 3), 0.1, (), (), (), (), (), 0.5)
    full = replace(
        plain,
        loops=(ClosedLoop("loop", 90, 10, 0, 0, 80, None, 0.123456, None),),
        scale=ScaleFindings((MetricScale(0, 2 / 3, 0.01, "gps"),), ("a note",)),
        map=MapUse("house.map", ("monday",), (0,)),
        inertial=InertialUse("imu", states=states, time_offset_s=0.00123456),
        live=LiveState(3, (Gap(1, 2, "cut"),), None, Delay(1.0, 2.0, 3.0)),
    ).to_dict()
    (loop,) = full["loops"]
    assert loop["correction_m"] == 0.1235 and loop["correction_deg"] is None
    assert not {"marker", "earlier_session"} & set(loop)
    assert full["scales"] == [{"segment": 0, "value": 0.666666667, "sigma": 0.01, "source": "gps"}]
    assert full["map"]["sessions"] == ["monday"]
    assert full["inertial"]["states"]["scale"] == 1.23457
    assert full["inertial"]["states"]["up"] == [0.0, 0.333333]
    assert full["inertial"]["time_offset_s"] == 0.001235
    assert full["live"] == {
        "dropped": 3,
        "gaps": [{"first_ns": 1, "last_ns": 2, "reason": "cut"}],
        "unrecorded": None,
        "delay_ms": {"median": 1.0, "p95": 2.0, "max": 3.0},
    }
    assert set(full) - set(plain.to_dict()) == {"scales", "map", "inertial", "live"}
    assert json.loads(json.dumps(full)) == full


def test_covariance_is_the_upper_triangle() -> None:
    covariance = np.arange(36.0).reshape(6, 6)
    keyframe = KeyframePose(7, 123, 1, np.eye(4), covariance)
    heading, row = COVARIANCE_HEADING.split(","), covariance_line(keyframe).split(",")
    assert len(heading) == len(row) == 24
    assert row[:3] == ["123", "7", "1"]
    values = dict(zip(heading, row, strict=True))
    assert float(values["c_rx_rx"]) == 0.0
    assert float(values["c_ry_tx"]) == 9.0
    assert float(values["c_tz_tz"]) == 35.0


def test_unknown_covariance_leaves_fields_empty() -> None:
    line = covariance_line(KeyframePose(7, 123, 1, np.eye(4), None))
    assert line == "123,7,1" + "," * 21


def test_images_without_light_are_listed_by_their_numbers() -> None:
    failures = [dark(camera=1) if f in (0, 1, 2, 7) else few_matches(3) for f in range(12)]
    estimates = [estimate(f, State.STARTING, failures[f]) for f in range(12)]
    summary = summary_of(estimates, path_of([]))
    spans = [(r.first, r.last) for r in summary.without_pose]
    assert spans == [(0, 2), (3, 6), (7, 7), (8, 11)]
    assert "images 0 to 2, 7 are almost black" in summary.warnings


def test_a_single_image_without_light() -> None:
    failures = [dark(camera=1) if f == 7 else few_matches(3) for f in range(12)]
    summary = summary_of([estimate(f, State.STARTING, failures[f]) for f in range(12)], path_of([]))
    assert "image 7 is almost black" in summary.warnings
