"""Compares clouds and meshes of `vo dense` with exact depth of recordings that it renders."""

from __future__ import annotations

import csv
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from common import EXPERIMENTS, parser_of, write_section
from scipy.spatial import cKDTree

import vo
from vo.base.geometry.transforms import inverse, make_transform, transform_points
from vo.base.types import Camera, Floats, Ints
from vo.recordings.formats.mesh import read_mesh
from vo.tools.dense.ground import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

_ROOT = Path(__file__).resolve().parents[1]
_CASES = {  # preset of the suite, seconds, and how near to the truth a point is right, in metres
    "room": ("01_room_loop", 14.0, 0.02),
    "corridor": ("03_corridor_robot", 25.0, 0.02),
    "street": ("05_street_car", 30.0, 0.1),
    "warehouse": ("07_warehouse_loop", 80.0, 0.02),
}
_SAMPLES = 100_000  # points of each kind that are compared
_POINT = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])
_HEADING = (
    "| recording | cameras | depth to, m | median, % | complete, % | outliers, % | mesh, mm |"
    " free, % | gaps | keyframes | keyframes/s |\n|---|---|---:|---:|---:|---:|---:|---:|---:|---:|"
    "---:|"
)


class Truth(NamedTuple):
    """Points of the true surfaces that keyframes see, and which keyframe."""

    xyz: Floats
    normal: Floats
    keyframe: Ints


def main() -> None:
    """Print a row for each recording, with two cameras and with one."""
    parser = parser_of("dense", __doc__, "write")
    parser.add_argument("names", nargs="*", default=list(_CASES), help=f"of {', '.join(_CASES)}")
    parser.add_argument("--folder", type=Path, default=_ROOT / "out" / "dense")
    options = parser.parse_args()
    lines = [_HEADING]
    for name in options.names:
        preset, seconds, near = _CASES[name]
        recording = options.folder / name
        if not recording.exists():
            settings = str(_ROOT / "configs" / "synth" / "suite" / f"{preset}.yaml")
            vo.synth(recording, settings, seconds=seconds, depth=True)
        far = None
        for mode in ("stereo", "mono"):
            line, far = _row(name, recording, mode, near, far)
            lines.append(line)
            print(line, flush=True)
    if options.write:
        write_section(EXPERIMENTS / "dense.md", "dense", "\n".join(lines))


def _row(
    name: str, recording: Path, mode: Any, near: float, far: float | None
) -> tuple[str, float]:
    """A line, and to which depth in metres it is; `far`: that of the line before, or None."""
    run = recording.with_name(f"{recording.name}_{mode}")
    vo.run(recording, run, mode=mode, imu=False)
    result = vo.evaluate(run, recording, align="sim3" if mode == "mono" else "se3")
    alignment = result.alignment.reference_from_estimate
    scale = alignment.scale
    began = time.perf_counter()
    done = vo.dense(
        run, options=vo.DenseOptions(depth=True, far=None if far is None else far / scale)
    )
    took_s = time.perf_counter() - began
    source: Any = vo.open(recording)
    stamps = {int(row["frame"]): int(row["stamp_ns"]) for row in _keyframes(run)}
    errors = _depth_errors(recording, done.output, stamps, scale)
    truth = _truth(recording, source.rig.cam0, source.ground_truth, stamps, done.far * scale)
    rows = np.frombuffer(
        (done.output / "cloud.ply").read_bytes().split(b"end_header\n", 1)[1], _POINT
    )

    def placed(xyz: Floats) -> Floats:
        return scale * xyz @ alignment.rotation.T + alignment.translation

    cloud = placed(rows["xyz"].astype(np.float64))
    distance = _distances(truth, _some(cloud), near)
    complete = cKDTree(cloud).query(_some(_seen_twice(truth, near)))[0] < near
    mesh = _distances(truth, _some(placed(read_mesh(done.output / "mesh.ply").vertices)), near)
    grid = "– | –"
    if mode == "stereo":
        world_from_truth = inverse(make_transform(alignment.rotation, alignment.translation))
        grid = _grid_errors(recording, done, stamps, world_from_truth)
    line = (
        f"| {name} | {mode} | {done.far * scale:.1f} | {100 * np.median(errors):.2f} | "
        f"{100 * complete.mean():.0f} | {100 * np.mean(distance > 5 * near):.1f} | "
        f"{1000 * mesh.mean():.0f} | {grid} | {done.keyframes} | {done.keyframes / took_s:.1f} |"
    )
    return line, done.far * scale


def _keyframes(run: Path) -> list[dict[str, str]]:
    with (run / "poses.csv").open() as file:
        return [row for row in csv.DictReader(file) if row["keyframe"] == "1"]


def _true_depth(recording: Path, stamp_ns: int) -> Any:
    depth = cv2.imread(str(recording / "depth" / f"{stamp_ns}.tiff"), cv2.IMREAD_UNCHANGED)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan)


