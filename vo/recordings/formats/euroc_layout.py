"""Where recordings in EuRoC's layout have their calibration, and the pose of cam0 on the body.

Ground truth of this layout is that of the body. All commands find the pose of the camera here, so
that they agree.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from vo.base.errors import CalibrationError
from vo.base.types import Floats
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.formats.calibration.numbers import make_transform

_CHAIN, _SENSOR = "camchain.yaml", "sensor.yaml"


class CameraOnBody(NamedTuple):
    """`body_from_cam0` (4, 4), and the file that contains it, None if it was given."""

    body_from_cam0: Floats
    file: Path | None


def recording_folder(root: Path) -> Path:
    """The folder of a recording, given that of its sensors: `mav0` or the same."""
    return root.parent if root.name == "mav0" else root


def calibration_files(root: Path) -> list[Path]:
    """Where the calibration may be, the preferred file first; not all of them exist.

    These are EuRoC's sensor.yaml, Kalibr's camchain.yaml (also in TUM-VI's folder `dso`, and shared
    by the recordings of a folder) or its result under another name, and calibration.yaml.
    """
    root = root.resolve()
    top = recording_folder(root)
    folders = list(dict.fromkeys([root, top, top / "dso"]))
    files = [root / "cam0" / _SENSOR, *(folder / _CHAIN for folder in folders)]
    for folder in folders:  # Kalibr names its results after the bag
        named = [path for path in folder.glob("*camchain*.yaml") if path.name != _CHAIN]
        files += named if len(named) == 1 else []
    files.append(top.parent / _CHAIN)
    return [*files, root / "calibration.yaml", top / "calibration.yaml"]


def find_camera_on_body(root: Path, calibration: Calibration | None = None) -> CameraOnBody | None:
    """The pose of cam0 on the body; None if no file contains it.

    `calibration`: calibration that was read before, which is preferred.
    """
    if calibration is not None and calibration.body_from_cam0 is not None:
        return CameraOnBody(calibration.body_from_cam0, calibration.file)
    damage: CalibrationError | None = None
    for file in calibration_files(root):
        is_read = calibration is not None and calibration.file == file and file.name != _SENSOR
        if is_read or not file.is_file():
            continue
        try:
            pose = _pose_in(file)
        except CalibrationError as error:
            damage = damage or error
            continue
        if pose is not None:
            return CameraOnBody(pose, file)
    if damage is not None:
        raise damage
    return None


def _pose_in(file: Path) -> Floats | None:
    """The pose in a file; of sensor.yaml only the pose is read, as it may lack the lens."""
    if file.name != _SENSOR:
        return read_calibration(file).body_from_cam0
    document = load_document(file)
    if "T_BS" not in document.data:
        raise CalibrationError(f"{file}: T_BS is missing; it is the pose of the camera")
    return make_transform(f"{file}: T_BS", document.data["T_BS"])
