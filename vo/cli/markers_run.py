"""What `vo markers` does: an image, or the frames of a recording."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from vo.base.errors import CalibrationError, ConfigError
from vo.base.printable import counted
from vo.base.types import Bytes, Camera
from vo.cli.echo import echo, echo_json
from vo.cli.opening import open_one_camera
from vo.cli.progress import counting
from vo.engine.markers.dictionaries import AUTO, CANDIDATES, DEFAULT_TO_PRINT, dictionary_name
from vo.outputs.results.output_paths import refuse_existing, refuse_to_overwrite
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.sources.listing import IMAGE_SUFFIXES
from vo.recordings.sources.single_image import read_single_image
from vo.tools.calibrating.printing import save_board
from vo.tools.drawing import check_picture, check_video, write_picture, write_video
from vo.tools.markers.boards import (
    CharucoBoard,
    GridBoard,
    check_length,
    make_charuco,
    make_grid,
)
from vo.tools.markers.body import MarkerBody
from vo.tools.markers.consistency import consistent
from vo.tools.markers.detection import MIN_SIDE_PX, MarkerDetector, Refinement, make_detector
from vo.tools.markers.image_markers import FrameMarkers
from vo.tools.markers.marker_map import read_marker_map
from vo.tools.markers.patterns import square_colour
from vo.tools.markers.picture import draw_markers
from vo.tools.markers.printing import parse_ids, save_grid, save_sheet
from vo.tools.markers.search import MarkerFinder, find_too_small
from vo.tools.markers.table import frame_record, write_csv

if TYPE_CHECKING:
    from vo.cli.markers import Request

_log = logging.getLogger(__name__)
_FRAMES_FOR_AUTO = 12  # in which the dictionary is searched, spread over the recording


@dataclass(frozen=True, eq=False)
class MarkersResult:
    """What was found; `dictionary` is None where `auto` has found none."""

    source: str
    dictionary: str | None
    length_m: float | None
    frames: tuple[FrameMarkers, ...]
    written: tuple[Path, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "source": self.source,
            "dictionary": self.dictionary,
            "length_m": self.length_m,
            "frames": [frame_record(frame) for frame in self.frames],
            "files": [str(path) for path in self.written],
        }


def write_sheet(request: Request, *, is_json: bool) -> None:
    """Write markers or a board to print; raises `VoError`."""
    path, length_m = request.sheet, request.length
    assert path is not None
    refuse_existing([path], force=request.force)
    name = dictionary_name(request.dictionary)
    name = DEFAULT_TO_PRINT if name == AUTO else name
    board = _board(request, name)
    if isinstance(board, MarkerBody):
        raise ConfigError("--print makes sheets and boards; print the markers of a body by --ids")
    if board is not None and request.ids != "0":
        raise ConfigError("--ids belongs to single markers; a board has those from 0 on")
    if isinstance(board, CharucoBoard):
        save_board(path, board.board)
        numbers = list(range((board.board.columns + 1) * (board.board.rows + 1) // 2))
        length_m, what = board.board.marker_m, f"{board.board} with markers"
    elif board is not None:
        save_grid(path, name, board)
        numbers = list(range(board.columns * board.rows))
        length_m, what = board.length_m, f"grid of {board.columns} x {board.rows} markers"
    else:
        if length_m is None:
            raise ConfigError("--print needs --length, the side of the black square, such as 0.16")
        numbers = parse_ids(request.ids)
        save_sheet(path, name, numbers, length_m)
        what = counted(len(numbers), "marker")
    if is_json:
        echo_json({"output": str(path), "dictionary": name, "ids": numbers, "length_m": length_m})
        return
    size = f"{what} of {name}, {1000 * length_m:g} mm"
    colour = square_colour(name)
    echo(f"{path}: {size}; print at 100 % and measure the {colour} square", err=True)


def run_request(request: Request, console: Console) -> MarkersResult:
    """Find the markers; raises `VoError`."""
    if request.length is not None:
        check_length(request.length)
    if request.picture is not None:
        check_picture(request.picture)
    name = dictionary_name(request.dictionary)
    is_image = _is_image(request.target)
    read = [Path(request.target), request.reading.calibration]
    if is_image and ":" in request.target:
        read.append(Path(request.target.rpartition(":")[0]))
    read.append(request.board.body)
    refuse_to_overwrite(read, [request.picture, request.video, request.csv])
    if request.video is not None:
        check_video(request.video)
        if is_image:
            raise ConfigError("--video is of a recording; of an image give --picture")
    work = _find_in_image if is_image else _find_in_recording
    return work(request, name, console)


def _is_image(source: str) -> bool:
    path = Path(source)
    has_number = not path.exists() and source.rpartition(":")[2].isdigit()
    has_suffix = path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir() and "*" not in source
    return has_number or has_suffix


def _find_in_image(request: Request, name: str, console: Console) -> MarkersResult:
    given = read_single_image(request.target)
    image, camera = given.image, given.camera
    height, width = image.shape
    if request.reading.calibration is not None:
        camera = read_calibration(request.reading.calibration, (width, height)).rig.cam0
    camera = _checked_camera(camera, request, (width, height))
    detector = make_detector(name, Refinement(request.refinement.value), [image], request.target)
    if detector is None:
        _explain_nothing(image, name, None)
        return MarkersResult(request.target, None, request.length, (), ())
    finder = _finder(request, detector, camera)
    frame = finder.find(image)
    if not frame.markers:
        _explain_nothing(image, name, detector)
    return _finished(request, detector.name, [frame], image, camera)


def _find_in_recording(request: Request, name: str, console: Console) -> MarkersResult:
    recording, is_calibrated = open_one_camera(request.target, request.reading)
    camera = recording.rig.cam0 if is_calibrated else None
    start, end, stride = request.frames.start, request.frames.end, request.frames.stride
    stop = len(recording) if end is None else min(end, len(recording))
    step = max(1, (stop - start) // _FRAMES_FOR_AUTO)
    few = (frame.image0 for frame in recording.frames(start, stop, step))
    detector = make_detector(name, Refinement(request.refinement.value), few, request.target)
    if detector is None:
        _log.warning("%s shows no marker of any dictionary in a sample of frames", request.target)
        return MarkersResult(request.target, None, request.length, (), ())
    size = (recording.rig.cam0.width, recording.rig.cam0.height)
    camera = _checked_camera(camera, request, size)
    finder = _finder(request, detector, camera)
    found: list[FrameMarkers] = []
    image: Bytes | None = None
    with counting(console, recording.name, max(len(range(start, stop, stride)), 1)) as count:
        for frame in recording.frames(start, stop, stride):
            count(str(frame.index))
            found.append(finder.find(frame.image0, frame.index, frame.stamp_ns))
            if len(found[-1].markers) > max((len(f.markers) for f in found[:-1]), default=-1):
                image = frame.image0
    if not any(frame.markers for frame in found):
        _log.warning("%s shows no marker of %s", request.target, detector.name)
    kept = consistent(found)
    if request.video is not None:
        by_frame = {frame.frame_index: frame for frame in kept}
        pictures = (
            draw_markers(frame.image0, by_frame[frame.index], camera, _axis_m(request))
            for frame in recording.frames(start, stop, stride)
            if frame.index in by_frame
        )
        write_video(request.video, pictures, np.array([frame.stamp_ns for frame in kept]))
    return _finished(request, detector.name, kept, image, camera)


def _axis_m(request: Request) -> float:
    """Length of the axes in pictures."""
    board = request.board
    return request.length or (0.05 if board.board is None else board.square)


def _finished(
    request: Request,
    name: str,
    frames: list[FrameMarkers],
    image: Bytes | None,
    camera: Camera | None,
) -> MarkersResult:
    """Warnings, files, and the result; the image is of the first frame with most markers."""
    _warn(frames)
    written = []
    if request.picture is not None and image is not None:
        most = max(frames, key=lambda frame: len(frame.markers))
        write_picture(request.picture, draw_markers(image, most, camera, _axis_m(request)))
        written.append(request.picture)
    if request.video is not None:
        written.append(request.video)
    if request.csv is not None:
        write_csv(request.csv, frames)
        written.append(request.csv)
    return MarkersResult(request.target, name, request.length, tuple(frames), tuple(written))


def _finder(request: Request, detector: MarkerDetector, camera: Camera | None) -> MarkerFinder:
    return MarkerFinder(detector, request.length, camera, _board(request, detector.name))


def _board(request: Request, dictionary: str) -> GridBoard | CharucoBoard | MarkerBody | None:
    wanted, length_m = request.board, request.length
    if wanted.body is not None:
        if wanted.board is not None:
            raise ConfigError("--board and --body exclude each other; give one")
        return MarkerBody(read_marker_map(wanted.body))
    columns, rows = wanted.columns, wanted.rows
    if wanted.board is None:
        return None
    if wanted.board == "grid":
        if length_m is None:
            raise ConfigError("--board grid needs --length, the side of a marker")
        return make_grid(columns, rows, length_m, wanted.gap, dictionary)
    marker_m = length_m or 0.75 * wanted.square
    return CharucoBoard(make_charuco(columns, rows, wanted.square, marker_m, dictionary))


def _checked_camera(
    camera: Camera | None, request: Request, size: tuple[int, int]
) -> Camera | None:
    if camera is None:
        wanted = request.board
        if request.length is not None or wanted.board is not None or wanted.body is not None:
            _log.warning(
                "%s has no calibration: ids and corners are found, but no poses; give "
                "--calibration FILE",
                request.target,
            )
        return None
    if (camera.width, camera.height) != size:
        raise CalibrationError(
            f"the calibration is for images of {camera.width} x {camera.height}, and those of "
            f"{request.target} are {size[0]} x {size[1]}"
        )
    return camera


def _explain_nothing(image: Bytes, name: str, detector: MarkerDetector | None) -> None:
    """Say why there may be no marker."""
    detectors = [MarkerDetector(each, is_strict=True) for each in CANDIDATES]
    for each in detectors if detector is None else [detector]:
        small = find_too_small(each, image)
        if small is not None:
            _log.warning(
                "marker %d of %s is too small, %.0f px wide; go nearer, or use a larger image or "
                "marker",
                small.id,
                each.name,
                small.side_px,
            )
            return
    what = "any dictionary" if name == AUTO else name
    _log.warning("no marker of %s is visible; a marker needs a white margin around it", what)


def _warn(frames: list[FrameMarkers]) -> None:
    repeated = [(frame.frame_index, n) for frame in frames for n in frame.repeated_ids]
    if repeated:
        first, number = repeated[0]
        _log.warning(
            "marker %d is seen more than once in frame %d%s: give each marker an id of its own",
            number,
            first,
            f" and in {counted(len(repeated) - 1, 'other case')}" if len(repeated) > 1 else "",
        )
    small = [m for frame in frames for m in frame.markers if m.detected.side_px < MIN_SIDE_PX]
    if small:
        _log.warning(
            "%s below %.0f px: these poses are uncertain",
            counted(len(small), "view") + " of markers",
            MIN_SIDE_PX,
        )
