"""The cameras that a recording can be made with: presets, or any calibration file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from vo.formats.calibration import read_calibration
from vo.settings import find_preset, names_in, preset_folder
from vo.types import Camera, Rig


def camera_folder() -> Path:
    """The cameras that come with the package, as calibration files."""
    return preset_folder() / "synth" / "cameras"


def camera_names() -> list[str]:
    """Names of these cameras."""
    return names_in(camera_folder())


def camera_file(camera: str | Path) -> Path:
    """The calibration file of a preset by its name, or one by its path.

    Raises:
        ConfigError: there is no such preset or file.
    """
    path = Path(camera)
    return path if path.is_file() else find_preset(camera, camera_folder(), "camera")


def load_rig(camera: str | Path, *, scale: float = 1.0, mono: bool = False) -> Rig:
    """The cameras of a preset or of a calibration file of any kind that `vo run` reads.

    Args:
        camera: name of a preset, or path of a file.
        scale: of the images' size; the field of view stays.
        mono: leave the second camera out.

    Raises:
        ConfigError: there is no such preset or file.
        CalibrationError: the file makes no sense.
    """
    rig = read_calibration(camera_file(camera)).rig
    cam0 = _scaled(rig.cam0, scale)
    if mono or rig.cam1 is None:
        return Rig(cam0)
    return Rig(cam0, _scaled(rig.cam1, scale), rig.cam1_from_cam0)


def _scaled(camera: Camera, scale: float) -> Camera:
    """The same lens on other pixels; the corners of the image stay where they are."""
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
