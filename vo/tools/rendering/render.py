"""A video of a recording with a model in it, drawn with the poses of a run."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import ConfigError, OutputError, SourceError
from vo.base.geometry.transforms import inverse, make_transform, rotation_from_quat_xyzw
from vo.base.types import Bytes, Camera, Floats, with_image0
from vo.outputs.report.run_folder import RunRecord, read_run
from vo.recordings.formats.mesh import Mesh, read_mesh
from vo.recordings.sources.source import Recording
from vo.tools.drawing import is_video, write_video
from vo.tools.rendering.rasterizer import draw, shading
from vo.tools.reopening import FramePose, poses_of, recording_of

_AXIS_WIDTH = 0.06  # of axes, relative to their length
_AXIS_COLOURS = ((213, 94, 0), (0, 158, 115), (0, 114, 178))  # x, y, z
_UP: dict[str, Floats] = {
    # World (y down) from model, for the axis of the model that points up.
    "y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.eye(3),
}

_Z_UP_FROM_Y_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class ModelPose:
    """Where a model stands."""

    foot: Floats  # (3,) middle of its underside in the world
    size: float | None = None  # its largest extent there, None for its own
    up: str = "y"  # axis of the model that points up: `y`, `z` or `-y`
    world_up: str = "-y"  # axis of the world that points up: `z` where gravity is known, else `-y`
    world_from_marker: Floats | None = None  # (4, 4) of a marker that it stands on


def axes() -> Mesh:
    """Axes x, y and z of unit length in red, green and blue, as bars."""
    vertices, triangles, rgb = [], [], []
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    for axis in range(3):
        size = np.full(3, _AXIS_WIDTH)
        size[axis] = 1.0
        first = 8 * axis
        vertices.append((corners - 0.5 * (np.arange(3) != axis)) * size)
        for a, b, c, d in quads:
            triangles += [[first + a, first + b, first + c], [first + a, first + c, first + d]]
        rgb += [_AXIS_COLOURS[axis]] * 8
    return Mesh(np.concatenate(vertices), np.array(triangles, np.int64), np.array(rgb, np.uint8))


def standing(mesh: Mesh, model_pose: ModelPose) -> Floats:
    """Vertices (V, 3) of a model on the origin, y down."""
    vertices = mesh.vertices @ _UP[model_pose.up].T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = float((high - low).max())
    factor = 1.0 if model_pose.size is None or extent == 0.0 else model_pose.size / extent
    foot = np.array([0.5 * (low[0] + high[0]), high[1], 0.5 * (low[2] + high[2])])
    return np.asarray((vertices - foot) * factor)


def posed(vertices: Floats, model_pose: ModelPose) -> Floats:
    """A standing model (V, 3) at its place in the world."""
    if model_pose.world_from_marker is not None:
        marker = model_pose.world_from_marker  # with z out of it
        return np.asarray(vertices @ _Z_UP_FROM_Y_DOWN.T @ marker[:3, :3].T + marker[:3, 3])
    if model_pose.world_up == "z":
        vertices = vertices @ _Z_UP_FROM_Y_DOWN.T
    return np.asarray(vertices + model_pose.foot)


PICTURES = (".png", ".jpg", ".jpeg")
_DISTANCE_RATIO = 0.25  # of the path, from the first camera to the model by default
_SIZE_RATIO = 0.2  # of the distance, of a model without a size
_BELOW_RATIO = 0.15  # of the distance, of the foot below the axis of the camera


@dataclass(frozen=True)
class RenderOptions:
    """Where the model stands, and which frames are drawn.

    Attributes:
        at: position of its foot in the world of the run, None for a place in front of a camera.
        in_front: number of the frame, and distance; None for the first frame and a quarter of the
            length of the path.
        size: largest extent, None for that of a fifth of the distance.
        up: axis of the model that points up: `y`, `z` or `-y`.
        frame: the only frame to draw, None for all.
        on_marker: id of the marker of the run that it stands on, upright on its plane.
    """

    at: tuple[float, float, float] | None = None
    in_front: tuple[int, float] | None = None
    size: float | None = None
    up: str = "y"
    frame: int | None = None
    on_marker: int | None = None


class Rendered(NamedTuple):
    """What was drawn.

    Attributes:
        at: position of its foot in the world.
    """

    output: Path
    frames: int
    with_model: int
    at: tuple[float, float, float]
    unit: str


def render(
    run: str | Path,
    output: str | Path,
    model: str | Path | None = None,
    options: RenderOptions = RenderOptions(),
) -> Rendered:
    """Draw a model into the images of a run's recording.

    Args:
        run: folder of the run; its recording must be where it was.
        output: video (.mp4), or picture (.png, .jpg) of one frame.
        model: mesh as .ply or .obj, None for axes.
        options: where it stands.

    Raises:
        SourceError: the run, its recording or the model is missing or damaged.
        ConfigError: a position or frame cannot be.
        OutputError: the output cannot be written.
    """
    folder, target = Path(run), Path(output)
    is_picture = target.suffix.lower() in PICTURES
    if not is_picture and not is_video(target):
        raise ConfigError(f"{target} is neither a video (.mp4) nor a picture (.png, .jpg)")
    mesh = axes() if model is None else read_mesh(Path(model))
    record = read_run(folder)
    poses = poses_of(record)
    stream = recording_of(record)
    if options.on_marker is None:
        model_pose, segment = _model_pose(poses, options, record)
    else:
        model_pose, segment = _on_marker(folder, options.on_marker, options)
    frames = sorted(poses) if options.frame is None else [options.frame]
    if options.frame is not None and options.frame not in poses:
        raise ConfigError(f"frame {options.frame} has no pose in {folder}; choose another `frame`")
    if is_picture:
        frames = frames[:1]
    painter = _Painter(mesh, model_pose, segment, stream.rig.cam0)
    images = painter.images(stream, frames, poses)
    if is_picture:
        count = _write_picture(target, images)
    else:
        count = write_video(target, images, stream.stamps_ns)
    if not count:
        raise SourceError("no image of the recording can be read")
    x, y, z = (float(value) for value in model_pose.foot)
    return Rendered(target, count, painter.with_model, (x, y, z), record.unit)


def _model_pose(
    poses: dict[int, FramePose], options: RenderOptions, record: RunRecord
) -> tuple[ModelPose, int]:
    """Where the model stands, and the segment whose world that is."""
    first = min(poses)
    frame, distance = options.in_front or (first, _DISTANCE_RATIO * _path_length(poses, first))
    if frame not in poses:
        raise ConfigError(f"frame {frame} has no pose; give another one by `in_front`")
    if not 0.0 < distance < np.inf:
        raise ConfigError(f"a model {distance:g} in front of the camera cannot be seen; give `at`")
    if options.size is not None and not 0.0 < options.size < np.inf:
        raise ConfigError(f"`size` is {options.size:g}; give a length above 0")
    _, segment, world_from_cam, _ = poses[frame]
    foot = world_from_cam[:3, :3] @ (0.0, _BELOW_RATIO * distance, distance) + world_from_cam[:3, 3]
    if options.at is not None:
        foot = np.array(options.at)
        distance = float(np.linalg.norm(foot - world_from_cam[:3, 3])) or distance
    size = _SIZE_RATIO * distance if options.size is None else options.size
    inertial = record.summary.get("inertial") or {}
    world_up = "z" if segment in inertial.get("metric_worlds", ()) else "-y"
    return ModelPose(foot, size, options.up, world_up), segment


def _on_marker(folder: Path, number: int, options: RenderOptions) -> tuple[ModelPose, int]:
    """A model on a marker of markers.csv, by default as large as its side, and its segment."""
    if options.at is not None or options.in_front is not None:
        raise ConfigError("a model on a marker has its place; leave `at` and `in_front` out")
    path = folder / "markers.csv"
    try:
        rows = list(csv.DictReader(path.read_text("utf-8").splitlines()))
        known = {int(row["id"]): row for row in reversed(rows)}
        if number not in known:
            listed = ", ".join(map(str, sorted(known))) or "none"
            raise ConfigError(f"{path} has no marker {number}; its markers are {listed}")
        row = known[number]
        quat = np.array([float(row[f"q{axis}"]) for axis in "xyzw"])
        place = np.array([float(row[f"t{axis}"]) for axis in "xyz"])
        length_m, segment = float(row["length_m"]), int(row["segment"])
    except (OSError, ValueError, KeyError) as error:
        raise SourceError(
            f"{path} cannot be read: {error}; `vo run … --markers METRES` writes it"
        ) from error
    world_from_marker = make_transform(rotation_from_quat_xyzw(quat), place)
    size = length_m if options.size is None else options.size
    return ModelPose(place, size, options.up, world_from_marker=world_from_marker), segment


def _path_length(poses: dict[int, FramePose], first: int) -> float:
    """Length of the path of the first frame's segment."""
    segment = poses[first].segment
    chosen = [poses[n].world_from_cam0[:3, 3] for n in sorted(poses) if poses[n].segment == segment]
    return float(np.linalg.norm(np.diff(chosen, axis=0), axis=1).sum()) if len(chosen) > 1 else 0.0


