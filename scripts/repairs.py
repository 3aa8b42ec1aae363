"""How many false repairs of doubted motions are refused, and how many true ones are accepted.

Graphs of the keyframes of a map file, in which one motion is doubted:

- false: odometry is right, and ten loops across the motion, of different keyframes, agree with each
  other on another one, as those to a copy of a place would;
- true: odometry is wrong by such a motion, and the loops of the map contradict it.

The other motion is drawn within the limits of repairs (0.25 rad and 1.5 steps). Each graph is
solved without and with the images. Maps are written by `vo run RECORDING --loops --save-map MAP
--no-imu`, also by `scripts/loops --maps DIR`. docs/experiments/doubted-odometry.md has the results.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo.base.types import Camera, Floats
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.geometry import sim3
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.map_file import MapFile
from vo.engine.places.records import Loop, Place, PlacedKeyframes
from vo.engine.places.repair_check import unconfirmed_repairs
from vo.engine.places.vocabulary_file import built_in_vocabulary

_LOOPS = 10
_ROTATION_RAD, _STEPS = 0.25, 1.5  # standard deviations, as the pose graph has them
_MIN_REACH = 12  # keyframes on each side of the doubted motion


def main() -> None:
    """Print the numbers of accepted repairs of each map."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--graphs", type=int, default=20, help="of each kind and map")
    arguments = parser.parse_args()
    for file in arguments.maps:
        camera, places, loops = _longest_segment(file)
        counts = {"false": np.zeros(3, int), "true": np.zeros(3, int)}
        for seed in range(arguments.graphs):
            for kind, count in counts.items():
                count += _accepted(camera, places, loops, kind == "true", seed)
        for kind, (graphs, without, with_images) in counts.items():
            print(
                f"{file.stem}, {kind}: {graphs} graphs, repaired in {without}, "
                f"by the images in {with_images}",
                flush=True,
            )


def _longest_segment(file: Path) -> tuple[Camera, list[Place], list[Loop]]:
    """Keyframes of a segment, with odometry that agrees with the loops between them."""
    with MapFile(file) as stored:
        at = {key: n for n, key in enumerate(stored.placed.keys)}
        every = [stored.place(key) for key in sorted(at)]
        segments = [place.frame.segment for place in every]
        longest = max(sorted(set(segments)), key=segments.count)
        places = []
        for place in (place for place in every if place.frame.segment == longest):
            pose = stored.placed.world_from_cam[at[place.key]].copy()
            pose = place.odom_from_cam if not place.is_metric else pose
            places.append(replace(place, odom_from_cam=pose, is_doubted=False))
        keys = {place.key for place in places}
        loops = [loop for loop in stored.loops if {loop.earlier, loop.later} <= keys]
        return stored.header.camera, places, loops


def _accepted(
    camera: Camera, places: list[Place], loops: list[Loop], is_wrong: bool, seed: int
) -> tuple[int, int, int]:
    """One graph, whether its motion is repaired without the images, and with them."""
    rng = np.random.default_rng(seed)
    at = int(rng.integers(_MIN_REACH, len(places) - _MIN_REACH))
    motion = _drawn(rng, places, at)
    before = places[at - 1].odom_from_cam
    moved = before @ motion @ sim3.inverse(before)
    other = [
        replace(p, odom_from_cam=moved @ p.odom_from_cam, is_doubted=n == 0)
        for n, p in enumerate(places[at:])
    ]
    if is_wrong:
        graph_of, chosen = [*places[:at], *other], loops
    else:
        doubted = [replace(places[at], is_doubted=True), *places[at + 1 :]]
        graph_of, chosen = [*places[:at], *doubted], _false_loops(rng, places[:at], other)
    free = _solved(camera, graph_of, chosen, by_images=False)
    checked = _solved(camera, graph_of, chosen, by_images=True)
    return 1, len(free.wrong) > 0, len(checked.wrong) > 0


def _drawn(rng: np.random.Generator, places: list[Place], at: int) -> Floats:
    """An error of the motion before a keyframe."""
    poses = np.stack([place.odom_from_cam for place in places])
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    wide = _STEPS * (steps[at - 1] + np.median(steps))
    sigma = np.r_[np.full(3, _ROTATION_RAD), np.full(3, wide), 0.0]
    return sim3.retract(sigma * rng.normal(size=7))


def _false_loops(
    rng: np.random.Generator, before: list[Place], after: list[Place]
) -> tuple[Loop, ...]:
    """Loops to consecutive keyframes, which agree with each other."""
    first = int(rng.integers(0, len(before) - _LOOPS))
    second = int(rng.integers(0, len(after) - _LOOPS))
    covariance = np.diag(np.r_[np.full(3, 2e-3), np.full(3, 0.02), 0.0] ** 2)
    loops = []
    for earlier, later in zip(before[first:], after[second : second + _LOOPS], strict=False):
        if not later.is_metric:
            covariance[6, 6] = 1e-4
        relation = sim3.inverse(earlier.odom_from_cam) @ later.odom_from_cam
        loops.append(Loop(earlier.key, later.key, relation, 1.0, covariance, 60))
    return tuple(loops)


def _solved(
    camera: Camera, places: list[Place], loops: list[Loop] | tuple[Loop, ...], *, by_images: bool
) -> PlacedKeyframes:
    graph = PoseGraph()
    with KeyframeDatabase(built_in_vocabulary()) as database:
        for place in places:
            graph.add_keyframe(place)
            if by_images:
                database.add(place, removes_redundant=False)
        for loop in loops:
            graph.add_loop(loop)
        if by_images:
            graph.unconfirmed = lambda placed: unconfirmed_repairs(database, camera, placed)
        graph.submit()
        return graph.result()


if __name__ == "__main__":
    main()
