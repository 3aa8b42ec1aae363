"""What `vo recognize` does: a database is changed or listed, or objects are searched."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
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
from vo.recordings.sources.listing import IMAGE_SUFFIXES, list_images
from vo.recordings.sources.single_image import read_single_image
from vo.tools.drawing import check_picture, check_video, write_video
from vo.tools.objects.database import DETECTOR, ObjectDatabase
from vo.tools.objects.picture import draw_objects, write_objects_picture
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
    "learn": "vo recognize learn NAME RUN",
    "list": "vo recognize list",
    "remove": "vo recognize remove NAME",
    "find": "vo recognize find IMAGE…, or find RECORDING",
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
    elif request.action == "learn":
        _learn(request)
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
    few = {"add": 2, "learn": 2, "list": 0, "remove": 1, "find": 1}[request.action]
    if count < few or (count > few and request.action not in ("add", "find")):
        raise ConfigError(f"{count} words after {request.action}; give {_USAGE[request.action]}")
    for name, given, action in (
        ("--width", request.width, "add"),
        ("--radius", request.radius, "learn"),
        ("--detector", request.detector, "learn" if request.action == "learn" else "add"),
    ):
        if given is not None and request.action != action:
            raise ConfigError(f"{name} belongs to `{_USAGE[action]}`")
    of_find = {
        "--picture": request.picture,
        "--video": request.video,
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
    database = _database(request)
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


def _learn(request: Request) -> None:
    name, run = request.words
    database = _database(request)
    with counting(request.printing.errors, run, 0) as step:
        made = database.learn(name, Path(run), radius=request.radius, step=step)
    database.save(request.database)
    assert made.solid is not None
    size = " x ".join(f"{side:.3g}" for side in np.ptp(made.solid.box, axis=0))
    unit = " m" if made.solid.is_metric else ", without a unit: poses need a run in metres"
    text = f"learned {name}: {made.features} features of {made.images} views, {size}{unit}"
    _report(request, database, text)


def _database(request: Request) -> ObjectDatabase:
    """The database to add to, which may be a new one."""
    if not request.database.exists():
        return ObjectDatabase(request.detector or DETECTOR)
    database = ObjectDatabase.load(request.database)
    if request.detector not in (None, database.detector):
        raise ConfigError(
            f"{request.database} has features of {database.detector}, not {request.detector}; "
            "leave --detector out, or give another --database"
        )
    return database


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
            sides = f"sides {record['sides']}" if each.parts else "solid"
            echo(
                f"{each.name}: {record['features']} features, images {each.images}, {sides}{width}"
            )

    request.printing.show(lambda: _database_record(request.database, database), text)


class _Source(NamedTuple):
    """What was found in one image or recording."""

    name: str
    frames: list[FrameObjects]
    tracks: list[Track]


def _find(request: Request) -> bool:
    outputs = [request.picture, request.video, request.csv]
    inputs = [*map(Path, request.words), request.database, request.reading.calibration]
    refuse_to_overwrite(inputs, outputs)
    if request.picture is not None:
        check_picture(request.picture)
    if request.video is not None:
        check_video(request.video)
    database = ObjectDatabase.load(request.database)
    if not len(database):
        raise InputError(
            f"{request.database} has no objects; add some with `vo recognize add NAME IMAGE`"
        )
    sources: list[_Source] = []
    best: tuple[Bytes, FrameObjects] | None = None
    with request.printing.warnings():
        for target in _targets(request):
            source, image, most = _find_in(request, target, database)
            sources.append(source)
            if best is None or len(most.found) > len(best[1].found):
                best = image, most
    if request.picture is not None and best is not None:
        write_objects_picture(request.picture, best[0], best[1].found, best[1].tracks)
    if request.video is not None:
        _write_video(request, request.video, sources[0].frames)
    if request.csv is not None:
        _write(request.csv, csv_text([(each.name, each.frames) for each in sources]))
    _show(request, sources)
    return any(source.tracks for source in sources)


def _targets(request: Request) -> list[str]:
    """The images and recordings to search; of a folder among several each image."""
    if len(request.words) == 1:
        return request.words
    if request.video is not None:
        raise ConfigError("--video is of one recording")
    targets: list[str] = []
    for word in request.words:
        is_folder = Path(word).is_dir()
        targets += [str(path) for path in list_images(Path(word))] if is_folder else [word]
    return targets


def _find_in(
    request: Request, target: str, database: ObjectDatabase
) -> tuple[_Source, Bytes, FrameObjects]:
    """What one of them shows, and the frame with most objects."""
    tracker = ObjectTracker()
    frames: list[FrameObjects] = []
    best: tuple[Bytes, FrameObjects] | None = None
    with _images(request, target, request.printing.errors) as images:
        for number, stamp_ns, image, camera in images:
            found = database.find(image, camera, request.min_confidence)
            tracks = tracker.update(number, found)
            frames.append(FrameObjects(number, stamp_ns, found, tracks))
            if best is None or len(found) > len(best[1].found):
                best = image, frames[-1]
    if best is None:
        raise InputError(f"{target} has no frame to search; check --start, --end and --stride")
    return _Source(target, frames, list(tracker.tracks)), *best


def _write_video(request: Request, path: Path, frames: Sequence[FrameObjects]) -> None:
    """The recording with outlines and names in all frames."""
    if frames[0].stamp_ns is None:
        raise ConfigError("--video is of a recording; of an image give --picture")
    found = {frame.frame: frame for frame in frames}
    with _images(request, request.words[0], request.printing.errors) as images:
        pictures = (
            draw_objects(image, found[number].found, found[number].tracks)
            for number, _, image, _ in images
            if number in found
        )
        write_video(path, pictures, np.array([frame.stamp_ns for frame in frames]))


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with complete_file(path) as file:
            file.write(text.encode())
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


_Image = tuple[int, int | None, Bytes, Camera | None]


@contextmanager
def _images(request: Request, target: str, errors: Any) -> Iterator[Iterator[_Image]]:
    """Number, time, pixels and camera of the images to search."""
    path = Path(target)
    is_frame = not path.exists() and ":" in path.name
    if is_frame or (path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir()):
        yield iter([_single(request, target)])
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


def _single(request: Request, target: str) -> _Image:
    given = read_single_image(target)
    camera = given.camera
    if request.reading.calibration is not None:
        height, width = given.image.shape
        camera = read_calibration(request.reading.calibration, (width, height)).rig.cam0
        check_cameras((camera, camera), (given.image, given.image), (given.name, given.name))
    return 0, None, given.image, camera


def _show(request: Request, sources: Sequence[_Source]) -> None:
    written = {"picture": request.picture, "video": request.video, "csv": request.csv}
    records = {"database": str(request.database)} | {
        name: None if path is None else str(path) for name, path in written.items()
    }

    def record() -> dict[str, Any]:
        found = [_source_record(source) for source in sources]
        return (found[0] if len(request.words) == 1 else {"sources": found}) | records

    def text() -> None:
        for source in sources:
            _print(source, is_one=len(sources) == 1)
        for path in filter(None, written.values()):
            echo(str(path))

    request.printing.show(record, text)


def _source_record(source: _Source) -> dict[str, Any]:
    return {
        "source": source.name,
        "frames": [frame_record(frame) for frame in source.frames],
        "tracks": [track_record(track) for track in source.tracks],
    }


def _print(source: _Source, *, is_one: bool) -> None:
    console = standard_output()
    frames, tracks = source.frames, source.tracks
    if not tracks:
        console.print(f"no known object in {escape(source.name)}", soft_wrap=True)
    elif not is_one:
        console.print(escape(source.name), soft_wrap=True)
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