class _Painter:
    """Draws a model into images; those of other segments stay as they are."""

    def __init__(self, mesh: Mesh, model_pose: ModelPose, segment: int, camera: Camera) -> None:
        self.with_model = 0
        self._mesh, self._segment, self._camera = mesh, segment, camera
        vertices = standing(mesh, model_pose)
        self._vertices = posed(vertices, model_pose)
        self._shade = shading(vertices, mesh.triangles)

    def images(
        self, stream: Recording, frames: Sequence[int], poses: dict[int, FramePose]
    ) -> Iterator[Bytes]:
        """Images of frames with a pose, with the model."""
        step = min(np.diff(frames).tolist(), default=1)
        for frame in with_image0(stream.frames(frames[0], frames[-1] + 1, step, images="colour")):
            if frame.index not in poses:
                continue
            image = frame.image0
            if image.ndim == 2:
                image = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
            yield self._painted(image, poses[frame.index])

    def _painted(self, image: Bytes, pose: FramePose) -> Bytes:
        if pose.segment != self._segment:
            return image
        cam_from_world = inverse(pose.world_from_cam0)
        in_cam = self._vertices @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        mesh = self._mesh
        result = draw(image, self._camera, in_cam, mesh.triangles, mesh.rgb, self._shade)
        self.with_model += result is not image and not np.array_equal(result, image)
        return result


def _write_picture(path: Path, images: Iterator[Bytes]) -> int:
    image = next(images, None)
    if image is None:
        raise SourceError("the image of the frame cannot be read; choose another `frame`")
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image):
        raise OutputError(f"{path} cannot be written; choose another `output`")
    return 1
