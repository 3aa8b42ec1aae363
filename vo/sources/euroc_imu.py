"""EuRoC's inertial sensors: imu0/data.csv and imu0/sensor.yaml."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from vo.errors import VoError
from vo.formats.calibration import Calibration
from vo.formats.calibration.checks import make_numbers, make_transform
from vo.formats.calibration.document import load_document
from vo.geometry.transforms import inverse
from vo.sources.imu import ImuSamples, TableImu, cam0_from_imu_in, make_samples
from vo.sources.listing import LARGEST_NS, read_lines, whole_ns
from vo.types import Floats, ImuNoise

_log = logging.getLogger(__name__)

_COLUMNS = 6
_NOISE_KEYS = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)


def euroc_imus(
    root: Path, calibration: Calibration | None, body_from_cam0: Callable[[], Floats | None]
) -> list[TableImu]:
    """The inertial sensors of a recording, whose files are read when they are asked for.

    Args:
        root: `mav0`, or a folder like it.
        calibration: of the cameras; None where unknown.
        body_from_cam0: finds out where cam0 is on the body.
    """
    tables = sorted(root.glob("imu*/data.csv"))
    return [_imu(table, calibration, body_from_cam0) for table in tables]


def _imu(
    table: Path, calibration: Calibration | None, body_from_cam0: Callable[[], Floats | None]
) -> TableImu:
    sensor = table.parent / "sensor.yaml"

    def place() -> Floats | None:
        said = cam0_from_imu_in(calibration)
        if said is not None:
            return said
        body_from_imu, known = _body_from_imu(sensor), body_from_cam0()
        return None if body_from_imu is None or known is None else inverse(known) @ body_from_imu

    return TableImu(str(table), lambda: _read(table), place, lambda: _noise(sensor))


def _read(table: Path) -> ImuSamples:
    """Lines of a stamp in nanoseconds, rad/s about x, y, z and m/s² along x, y, z."""
    stamps, values = [], []
    lines = read_lines(table)
    for _, text in lines:
        fields = text.split(",")
        try:
            stamp = whole_ns(fields[0].strip())
            row = [float(field) for field in fields[1 : 1 + _COLUMNS]]
        except ValueError:
            continue
        if len(row) == _COLUMNS and stamp <= LARGEST_NS:
            stamps.append(stamp)
            values.append(row)
    read = make_samples(stamps, values, len(lines) - len(stamps))
    for count, what in ((read.unreadable, "cannot be read"), (read.repeated, "repeat a stamp")):
        if count:
            _log.warning("%s: %d of %d lines %s and are left out", table, count, len(lines), what)
    return read


def _body_from_imu(sensor: Path) -> Floats | None:
    if not sensor.is_file():
        return None
    try:
        data = load_document(sensor).data
        return make_transform(f"{sensor}: T_BS", data["T_BS"]) if "T_BS" in data else None
    except VoError as error:
        _log.warning("where the inertial sensor is, is not known: %s", error)
        return None


def _noise(sensor: Path) -> ImuNoise | None:
    try:
        data = load_document(sensor).data
        numbers = [data[key] for key in _NOISE_KEYS]
        return ImuNoise(*make_numbers(f"{sensor}: noise", numbers, len(_NOISE_KEYS)))
    except (VoError, KeyError):
        return None
