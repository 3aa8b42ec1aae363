"""Joins the depths of all keyframes of a run, and writes what comes of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.errors import ConfigError, SourceError
from vo.base.extras import require
from vo.base.files.complete_file import complete_file, writing
from vo.base.geometry.transforms import transform_points
from vo.base.types import Bytes, Floats, Floats32, Ints
from vo.outputs.report.run_folder import RunRecord
from vo.tools.dense import files
from vo.tools.dense.agreement import confirmed
from vo.tools.dense.cloud import CubeCloud
from vo.tools.dense.depth import MAX_ERROR
from vo.tools.dense.ground import Grid, OccupancyGrid, find_ground
from vo.tools.dense.keyframes import KeyframeImages, RunKeyframes
from vo.tools.dense.posed_images import PosedImages
from vo.tools.dense.store import DepthStore
from vo.tools.dense.surface import DistanceField
from vo.tools.drawing import write_picture

if TYPE_CHECKING:
    from vo.outputs.recorders.dense_recording import DenseRecording

NEIGHBOURS = 2  # keyframes before and after each that are compared with it
WORKERS = 2  # threads
_EDGE_SHARE = 0.01  # of the median depth, the edge of a cube of the cloud
_METRES, _CELL_M, _BAND_M = "m", 0.05, (0.15, 1.8)
_TYPICAL_STEP = 4  # pixels between those whose medians are taken
_GRID_STEP = 2  # pixels between those that a grid is made of


@dataclass(frozen=True)
class DenseOptions:
    """What is made, and how; lengths in the unit of the run.

    Attributes:
        edge: of the cubes of the cloud and the voxels of the mesh, None for about a percent of the
            median depth.
        far: farthest depth, None for where the standard deviation of a single one is 2.2 percent.
        segment: number of the segment, None for the one with most keyframes.
        mesh: whether to make a mesh.
        grid: whether to make a grid.
        cell: edge of its cells, None for 5 cm, or twice `edge` without metres.
        band: heights above the ground between which something is an obstacle, None for 0.15 to 1.8
            m, or a tenth of the camera's height to all of it without metres.
        depth: whether to write the depth of each keyframe, too, as `depth/FRAME.tiff`.
        cloud: file (.las, .laz, .e57) for the cloud, too.
        nerfstudio: folder for undistorted images, masks, the cloud and `transforms.json`.
        colmap: folder for the same images, masks, and a model as COLMAP has it.
        rrd: file for rerun.
    """

    edge: float | None = None
    far: float | None = None
    segment: int | None = None
    mesh: bool = True
    grid: bool = True
    cell: float | None = None
    band: tuple[float, float] | None = None
    depth: bool = False
    cloud: Path | None = None
    nerfstudio: Path | None = None
    colmap: Path | None = None
    rrd: Path | None = None

    def check(self) -> None:
        """Check all values.

        Raises:
            ConfigError: one cannot be.
        """
        for name in ("edge", "far", "cell"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise ConfigError(f"`{name}` is {value:g}; give a length above 0")
        if self.band is not None and not -np.inf < self.band[0] < self.band[1] < np.inf:
            low, high = self.band
            raise ConfigError(f"`band` is {low:g} to {high:g}; give a lower and a higher height")
        if self.cloud is not None and self.cloud.suffix.lower() not in files.CLOUD_SUFFIXES:
            raise ConfigError(f"`cloud` is {self.cloud}; give a name in .las, .laz or .e57")


class Densified(NamedTuple):
    """What was made; lengths in `unit`.

    Attributes:
        keyframes: number of those with depth.
        segment: number of the segment, of `segments`.
        edge: of the cubes.
        far: farthest depth.
        coverage: share of the pixels with a depth that is confirmed.
        ground_found: whether there was enough of the ground for a plane.
    """

    output: Path
    files: tuple[str, ...]
    keyframes: int
    segment: int
    segments: int
    unit: str
    edge: float
    far: float
    coverage: float
    points: int
    triangles: int
    ground_found: bool


class Fusion:
    """A cloud, a mesh and a grid of one segment.

    Raises:
        SourceError: no keyframe shows depth.
    """

    def __init__(
        self,
        record: RunRecord,
        keyframes: RunKeyframes,
        store: DepthStore,
        options: DenseOptions,
        folder: Path,
    ) -> None:
        self._record, self._keyframes, self._store = record, keyframes, store
        self._options, self._folder = options, folder
        self._rows = [row for row in range(len(keyframes)) if store.has(row)]
        median, sigma = self._typical()
        self._far = options.far or MAX_ERROR / sigma
        self._edge = options.edge or _rounded(_EDGE_SHARE * min(median, self._far))
        self._cubes = CubeCloud(self._edge, keyframes.rig)
        self._field = DistanceField(self._edge, keyframes.rig) if options.mesh else None
        self._recording = self._opened(options.rrd)
        self._known, self._pixels = 0, 0
        self._fused: list[int] = []
        self._posed = PosedImages(keyframes.rig, options.nerfstudio, options.colmap)

    def _typical(self) -> tuple[float, float]:
        """Medians over keyframes of the depths, and of the errors of the farthest inverse ones."""
        depths, sigmas = [], []
        for row in self._rows:
            some = [each[::_TYPICAL_STEP, ::_TYPICAL_STEP] for each in self._store.load(row)]
            known = some[0][some[0] > 0]
            if len(known):
                depths.append(1.0 / float(np.median(known)))
                sigmas.append(float(np.percentile(some[1], 25)))
        if not depths:
            raise SourceError(
                f"{self._record.path}: no keyframe shows depth; the camera has to move past "
                "surfaces with texture"
            )
        return float(np.median(depths)), float(np.median(sigmas))

    def _opened(self, path: Path | None) -> DenseRecording | None:
        if path is None:
            return None
        require("rerun", "view", "recordings for rerun")
        from vo.outputs.recorders.dense_recording import DenseRecording

        rig = self._keyframes.rig
        name = f"{self._record.summary['source']}; lengths in {self._record.unit}"
        return DenseRecording(path, name, (rig.width, rig.height), rig.intrinsics, self._far)

    def add_all(self) -> Iterator[int]:
        """Add all keyframes; yields how many are done."""
        rows = iter(self._rows)
        with ThreadPoolExecutor(WORKERS) as pool:
            waiting: dict[int, Future[tuple[Floats32, Bytes]]] = {}
            for done, (row, images) in enumerate(self._keyframes.images(), start=1):
                for following in islice(rows, 2 * WORKERS - len(waiting)):
                    waiting[following] = pool.submit(self._depth_of, following)
                if row in waiting:
                    inverse, contradicted = waiting.pop(row).result()
                    self._add(images, inverse, self._store.load(row).sigma)
                    if self._options.grid:
                        some = np.ascontiguousarray(inverse[::_GRID_STEP, ::_GRID_STEP])
                        self._store.save_confirmed(row, some)
                        self._fused.append(row)
                    self._posed.add(images, contradicted)
                yield done

    def _depth_of(self, row: int) -> tuple[Floats32, Bytes]:
        """Inverse depth (H, W) that others confirm, one, or two with one camera; where they do not.

        See `confirmed`.
        """
        rig, poses, store = self._keyframes.rig, self._keyframes.world_from_cam, self._store
        near = [k for k in self._rows if 0 < abs(k - row) <= NEIGHBOURS]
        others = [(store.load(k), poses[k]) for k in near]
        views = 1 if rig.is_metric else 2
        own = store.load(row), poses[row]
        found, contradicted = confirmed(*own, others, rig.intrinsics, views)
        return np.where(found > 1.0 / self._far, found, np.float32(0)), contradicted

    def _add(self, images: KeyframeImages, inverse: Floats32, sigma: Floats32) -> None:
        pose, rgb, options = images.world_from_cam, images.rgb, self._options
        self._known += int(np.count_nonzero(inverse))
        self._pixels += inverse.size
        cubes = self._cubes.add(inverse, sigma, rgb, pose)
        if self._field is not None:
            self._field.add(inverse, rgb, pose, cubes)
        depth = np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0)
        if self._recording is not None:
            self._recording.add(images.frame, images.stamp_ns, pose, depth)
        if options.depth:
            write_picture(self._folder / "depth" / f"{images.frame:06d}.tiff", depth)

    def finish(self) -> Densified:
        """Write everything.

        Raises:
            SourceError: there is no point.
        """
        folder, options, keyframes = self._folder, self._options, self._keyframes
        cloud = self._cubes.cloud()
        if not len(cloud.xyz):
            raise SourceError(
                f"{self._record.path}: no depth is confirmed by another keyframe; the camera has "
                "to move past surfaces with texture, and see them from several places"
            )
        unit = self._record.unit
        comment = f"{self._record.summary['source']}; lengths in {unit}"
        written = [folder / "cloud.ply", *([options.cloud] if options.cloud else ())]
        for path in written:
            files.write_cloud(path, cloud, comment)
        mesh = None if self._field is None else self._field.mesh()
        if mesh is not None:
            written.append(folder / "mesh.ply")
            files.write_mesh(written[-1], mesh, comment)
        ground = find_ground(cloud, self._up(), keyframes.world_from_cam, self._edge)
        points = transform_points(ground.ground_from_world, cloud.xyz)
        centres = keyframes.world_from_cam[:, :3, 3]
        path = transform_points(ground.ground_from_world, centres)
        if options.grid:
            grid = self._grid(ground.ground_from_world, points)
            written += [*files.write_grid(folder, grid, comment), folder / "voxels.npz"]
            files.write_voxels(written[-1], points, grid.edge, ground.ground_from_world)
        written += files.write_views(folder, points, cloud.rgb, path)
        written += self._posed.finish(cloud, unit, comment)
        if self._recording is not None and options.rrd is not None:
            self._recording.finish((cloud.xyz, cloud.rgb), mesh, centres)
            written.append(options.rrd)
        counts = len(self._rows), keyframes.segment, keyframes.segments
        coverage = round(self._known / max(self._pixels, 1), 4)
        triangles = 0 if mesh is None else len(mesh.triangles)
        names = tuple(str(each) for each in written)
        lengths, sizes = (self._edge, self._far), (len(cloud.xyz), triangles)
        result = Densified(
            folder, names, *counts, unit, *lengths, coverage, *sizes, ground_found=ground.is_found
        )
        self._write_summary(result, ground.ground_from_world)
        return result

    def _write_summary(self, result: Densified, ground_from_world: Floats) -> None:
        rig = self._keyframes.rig
        size = {"width": rig.width, "height": rig.height}
        content = result._asdict() | {
            "camera": size | rig.intrinsics._asdict(),
            "ground_from_world": ground_from_world.tolist(),
            "options": asdict(self._options),
            "poses_sha256": sha256((self._record.path / "poses.csv").read_bytes()).hexdigest(),
        }
        path = self._folder / "dense.json"
        with writing(path), complete_file(path) as file:
            file.write((json.dumps(content, indent=2, default=str) + "\n").encode())

    def _up(self) -> Floats:
        """(3,) up in the world: known by an inertial sensor, or as the camera is held."""
        inertial = self._record.summary.get("inertial") or {}
        if self._keyframes.segment in inertial.get("metric_worlds", ()):
            return np.array([0.0, 0.0, 1.0])
        up = (inertial.get("states") or {}).get("up")
        if up is None or self._keyframes.segment:
            up = -self._keyframes.world_from_cam[:, :3, 1].mean(axis=0)
        return np.asarray(up, dtype=np.float64) / np.linalg.norm(up)

    def _grid(self, ground_from_world: Floats, points: Floats) -> Grid:
        """What keyframes see over the ground; `points` (N, 3) of the cloud bound it."""
        poses = [ground_from_world @ pose for pose in self._keyframes.world_from_cam]
        is_metric = self._record.unit == _METRES
        height = float(np.median([pose[2, 3] for pose in poses]))
        band = self._options.band or (_BAND_M if is_metric else (0.1 * height, height))
        cell = self._options.cell or (_CELL_M if is_metric else 2.0 * self._edge)
        path = np.array([pose[:2, 3] for pose in poses])
        margin = np.concatenate([np.percentile(points[:, :2], (0.5, 99.5), axis=0), path])
        grid = OccupancyGrid(margin.min(axis=0) - cell, margin.max(axis=0) + cell, cell, band)
        for row in self._fused:
            seen, columns = self._seen(row)
            grid.add(transform_points(poses[row], seen), columns, poses[row])
        return grid.grid()

    def _seen(self, row: int) -> tuple[Floats, Ints]:
        """Points (N, 3) in the camera of some pixels, and their columns."""
        rig, inverse = self._keyframes.rig, self._store.load_confirmed(row)
        v, u = np.nonzero(inverse)
        z = 1.0 / inverse[v, u].astype(np.float64)
        x = (u * _GRID_STEP - rig.cx) / rig.fx
        y = (v * _GRID_STEP - rig.cy) / rig.fy
        return np.column_stack([x * z, y * z, z]), u.astype(np.int64)


def _rounded(length: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten below."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))