def _depth_errors(recording: Path, output: Path, stamps: dict[int, int], scale: float) -> Floats:
    """Relative errors of the depths of all keyframes, every 20th pixel."""
    found = []
    for path in sorted((output / "depth").iterdir()):
        true = _true_depth(recording, stamps[int(path.stem)])
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * scale
        error = np.abs(depth / true - 1.0)[depth > 0]
        found.append(error[np.isfinite(error)][::20])
    return np.concatenate(found)


def _grid_errors(
    recording: Path, done: Any, stamps: dict[int, int], world_from_truth: Floats
) -> str:
    """Of the cells that true depths call free, how many are, in percent; and how many gaps.

    A gap is a cell that is free and not beside one that is occupied, but is occupied in truth, as
    keyframes of even numbers see it and as those of odd ones do.
    """
    source: Any = vo.open(recording)
    camera, path = source.rig.cam0, source.ground_truth
    summary = json.loads((done.output / "dense.json").read_text())
    ground_from_truth = np.array(summary["ground_from_world"]) @ world_from_truth
    header = yaml.safe_load((done.output / "map.yaml").read_text())
    found = np.asarray(cv2.imread(str(done.output / "map.pgm"), cv2.IMREAD_GRAYSCALE))
    edge, low = header["resolution"], np.array(header["origin"][:2])
    low += 0.5 * edge
    high = low + (np.array(found.shape[::-1]) - 2) * edge
    true, *halves = (OccupancyGrid(low, high, edge, (0.15, 1.8)) for _ in range(3))
    v, u = np.mgrid[: camera.height : 2, : camera.width : 2]
    for number, stamp in enumerate(stamps.values()):
        z = _true_depth(recording, stamp)[::2, ::2]
        seen = z < done.far
        x, y = (u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z
        at = int(np.argmin(np.abs(path.stamps_ns - stamp)))
        pose = ground_from_truth @ path.world_from_cam[at]
        points = transform_points(pose, np.stack([x, y, z], axis=-1)[seen])
        for each in (true, halves[number % 2]):
            each.add(points, u[seen], pose)
    cells = true.grid().cells
    free = (cells == FREE) & (found != UNKNOWN)
    occupied = cv2.dilate((found == OCCUPIED).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    walls = [(each.grid().cells == OCCUPIED) for each in (true, *halves)]
    gaps = np.logical_and.reduce(walls) & (found == FREE) & ~occupied
    print(
        f"{free.sum()} free cells, {np.logical_and.reduce(walls).sum()} of walls", file=sys.stderr
    )
    return f"{100 * np.mean(found[free] == FREE):.1f} | {gaps.sum()}"


def _truth(recording: Path, camera: Camera, path: Any, stamps: dict[int, int], far: float) -> Truth:
    v, u = np.mgrid[: camera.height, : camera.width]
    ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0 * u + 1], axis=-1)
    parts = []
    for number, stamp in enumerate(stamps.values()):
        depth = _true_depth(recording, stamp)
        grid = ray * np.where(depth < far, depth, np.nan)[..., None]
        normal = np.full_like(grid, np.nan)
        across, down = grid[1:-1, 2:] - grid[1:-1, :-2], grid[2:, 1:-1] - grid[:-2, 1:-1]
        normal[1:-1, 1:-1] = np.cross(down, across)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        kept = np.isfinite(normal).all(axis=-1) & np.isfinite(grid).all(axis=-1)
        kept[::2], kept[:, ::2] = False, False
        pose = path.world_from_cam[int(np.argmin(np.abs(path.stamps_ns - stamp)))]
        parts.append((transform_points(pose, grid[kept]), normal[kept] @ pose[:3, :3].T, number))
    counts = [np.full(len(xyz), number) for xyz, _, number in parts]
    xyz, normal = (np.concatenate([part[k] for part in parts]) for k in range(2))
    return Truth(xyz, normal, np.concatenate(counts))


def _seen_twice(truth: Truth, edge: float) -> Floats:
    """A point of each cube of the true surfaces that two keyframes see."""
    cube = np.floor(truth.xyz / edge).astype(np.int64)
    cube -= cube.min(axis=0)
    key = np.ravel_multi_index(tuple(cube.T), tuple(cube.max(axis=0) + 1))
    pairs = np.unique(np.stack([key, truth.keyframe]), axis=1)
    cubes, counts = np.unique(pairs[0], return_counts=True)
    known, first = np.unique(key, return_index=True)
    return truth.xyz[first[np.isin(known, cubes[counts > 1], assume_unique=True)]]


def _distances(truth: Truth, xyz: Floats, near: float) -> Floats:
    """Distances (N,) of points from the planes through their nearest true points."""
    distance, row = cKDTree(truth.xyz).query(xyz)
    across = np.abs(((xyz - truth.xyz[row]) * truth.normal[row]).sum(axis=1))
    return np.minimum(distance, across + np.maximum(distance - 2 * near, 0.0))


def _some(xyz: Floats) -> Floats:
    return xyz[np.random.default_rng(0).permutation(len(xyz))[:_SAMPLES]]


if __name__ == "__main__":
    sys.exit(main())
