"""Records of poses: what is in them, and that the schema describes them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from pose_updates import BEGUN_NS, FAULT, estimate, keyframe, lost, pose

from vo.base.failures import Failure, FailureReason
from vo.base.faults import Fault, FaultKind
from vo.base.types import PredictedPose, State
from vo.outputs.streaming.sink import SCHEMA_FILE, SCHEMA_VERSION, PoseRecords, encoded

SCHEMA = json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))


def check(record: dict[str, Any]) -> dict[str, Any]:
    """A record as its reader sees it, after a check against the schema."""
    validator = pytest.importorskip("jsonschema").Draft202012Validator(SCHEMA)
    line = encoded(record)
    assert b"\n" not in line
    read = json.loads(line)
    assert isinstance(read, dict)
    validator.validate(read)
    assert set(read) == set(SCHEMA["properties"]) == set(SCHEMA["required"])
    return read


def test_a_tracked_frame() -> None:
    read = check(PoseRecords(is_metric=True).record(estimate(2, is_keyframe=True)))
    assert (read["frame"], read["stamp_ns"]) == (2, BEGUN_NS + 100_000_000)
    assert (read["state"], read["failure"], read["segment"]) == ("tracking", None, 0)
    assert (read["is_keyframe"], read["inliers"], read["length_unit"]) == (True, 140, "m")
    assert read["schema_version"] == SCHEMA_VERSION == 1
    pose = read["world_from_cam0"]
    assert pose["position_xyz"] == [0.5, 0.0, 2.0]
    assert pose["quat_xyzw"] == pytest.approx([0.0, np.sin(0.1), 0.0, np.cos(0.1)], abs=1e-9)


@pytest.mark.parametrize("reason", FailureReason)
def test_a_frame_without_a_pose_has_the_reason_as_a_word(reason: FailureReason) -> None:
    estimated = lost(3, state=State.STARTING, failure=Failure(reason, 3.0))
    read = check(PoseRecords(is_metric=False).record(estimated))
    assert (read["world_from_cam0"], read["state"]) == (None, "starting")
    assert read["failure"] == reason.name.lower()
    assert read["length_unit"] == "map units"


def test_a_predicted_pose_is_apart_and_has_its_own_covariance() -> None:
    records = PoseRecords(is_metric=True)
    records.record(estimate(2, keyframes=(keyframe(2, 0.25),)))
    predicted = PredictedPose(pose(3), 0.5 * np.eye(6))
    read = check(records.record(lost(3, predicted=predicted)))
    assert (read["state"], read["failure"]) == ("lost", "few_inliers")
    assert (read["world_from_cam0"], read["covariance"]) == (None, None)
    assert read["predicted"]["position_xyz"] == [0.5, 0.0, 3.0]
    assert read["predicted"]["rx_ry_rz_tx_ty_tz"] == (0.5 * np.eye(6)).tolist()
    read = check(records.record(lost(4, predicted=predicted._replace(covariance=None))))
    assert read["predicted"]["rx_ry_rz_tx_ty_tz"] is None
    read = check(records.record(lost(5)))
    assert read["predicted"] is None and read["covariance"]["keyframe"] == 2


def test_faults_of_the_recording_are_in_the_first_record_alone() -> None:
    records = PoseRecords(is_metric=True, faults=[Fault(FaultKind.CLOCK_SET_BACK, value=2.0)])
    first = check(records.record(estimate(0, faults=(FAULT,))))
    second = check(records.record(estimate(1)))
    assert first["faults"] == [
        {"kind": "clock_set_back", "is_handled": False, "value": 2.0},
        {"kind": "blurred_images", "is_handled": True, "value": 1.5},
    ]
    assert second["faults"] == []


def test_the_covariance_is_that_of_the_newest_keyframe_with_one() -> None:
    records = PoseRecords(is_metric=True)
    assert check(records.record(estimate(0, keyframes=(keyframe(0, None),))))["covariance"] is None
    known = check(records.record(estimate(1, keyframes=(keyframe(0, 0.25), keyframe(1, None)))))
    assert known["covariance"]["keyframe"] == 0
    assert known["covariance"]["rx_ry_rz_tx_ty_tz"] == (np.eye(6) * 0.25).tolist()
    assert check(records.record(estimate(2)))["covariance"] == known["covariance"]
    moved = (keyframe(0, 0.5), keyframe(2, 0.75))
    assert check(records.record(estimate(3, keyframes=moved)))["covariance"]["keyframe"] == 2
    older = check(records.record(estimate(4, keyframes=(keyframe(0, 0.5),))))
    assert older["covariance"]["keyframe"] == 2
    broken = keyframe(5, float("nan"))
    assert check(records.record(estimate(5, keyframes=(broken,))))["covariance"]["keyframe"] == 2
    assert check(records.record(lost(6, segment=1)))["covariance"] is None


def test_withdrawn_frames_are_named() -> None:
    read = check(PoseRecords(is_metric=True).record(estimate(9, tracked_anew_from=4)))
    assert read["tracked_anew_from"] == 4


def test_the_schema_refuses_other_records() -> None:
    validator = pytest.importorskip("jsonschema").Draft202012Validator(SCHEMA)
    validator.check_schema(SCHEMA)
    good = json.loads(encoded(PoseRecords(is_metric=True).record(estimate(0))))
    for key in SCHEMA["required"]:
        assert not validator.is_valid({k: v for k, v in good.items() if k != key}), key
    assert not validator.is_valid(good | {"schema_version": 2})
    assert not validator.is_valid(good | {"state": "flying"})
    assert validator.is_valid(good | {"a_later_key": 1})
