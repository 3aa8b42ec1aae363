"""Reader of the noise in Kalibr's `imu.yaml` and OpenVINS' `kalibr_imu_chain.yaml`.

Kalibr's input has the values at the top, its output and OpenVINS' file in a section `imu0`. The
densities are continuous-time: rad/s/√Hz and m/s²/√Hz, random walks rad/s²/√Hz and m/s³/√Hz.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vo.base.errors import CalibrationError
from vo.base.types import ImuNoise
from vo.recordings.formats.calibration.document import Document, load_document, shortened
from vo.recordings.formats.calibration.imu import make_noise

OPENVINS_IMU = "relative_config_imu"
NOISE_KEYS = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)
_MAX_FILES = 20
_log = logging.getLogger(__name__)


def kalibr_noise(document: Document) -> ImuNoise | None:
    """The noise in a camera chain, in the file that it names, or in the only such file beside it.

    Files beside are those with `imu` in their names. Several that differ cause a warning, and none
    of them is used.
    """
    own = _noise_in(document)
    if own is not None:
        return own
    named = document.data.get(OPENVINS_IMU)
    if named is not None:
        path = document.path.parent / str(named)
        if not path.is_file():
            _log.warning(
                "%s: %s %s does not exist; the noise of the IMU is unknown",
                document.path,
                OPENVINS_IMU,
                shortened(named),
            )
            return None
        return _noise_in(load_document(path))
    found = {path: noise for path, noise in _beside(document.path)}
    if len(set(found.values())) > 1:
        _log.warning(
            "%s have different noise of the IMU, and none of them is used; keep one",
            " and ".join(path.name for path in list(found)[:3]),
        )
        return None
    return next(iter(found.values()), None)


def _noise_in(document: Document) -> ImuNoise | None:
    section, where = _section(document.data), str(document.path)
    return make_noise(where, section, NOISE_KEYS)


def _section(data: Mapping[str, Any]) -> Mapping[str, Any]:
    imu0 = data.get("imu0")
    return imu0 if isinstance(imu0, Mapping) else data


def _beside(path: Path) -> Iterator[tuple[Path, ImuNoise]]:
    files = [file for file in sorted(path.parent.glob("*imu*.y*ml")) if file.name != path.name]
    for file in files[:_MAX_FILES]:
        if not file.is_file():
            continue
        try:
            document = load_document(file)
        except CalibrationError:
            continue  # not a calibration
        if "cam0" not in document.data:
            noise = _noise_in(document)
            if noise is not None:
                yield file, noise
