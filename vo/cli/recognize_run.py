"""What `vo recognize` does: a database is changed or listed, or objects are searched."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from vo.base.errors import ConfigError, InputError, OutputError
from vo.base.files.complete_file import complete_file
from vo.base.types import Bytes, Camera
from vo.cli.console import standard_output
from vo.cli.echo import echo
from vo.cli.opening import open_one_camera
from vo.cli.progress import counting
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.sources.listing import IMAGE_SUFFIXES
from vo.recordings.sources.single_image import read_single_image
from vo.tools.drawing import check_picture
from vo.tools.objects.database import DETECTOR, ObjectDatabase
from vo.tools.objects.picture import write_objects_picture
from vo.tools.objects.tables import (
    FrameObjects,
    csv_text,
    frame_record,
    object_record,
    track_record,
)
from vo.tools.objects.tracks import ObjectTracker, Track
from vo.tools.pairs.pair_options import check_cameras

if TYPE_CHECKING:
    from vo.cli.recognize import Request

_USAGE = {
    "add": "vo recognize add NAME IMAGE…",
    "list": "vo recognize list",
    "remove": "vo recognize remove NAME",
    "find": "vo recognize find IMAGE, or find RECORDING",
}


def run_request(request: Request) -> bool:
    """Do what the action says; returns whether something was found, or true.

    Raises:
        VoError: the words or options do not fit the action, or an input cannot be used.
    """
    _check(request)
    if request.action == "find":
        return _find(request)
    if request.action == "add":
        _add(request)
    elif request.action == "remove":
        database = ObjectDatabase.load(request.database)
        database.remove(request.words[0])
        database.save(request.database)
        _report(request, database, f"removed {request.words[0]}")
    else:
        _list(request, ObjectDatabase.load(request.database))
    return True


def _check(request: Request) -> None:
    count = len(request.words)
    allowed = {"add": count >= 2, "list": count == 0, "remove": count == 1, "find": count == 1}
    if not allowed[request.action]:
        raise ConfigError(f"{count} words after {request.action}; give {_USAGE[request.action]}")
    for name, given in (("--width", request.width), ("--detector", request.detector)):
        if given is not None and request.action != "add":
            raise ConfigError(f"{name} belongs to `{_USAGE['add']}`")
    of_find = {
        "--picture": request.picture,
        "--csv": request.csv,
        "--calibration": request.reading.calibration,
        "--format": request.reading.format,
    }
    for name, value in of_find.items():
        if value is not None and request.action != "find":
            raise ConfigError(f"{name} belongs to `{_USAGE['find']}`")


def _add(request: Request) -> None:
    name, *paths = request.words
    refuse_to_overwrite([Path(path) for path in paths], [request.database])
    if request.database.exists():
        database = ObjectDatabase.load(request.database)
        if request.detector not in (None, database.detector):
            raise ConfigError(
                f"{request.database} has features of {database.detector}, not {request.detector}; "
                "leave --detector out, or give another --database"
            )
    else:
        database = ObjectDatabase(request.detector or DETECTOR)
    images = [read_single_image(path) for path in paths]
    added = database.add(
        name,
        [each.image for each in images],
        width_m=request.width,
        image_names=[each.name for each in images],
    )
    database.save(request.database)
    record = object_record(added)
    _report(
        request,
        database,
        f"added {name}: {record['features']} features of {record['sides']} "
        f"{'side' if record['sides'] == 1 else 'sides'}",
    )


def _report(request: Request, database: ObjectDatabase, text: str) -> None:
    count = len(database)
    line = f"{text}; {request.database} has {count} {'object' if count == 1 else 'objects'}"
    request.printing.show(lambda: _database_record(request.database, database), lambda: echo(line))


def _database_record(path: Path, database: ObjectDatabase) -> dict[str, Any]:
    return {
        "database": str(path),
        "detector": database.detector,
        "objects": [object_record(each) for each in database.objects],
    }


def _list(request: Request, database: ObjectDatabase) -> None:
    def text() -> None:
        echo(f"{request.database}: {len(database)} objects, features of {database.detector}")
        for each in database.objects:
            record = object_record(each)
            width = "" if record["width_m"] is None else f", {record['width_m']:.3g} m wide"
            echo(
                f"{each.name}: {record['features']} features, images {each.images}, "
                f"sides {record['sides']}{width}"
            )

    request.printing.show(lambda: _database_record(request.database, database), text)


def _find(request: Request) -> bool:
    target = request.words[0]
    inputs = [Path(target), request.database, request.reading.calibration]
    refuse_to_overwrite(inputs, [request.picture, request.csv])
    if request.picture is not None:
        check_picture(request.picture)
    database = ObjectDatabase.load(request.database)
    if not len(database):
        raise InputError(
            f"{request.database} has no objects; add some with `vo recognize add NAME IMAGE`"
        )
    tracker = ObjectTracker()
    frames: list[FrameObjects] = []
    best: tuple[int, Bytes, FrameObjects] | None = None
    with request.printing.warnings(), _images(request, request.printing.errors) as images:
        for number, stamp_ns, image, camera in images:
            found = database.find(image, camera, request.min_confidence)
            tracks = tracker.update(number, found)
            frames.append(FrameObjects(number, stamp_ns, found, tracks))
            if best is None or len(found) > best[0]:
                best = len(found), image, frames[-1]
    if best is None:
        raise InputError(f"{target} has no frame to search; check --start, --end and --stride")
    if request.picture is not None:
        write_objects_picture(request.picture, best[1], best[2].found, best[2].tracks)
    if request.csv is not None:
        _write(request.csv, csv_text(frames))
    _show(request, frames, tracker.tracks)
    return bool(tracker.tracks)


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with complete_file(path) as file:
            file.write(text.encode())
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


_Image = tuple[int, int | None, Bytes, Camera | None]


@contextmanager
def _images(request: Request, errors: Any) -> Iterator[Iterator[_Image]]:
    """Number, time, pixels and camera of the images to search."""
    path = Path(request.words[0])
    is_frame = not path.exists() and ":" in path.name
    if is_frame or (path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir()):
        yield iter([_single(request)])
        return
    recording, is_calibrated = open_one_camera(path, request.reading)
    first, last, stride = request.frames.start, request.frames.end, request.frames.stride
    camera = recording.rig.cam0 if is_calibrated else None
    total = len(range(first, min(len(recording), last or len(recording)), stride))
    with counting(errors, recording.name, total) as step:

        def read() -> Iterator[_Image]:
            for frame in recording.frames(first, last, stride):
                step(f"frame {frame.index}")
                yield frame.index, frame.stamp_ns, frame.image0, camera

        yield read()


def _single(request: Request) -> _Image:
    given = read_single_image(request.words[0])
    camera = given.camera
    if request.reading.calibration is not None:
        height, width = given.image.shape
        camera = read_calibration(request.reading.calibration, (width, height)).rig.cam0
        check_cameras((camera, camera), (given.image, given.image), (given.name, given.name))
    return 0, None, given.image, camera


def _show(request: Request, frames: Sequence[FrameObjects], tracks: Sequence[Track]) -> None:
    request.printing.show(
        lambda: {
            "source": request.words[0],
            "database": str(request.database),
            "frames": [frame_record(frame) for frame in frames],
            "tracks": [track_record(track) for track in tracks],
            "picture": None if request.picture is None else str(request.picture),
            "csv": None if request.csv is None else str(request.csv),
        },
        lambda: _print(request, frames, tracks),
    )


def _print(request: Request, frames: Sequence[FrameObjects], tracks: Sequence[Track]) -> None:
    console = standard_output()
    if not tracks:
        console.print(f"no known object in {escape(request.words[0])}", soft_wrap=True)
    if frames[0].stamp_ns is None:
        for each in frames[0].found:
            where = ""
            if each.cam_from_object is not None:
                x, y, z = each.cam_from_object[:3, 3].tolist()
                where = f", at x {x:+.3f}, y {y:+.3f}, z {z:.3f} m"
            text = f"confidence {each.confidence:.3f}, {each.inliers} inliers{where}"
            console.print(f"[bold]{escape(each.name)}[/]: {text}", soft_wrap=True)
    else:
        for track in tracks:
            text = (
                f"{track.frames} of {len(frames)} frames, {track.first} to {track.last}, "
                f"confidence up to {track.confidence:.3f}"
            )
            console.print(f"[bold]{escape(track.name)}[/] ({track.id}): {text}", soft_wrap=True)
    for path in (request.picture, request.csv):
        if path is not None:
            console.print(escape(str(path)), soft_wrap=True)
