"""nuScenes: six cameras around a car, each with its own stamps, and poses of the car.

The tables are JSON in a folder such as `v1.0-mini`, beside `samples` and `sweeps`. A recording is a
scene: `v1.0-mini/scene-0061`. Source: Caesar et al., nuScenes, 2020.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError, SourceError
from vo.base.files.bounded_files import read_bytes
from vo.base.geometry.transforms import inverse, make_transform, rotation_from_quat_xyzw
from vo.base.types import Camera, Floats, Mode, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize, read_calibration
from vo.recordings.formats.calibration.checks import matrix_camera, rig_of
from vo.recordings.sources.assembly import RecordingContents
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot, check_existing, inside

_Row = dict[str, Any]
_CHANNELS = (
    "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT", "CAM_BACK_LEFT", "CAM_BACK",
)  # fmt: skip
_TABLE = "sample_data.json"
_MAX_BYTES = 2**28
_NS_PER_US = 1000


def gather_nuscenes(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List the cameras of a scene; of a folder of tables with one scene, of that."""
    tables, name = (path, None) if path.is_dir() else (path.parent, path.name)
    scene = _scene(tables, name)
    try:
        cameras = _cameras(tables, str(scene["token"]))
        posed = {row["token"]: row for row in _rows(tables, "ego_pose")}
        channels = [channel for channel in _CHANNELS if channel in cameras]
        first, *others = [_shots(tables, cameras[channel]) for channel in channels]
        found = _calibration(tables, [cameras[channel][0] for channel in channels])
        truth = _truth(cameras[channels[0]], posed, found[1][0])
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise SourceError(f"{tables}: a table is damaged or incomplete: {error!r}") from error
    return RecordingContents(
        name=str(scene["name"]),
        format="nuscenes",
        left=first,
        right=others[0] if others else None,
        further=others[1:],
        calibrate=_reader(tables, calibration, *found),
        read_truth=lambda _: truth,
    )


def _reader(
    tables: Path, chosen: Path | None, cameras: list[Camera], body_from_cams: list[Floats]
) -> Callable[[ImageSize], Calibration]:
    def read(size: ImageSize) -> Calibration:
        if chosen is not None:
            return read_calibration(chosen, size)
        poses = [inverse(body_from_cams[0]) @ pose for pose in body_from_cams]
        rig = rig_of(str(tables / "calibrated_sensor.json"), cameras, poses)
        return Calibration(rig, body_from_cams[0], kind="nuScenes")

    return read


def _rows(tables: Path, name: str) -> list[_Row]:
    file = tables / f"{name}.json"
    try:
        rows = json.loads(read_bytes(file, _MAX_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        raise SourceError(
            f"{file} cannot be read: {error}; tables of nuScenes have less than "
            f"{_MAX_BYTES // 2**20} MB here, as v1.0-mini has"
        ) from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SourceError(f"{file} is no list of records")
    return rows


def _scene(tables: Path, name: str | None) -> _Row:
    scenes = {str(row.get("name")): row for row in _rows(tables, "scene")}
    if name is None and len(scenes) == 1:
        return next(iter(scenes.values()))
    if name not in scenes:
        listed = ", ".join(list(scenes)[:10])
        what = "has several scenes" if name is None else f"has no scene {name}"
        example = tables / next(iter(scenes), "scene-0061")
        raise SourceError(f"{tables} {what}: {listed}; give one, such as {example}")
    return scenes[name]


def _cameras(tables: Path, scene: str) -> dict[str, list[_Row]]:
    """The records of images of a scene by channel, in order, with their calibration."""
    samples = {row["token"] for row in _rows(tables, "sample") if row["scene_token"] == scene}
    sensors = {row["token"]: row for row in _rows(tables, "sensor")}
    calibrated = {row["token"]: row for row in _rows(tables, "calibrated_sensor")}
    found: dict[str, list[_Row]] = {}
    for row in _rows(tables, "sample_data"):
        if row["sample_token"] in samples:
            mounted = calibrated[row["calibrated_sensor_token"]]
            channel = sensors[mounted["sensor_token"]]["channel"]
            if channel in _CHANNELS:
                found.setdefault(channel, []).append(row | {"mounted": mounted})
    if not found:
        raise SourceError(f"{tables}: the scene has no images of {', '.join(_CHANNELS)}")
    return {
        channel: sorted(rows, key=lambda row: row["timestamp"]) for channel, rows in found.items()
    }


def _shots(tables: Path, rows: Sequence[_Row]) -> list[Shot]:
    root, table = tables.parent, tables / _TABLE
    files = [inside(root, root / str(row["filename"]), str(table)) for row in rows]
    check_existing(files, table)
    stamps = [_NS_PER_US * int(row["timestamp"]) for row in rows]
    return [Shot(s, ImageFile(f), str(table)) for s, f in zip(stamps, files, strict=True)]


def _calibration(tables: Path, rows: Sequence[_Row]) -> tuple[list[Camera], list[Floats]]:
    """Cameras, and their poses on the car."""
    cameras, poses = [], []
    for row in rows:
        where, mounted = f"{tables / 'calibrated_sensor.json'}: {row['filename']}", row["mounted"]
        cameras.append(
            matrix_camera(
                where,
                resolution=[row["width"], row["height"]],
                matrix=mounted["camera_intrinsic"],
                distortion_model="none",
                distortion=(),
            )
        )
        poses.append(_pose(where, mounted))
    return cameras, poses


def _truth(rows: Sequence[_Row], posed: dict[str, _Row], body_from_cam0: Floats) -> Trajectory:
    """Poses of cam0 at its images."""
    poses = [_pose("ego_pose.json", posed[row["ego_pose_token"]]) for row in rows]
    stamps_ns = np.array([_NS_PER_US * int(row["timestamp"]) for row in rows], dtype=np.int64)
    return Trajectory(stamps_ns, np.stack(poses) @ body_from_cam0)


def _pose(where: str, row: _Row) -> Floats:
    """`translation` (x y z) and `rotation` (w x y z)."""
    w, *xyz = (float(value) for value in row["rotation"])
    quat_xyzw = np.array([*xyz, w])
    if len(xyz) != 3 or abs(np.linalg.norm(quat_xyzw) - 1.0) > 1e-2:
        raise CalibrationError(f"{where}: rotation is no quaternion of length 1 (w x y z)")
    return make_transform(rotation_from_quat_xyzw(quat_xyzw), np.array(row["translation"], float))
