"""Inertial sensors of EuRoC recordings: imu0/data.csv and imu0/sensor.yaml."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import VoError
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, ImuNoise
from vo.recordings.formats.calibration import Calibration
from vo.recordings.formats.calibration.checks import make_noise
from vo.recordings.formats.calibration.document import load_document
from vo.recordings.formats.calibration.kalibr import NOISE_KEYS
from vo.recordings.formats.calibration.numbers import make_transform
from vo.recordings.formats.stamp_units import MAX_STAMP_NS, parse_all_ns, parse_ns
from vo.recordings.sources.imu import FileImu, ImuSamples, imu_of, make_samples
from vo.recordings.sources.listing import read_data

_log = logging.getLogger(__name__)

_COLUMNS = 6


def euroc_imus(
    root: Path,
    calibration: Calibration | None,
    body_from_cam0: Callable[[], Floats | None],
    tables: Sequence[Path] = (),
) -> list[FileImu]:
    """The inertial sensors of a recording; their files are read on first use.

    `tables`: their files; by default all `imu*/data.csv`.
    """
    tables = tables or sorted(root.glob("imu*/data.csv"))
    return [_imu(table, calibration, body_from_cam0) for table in tables]


def _imu(
    table: Path, calibration: Calibration | None, body_from_cam0: Callable[[], Floats | None]
) -> FileImu:
    sensor = table.parent / "sensor.yaml"

    given = imu_of(calibration)

    def find_extrinsics() -> Floats | None:
        if given.cam0_from_imu is not None:
            return given.cam0_from_imu
        body_from_imu, body_from_cam = _body_from_imu(sensor), body_from_cam0()
        if body_from_imu is None or body_from_cam is None:
            return None
        return inverse(body_from_cam) @ body_from_imu

    return FileImu(
        str(table),
        lambda: _read(table),
        find_extrinsics,
        lambda: given.noise or _noise(sensor),
        given.time_offset_s,
    )


def _read(table: Path) -> ImuSamples:
    """Read lines of a stamp in ns, angular rates in rad/s and accelerations in m/s²."""
    lines = read_data(table)
    read = _all_at_once(lines) or _one_by_one(lines)
    for count, reason in ((read.unreadable, "cannot be read"), (read.repeated, "repeat a stamp")):
        if count:
            _log.warning("%s: %d of %d lines %s and are skipped", table, count, len(lines), reason)
    return read


def _all_at_once(lines: list[str]) -> ImuSamples | None:
    """Samples of lines that are all well-formed, in a third of the time; None if some are not."""
    try:
        stamps = parse_all_ns([text.partition(",")[0].strip() for text in lines])
        columns = range(1, 1 + _COLUMNS)
        values = np.loadtxt(lines, delimiter=",", comments=None, usecols=columns, ndmin=2)
    except ValueError:
        return None
    return make_samples(stamps, values, 0) if max(stamps) <= MAX_STAMP_NS else None


def _one_by_one(lines: list[str]) -> ImuSamples:
    """Samples of the lines that are well-formed."""
    stamps, values = [], []
    for text in lines:
        fields = text.split(",")
        try:
            stamp = parse_ns(fields[0].strip())
            row = [float(field) for field in fields[1 : 1 + _COLUMNS]]
        except ValueError:
            continue
        if len(row) == _COLUMNS and stamp <= MAX_STAMP_NS:
            stamps.append(stamp)
            values.append(row)
    return make_samples(stamps, values, len(lines) - len(stamps))


def _body_from_imu(sensor: Path) -> Floats | None:
    if not sensor.is_file():
        return None
    try:
        data = load_document(sensor).data
        return make_transform(f"{sensor}: T_BS", data["T_BS"]) if "T_BS" in data else None
    except VoError as error:
        _log.warning("pose of the inertial sensor unknown: %s", error)
        return None


def _noise(sensor: Path) -> ImuNoise | None:
    if not sensor.is_file():
        return None
    try:
        return make_noise(str(sensor), load_document(sensor).data, NOISE_KEYS)
    except VoError as error:
        _log.warning("noise of the inertial sensor unknown: %s", error)
        return None
