"""Cameras and rigs of a recording: presets, or any calibration file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from vo.base.settings import find_preset, names_in, preset_folder
from vo.base.types import Camera, MountedCamera, Rig
from vo.recordings.formats.calibration import read_calibration


def camera_folder() -> Path:
    """Folder of the camera presets, which are calibration files."""
    return preset_folder() / "synth" / "cameras"


def camera_names() -> list[str]:
    """Names of the camera presets."""
    return names_in(camera_folder())


def camera_file(camera: str | Path) -> Path:
    """Path of a calibration file, given the name of a preset or the path itself.

    Raises:
        ConfigError: there is no such preset or file.
    """
    path = Path(camera)
    return path if path.is_file() else find_preset(camera, camera_folder(), "camera")


def load_rig(camera: str | Path, *, scale: float = 1.0, mono: bool = False) -> Rig:
    """Read the cameras of a preset or of a calibration file in any format of `vo run`.

    `scale`: of the image size; the field of view does not change. `mono`: the first camera only.

    Raises:
        ConfigError: there is no such preset or file.
        CalibrationError: the file is not a valid calibration.
    """
    rig = read_calibration(camera_file(camera)).rig
    cam0 = _scaled(rig.cam0, scale)
    if mono or rig.cam1 is None:
        return Rig(cam0)
    return with_cameras(rig, [_scaled(camera, scale) for camera in rig.cameras])


def with_cameras(rig: Rig, cameras: Sequence[Camera]) -> Rig:
    """A rig with other cameras at the same poses."""
    further = map(MountedCamera, cameras[2:], (each.cam0_from_cam for each in rig.further))
    cam1 = None if rig.cam1 is None else cameras[1]
    return replace(rig, cam0=cameras[0], cam1=cam1, further=tuple(further))


def _scaled(camera: Camera, scale: float) -> Camera:
    """The same lens with another resolution; the corners of the image keep their rays."""
    width, height = (max(16, round(side * scale)) for side in (camera.width, camera.height))
    su, sv = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=su * camera.fx,
        fy=sv * camera.fy,
        cx=su * (camera.cx + 0.5) - 0.5,
        cy=sv * (camera.cy + 0.5) - 0.5,
    )
