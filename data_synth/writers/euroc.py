"""Writes recordings in the EuRoC MAV layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from vo.formats.trajectory import write_tum
from vo.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.types import Camera, Floats, Ints, Rig, Trajectory

_TRUTH_HEADING = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],"
    "b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],"
    "b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"
)


def write_cameras(folder: Path, rig: Rig, body_from_cam0: Floats, fps: float) -> None:
    """Write the `sensor.yaml` of each camera and make the folders for its images."""
    cameras = [(rig.cam0, body_from_cam0)]
    if rig.cam1 is not None and rig.cam1_from_cam0 is not None:
        cameras.append((rig.cam1, body_from_cam0 @ inverse(rig.cam1_from_cam0)))
    for number, (camera, body_from_cam) in enumerate(cameras):
        home = folder / "mav0" / f"cam{number}"
        (home / "data").mkdir(parents=True)
        sensor = _sensor(camera, body_from_cam, fps)
        _write(home / "sensor.yaml", yaml.safe_dump(sensor, sort_keys=False))


def image_path(folder: Path, camera: int, stamp_ns: int) -> Path:
    """Where an image belongs."""
    return folder / "mav0" / f"cam{camera}" / "data" / f"{stamp_ns}.png"


def write_stamps(folder: Path, camera: int, stamps_ns: Ints) -> None:
    """Write the list of a camera's images."""
    lines = [f"{stamp},{stamp}.png\n" for stamp in stamps_ns.tolist()]
    table = folder / "mav0" / f"cam{camera}" / "data.csv"
    _write(table, "#timestamp [ns],filename\n" + "".join(lines))


def write_truth(
    folder: Path, stamps_ns: Ints, world_from_body: Floats, velocity: Floats, cam0: Trajectory
) -> None:
    """Write the true poses of the body, its velocity (N, 3), and the poses of cam0.

    The biases of the inertial sensor are those of a perfect one.
    """
    lines = [_TRUTH_HEADING]
    for stamp, pose, speed in zip(stamps_ns.tolist(), world_from_body, velocity, strict=True):
        x, y, z, w = quat_xyzw_from_rotation(pose[:3, :3])
        numbers = [*pose[:3, 3], w, x, y, z, *speed, *np.zeros(6)]
        lines.append(f"{stamp}," + ",".join(f"{number:.9f}" for number in numbers))
    home = folder / "mav0" / "state_groundtruth_estimate0"
    home.mkdir(parents=True)
    _write(home / "data.csv", "\n".join(lines) + "\n")
    write_tum(folder / "groundtruth.tum", cam0)


def _sensor(camera: Camera, body_from_cam: Floats, fps: float) -> dict[str, object]:
    return {
        "sensor_type": "camera",
        "T_BS": {"cols": 4, "rows": 4, "data": [float(x) for x in body_from_cam.ravel()]},
        "rate_hz": fps,
        "resolution": [camera.width, camera.height],
        "camera_model": "pinhole",
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": list(camera.distortion) or [0.0] * 4,
    }


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")
