"""Text tables that several layouts share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from data_synth.records import BodyTruth, Imu, Recording
from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Floats, Ints, Trajectory

_NS_PER_S = 1_000_000_000

_STATE_HEADING = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],"
    "b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],"
    "b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"
)
_IMU_HEADING = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
_MOVERS_HEADING = "#timestamp [ns],name,x [m],y [m],z [m],qw [],qx [],qy [],qz []"


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write lines one by one, with the same bytes on every system."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


def seconds_text(stamp_ns: int) -> str:
    """Seconds to the nanosecond; `stamp_ns` is not negative."""
    seconds, nanoseconds = divmod(int(stamp_ns), _NS_PER_S)
    return f"{seconds}.{nanoseconds:09d}"


def numbers_text(values: Iterable[float], separator: str = ",") -> str:
    """Numbers to twelve digits."""
    return separator.join(f"{value:.12g}" for value in values)


def written(recording: Recording, camera: int) -> Ints:
    """Numbers of the frames that a camera did not drop."""
    return np.flatnonzero(~recording.dropped[camera]).astype(np.int64)


def written_stamps(recording: Recording, camera: int) -> list[int]:
    """Stamps of the frames that a camera did not drop."""
    stamps: list[int] = recording.stamps_ns[camera][written(recording, camera)].tolist()
    return stamps


def written_truth(recording: Recording) -> Trajectory:
    """Poses of cam0 at the frames that it did not drop."""
    keep = written(recording, 0)
    truth = recording.cam0_truth
    return Trajectory(truth.stamps_ns[keep], truth.world_from_cam[keep])


def write_states(path: Path, truth: BodyTruth) -> None:
    """Write true poses, velocities and biases of the body in EuRoC's format."""
    write_lines(path, _state_lines(truth))


def write_imu(path: Path, imu: Imu) -> None:
    """Write inertial measurements in EuRoC's format."""
    write_lines(path, _imu_lines(imu))


def write_movers(path: Path, recording: Recording) -> None:
    """Write true poses of moving bodies at the frames that cam0 did not drop; no file for none.

    Each line is a stamp in nanoseconds, a name, the position and `qw qx qy qz` of world_from_mover.
    """
    if recording.movers:
        write_lines(path, _mover_lines(recording))


def _state_lines(truth: BodyTruth) -> Iterator[str]:
    yield _STATE_HEADING
    rows = zip(
        truth.stamps_ns.tolist(),
        truth.world_from_body,
        truth.velocity,
        truth.gyro_bias,
        truth.accel_bias,
        strict=True,
    )
    for stamp, pose, *vectors in rows:
        yield f"{stamp},{numbers_text([*_pose_numbers(pose), *np.concatenate(vectors)])}"


def _imu_lines(imu: Imu) -> Iterator[str]:
    yield _IMU_HEADING
    for stamp, gyro, accel in zip(imu.stamps_ns.tolist(), imu.gyro, imu.accel, strict=True):
        numbers = [float(value) for value in (*gyro, *accel)]
        yield f"{stamp},{','.join(map(repr, numbers))}"


def _mover_lines(recording: Recording) -> Iterator[str]:
    yield _MOVERS_HEADING
    stamps = recording.cam0_truth.stamps_ns
    for index in written(recording, 0).tolist():
        for mover in recording.movers:
            pose = _pose_numbers(mover.world_from_mover[index])
            yield f"{stamps[index]},{mover.name},{numbers_text(pose)}"


def _pose_numbers(a_from_b: Floats) -> list[float]:
    """Position and quaternion `x y z qw qx qy qz`, qw not negative."""
    x, y, z, w = quat_xyzw_from_rotation(a_from_b[:3, :3])
    sign = -1.0 if w < 0 else 1.0
    return [*a_from_b[:3, 3], sign * w, sign * x, sign * y, sign * z]
