"""Calibrations as functions, with the words of `vo calibrate`; the command calls them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack, get_type_hints

from vo.base.errors import OutputError
from vo.base.types import Mode, Rig
from vo.outputs.results.output_paths import refuse_existing, refuse_to_overwrite
from vo.recordings.formats.calibration import ImuCalibration, read_calibration, write_calibration
from vo.recordings.sources.imu import usable_noise
from vo.recordings.sources.imu_only import open_imu
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.uncalibrated import open_uncalibrated
from vo.runs.run_options import checked_options
from vo.tools.calibrating.board import Board, make_board
from vo.tools.calibrating.board_poses import board_poses
from vo.tools.calibrating.calibrate import CalibrationResult
from vo.tools.calibrating.calibrate import calibrate as calibrate_views
from vo.tools.calibrating.calibration_figures import comments
from vo.tools.calibrating.imu_camera import ImuOnCamera, calibrate_imu_camera
from vo.tools.calibrating.imu_camera import comments as imu_comments
from vo.tools.calibrating.imu_noise import ImuNoiseResult, measure_noise, write_kalibr
from vo.tools.calibrating.kalibr_chain import write_chain
from vo.tools.calibrating.plots import save_allan_plot, save_plot
from vo.tools.calibrating.printing import save_board
from vo.tools.calibrating.recorded import Show, calibrate_recorded
from vo.tools.calibrating.views import detect_views
from vo.tools.drawing import check_plot

KALIBR_NAME = "camchain-imucam.yaml"
_MAX_FRAMES = 2000  # searched for poses of the board

Name = str | Path
# Gives, for the number of frames to search, what is called with those searched and the views found.
Searching = Callable[[int], AbstractContextManager[Show]]


class BoardWords(TypedDict, total=False):
    """A board; `square` and `marker` in metres."""

    board: Literal["chessboard", "charuco"]
    columns: int
    rows: int
    square: float
    marker: float | None
    dictionary: str
    legacy: bool


class _BoardRecording(BoardWords, total=False):
    """A board, and how the recording of it is read."""

    model: Literal["auto", "radtan", "radtan8", "equidistant"]
    mode: Mode
    format: str | None
    topics: Sequence[str]
    right_offset_ns: int | None
    side_by_side: bool
    start: int
    end: int | None
    views: int
    force: bool


class CalibrateWords(_BoardRecording, total=False):
    """Options of `calibrate`."""

    look_at: int
    picture: Name | None


class CalibrateImuWords(_BoardRecording, total=False):
    """Options of `calibrate_imu`; `calibration` has the cameras, if they are known."""

    calibration: Name | None


@dataclass(frozen=True, eq=False)
class CalibratedImu:
    """Cameras, the inertial sensor on them, and how well it is known."""

    rig: Rig
    imu: ImuCalibration
    found: ImuOnCamera
    kalibr: Path | None = None  # file in Kalibr's layout
    not_for_kalibr: str = ""  # why there is none


def calibrate(
    source: Name,
    output: Name | None = None,
    *,
    progress: Searching | None = None,
    **words: Unpack[CalibrateWords],
) -> CalibrationResult:
    """Calibrate cameras from a recording of a board, as `vo calibrate`; `rig` has the cameras.

    Args:
        source: the recording, without a calibration.
        output: file to write, if one is wanted.
        progress: observer of the search for the board.
        **words: board, columns, rows, square, marker, dictionary, model, picture, and others.

    Raises:
        VoError: the board is seen too seldom, no model fits, or the file exists without `force`.
    """
    given = checked_options(words, get_type_hints(CalibrateWords))
    picture = given.get("picture")
    made = _board(given)
    check_outputs(source, (output,), picture, force=given.get("force", False))
    span = (given.get("start", 0), given.get("end"))
    chosen = {name: given[name] for name in ("model", "look_at", "views") if name in given}
    result = calibrate_recorded(_opened(source, given), made, span, **chosen, progress=progress)
    if picture is not None:
        save_plot(picture, result)
    if output is not None:
        write_calibration(Path(output), result.rig, comments(result))
    return result


def calibrate_imu(
    source: Name,
    output: Name | None = None,
    *,
    progress: Searching | None = None,
    **words: Unpack[CalibrateImuWords],
) -> CalibratedImu:
    """Pose and time offset of an inertial sensor on the camera, as `vo calibrate --imu`.

    Args:
        source: recording in which the camera is turned quickly, with the board in view.
        output: file to write; one in Kalibr's layout is written beside it.
        progress: observer of the search for the board.
        **words: those of `calibrate`, without `look_at` and `picture`, and `calibration`: the
            cameras, which are else calibrated from the same recording.

    Raises:
        VoError: the board is seen too seldom, the sensor does not fit, or a file exists.
    """
    given = checked_options(words, get_type_hints(CalibrateImuWords))
    made = _board(given)
    target = None if output is None else Path(output)
    kalibr = None if target is None else target.with_name(KALIBR_NAME)
    check_outputs(source, (target, kalibr), None, force=given.get("force", False))
    result = _imu_on_camera(Path(source), made, given, progress)
    if target is None or kalibr is None:
        return result
    write_calibration(target, result.rig, imu_comments(result.found), result.imu)
    reason = write_chain(kalibr, result.rig, result.imu)
    written = None if reason else kalibr
    return CalibratedImu(result.rig, result.imu, result.found, written, reason)


def calibrate_imu_noise(
    source: Name,
    output: Name | None = None,
    *,
    picture: Name | None = None,
    format: str | None = None,
    topics: Sequence[str] = (),
    force: bool = False,
) -> ImuNoiseResult:
    """Noise of an inertial sensor from a recording at rest, as `vo calibrate --imu-noise`.

    Args:
        source: the recording: at least a minute, better an hour.
        output: Kalibr's `imu.yaml` to write, if one is wanted.
        picture: plot of the Allan deviations.
        format: of the recording; by default detected.
        topics: of the sensor in a log.
        force: whether an existing file is replaced.

    Raises:
        VoError: there is no sensor, or it does not rest for long enough.
    """
    check_outputs(source, (output,), picture, force=force)
    sensor = open_imu(Path(source), format, topics)
    samples = sensor.read()
    result = measure_noise(samples.stamps_ns, samples.gyro, samples.accel)
    if picture is not None:
        save_allan_plot(Path(picture), result)
    if output is not None:
        topic = sensor.name if sensor.name.startswith("/") else "/imu0"
        write_kalibr(Path(output), result, topic)
    return result


def print_board(output: Name, *, force: bool = False, **words: Unpack[BoardWords]) -> Board:
    """Write a board to print in true size, as `vo calibrate --print-board`; raises `VoError`."""
    made = _board(checked_options(words, get_type_hints(BoardWords)))
    refuse_existing([Path(output)], force=force)
    save_board(Path(output), made)
    return made


def _board(given: dict[str, Any]) -> Board:
    usual = {"board": "chessboard", "columns": 9, "rows": 6, "square": 0.03, "marker": None}
    known = usual | {"dictionary": "4X4_50", "legacy": False}
    return make_board(*(given.get(name, value) for name, value in known.items()))


def _opened(source: Name, given: dict[str, Any]) -> ImageSequence:
    names = ("side_by_side", "mode", "format", "topics", "right_offset_ns")
    return open_uncalibrated(Path(source), **{name: given[name] for name in names if name in given})


def check_outputs(
    source: Name, outputs: Iterable[Name | None], picture: Name | None, *, force: bool
) -> None:
    """Check the output paths before minutes of work."""
    paths = [Path(each) for each in outputs if each is not None]
    refuse_existing(paths, force=force)
    if picture is not None:
        paths.append(Path(picture))
    refuse_to_overwrite([Path(source)], paths)
    for path in paths:
        if path.is_dir() or not path.absolute().parent.is_dir():
            raise OutputError(f"{path} cannot be written; give a file in an existing folder")
    if picture is not None:
        check_plot(Path(picture), "picture")


def _imu_on_camera(
    path: Path, board: Board, given: dict[str, Any], progress: Searching | None
) -> CalibratedImu:
    sensor = open_imu(path, given.get("format"), given.get("topics", ()))
    samples = sensor.read()
    source = _opened(path, given)
    size = (source.rig.cam0.width, source.rig.cam0.height)
    calibration, start, end = given.get("calibration"), given.get("start", 0), given.get("end")
    known = None if calibration is None else read_calibration(calibration, size)
    count = max(min(end or len(source), len(source)) - start, 1)
    stride = -(-count // _MAX_FRAMES)
    cameras = 2 if source.rig.is_stereo and known is None else 1
    frames = source.frames(start, end, stride)
    shown: AbstractContextManager[Show] = nullcontext(lambda searched, found: None)
    if progress is not None:
        shown = progress(-(-count // stride))
    with shown as show:
        detected = detect_views(board, frames, cameras, os.cpu_count() or 1, show)
    if known is None:
        model, views = given.get("model", "auto"), given.get("views", 60)
        rig = calibrate_views(board, detected, size, model, views).rig
        noise = usable_noise(sensor)
    else:
        rig, noise = known.rig, known.imu.noise or usable_noise(sensor)
    poses = board_poses(board, detected, rig.cam0)
    found = calibrate_imu_camera(poses, samples.stamps_ns, samples.gyro, samples.accel, noise)
    imu = ImuCalibration(found.cam0_from_imu, noise, found.time_offset_s)
    return CalibratedImu(rig, imu, found)
