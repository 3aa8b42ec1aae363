"""Recognition of objects in rendered scenes and in unrelated images: recall, precision, time.

Twenty flat objects are added from one image each. In a scene, instances turn in the plane by any
angle and out of it by up to 45 degrees, at 0.3 to 3 times of their stored size, in clutter and in
six kinds of light. A report is right if it has the name of an instance and an outline within 15 %
of its size.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from objects_scenes import LIGHTS, Scene, SceneOptions, TrueObject, make_objects, make_scene

from vo.base.errors import VoError
from vo.base.scheduling import available_cores
from vo.base.types import Floats
from vo.recordings.sources.listing import IMAGE_SUFFIXES
from vo.recordings.sources.single_image import read_single_image
from vo.tools.objects.confidence import THRESHOLD, evidence
from vo.tools.objects.database import DETECTOR, ObjectDatabase
from vo.tools.objects.flat_verification import FlatInstance
from vo.tools.objects.records import FoundObject
from vo.tools.objects.tracks import without_overlaps

COVERS = ((0.0, 0.0), (0.0, 0.3), (0.3, 0.5))
_RANGES: dict[str, tuple[float, ...]] = {
    "scale": (0.3, 0.5, 1.0, 3.1),
    "side": (0.0, 110.0, 130.0, 180.0, 1300.0),  # square root of the area, pixels
    "tilt": (0.0, 15.0, 30.0, 46.0),
}
_WRONG = 0.15  # mean distance of corners, of the size of the instance


def main() -> None:
    """Print tables, and write what was measured as JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--detector", default=DETECTOR)
    parser.add_argument("--scenes", type=int, default=20, help="for each of three ranges of cover")
    parser.add_argument("--cover", type=int, nargs="*", default=[0, 1, 2], help="which ranges")
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--unrelated", nargs="*", type=Path, default=[], help="images, or folders")
    parser.add_argument("--images", type=int, default=500, help="of them, spread evenly")
    parser.add_argument("--many", type=int, default=0, help="objects of a large database")
    parser.add_argument("--database", type=Path, help="file in which the large one is kept")
    parser.add_argument("--rows", type=Path, help="file for what was measured")
    parser.add_argument("--fit", nargs="*", type=Path, help="fit the confidence to such files")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.fit is not None:
        fit([json.loads(line) for path in arguments.fit for line in path.open()])
        return
    objects = make_objects(20)
    database = ObjectDatabase(arguments.detector)
    for each in objects:
        database.add(each.name, [each.image], width_m=each.width_m)
    rows: list[dict[str, Any]] = []
    if arguments.scenes:
        for cover in arguments.cover:
            rows += on_scenes(database, objects, arguments, COVERS[cover])
    if arguments.unrelated:
        rows += on_unrelated(database, arguments.unrelated, arguments.images)
    if arguments.many:
        with_many(arguments.detector, arguments.many, arguments.database)
    if arguments.rows is not None:
        arguments.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))


def on_scenes(
    database: ObjectDatabase,
    objects: list[TrueObject],
    arguments: argparse.Namespace,
    cover: tuple[float, float],
) -> list[dict[str, Any]]:
    """Recall, also by light, scale, size and tilt, and precision."""
    rows: list[dict[str, Any]] = []
    truth: list[dict[str, Any]] = []
    cpu = 0.0
    for n in range(arguments.scenes):
        light = LIGHTS[n % len(LIGHTS)]
        scene = make_scene(objects, arguments.seed + n, SceneOptions(3, cover, light=light))
        begin = time.process_time()
        found = database.evidence(scene.image)
        cpu += time.process_time() - begin
        kept = without_overlaps([each for each, _ in found])
        hits: set[int] = set()
        for k, (each, instance) in enumerate(found):
            right = _right(scene, each.name, each.outline)
            row = _row(each, instance, right is not None, cover[1])
            rows.append(row | {"kept": k in kept})
            if right is not None and k in kept and each.confidence >= THRESHOLD:
                hits.add(right)
        for k, true in enumerate(scene.instances):
            side = float(np.sqrt(cv2.contourArea(true.outline.astype(np.float32))))
            truth.append(
                {"light": light, "scale": true.scale, "side": side, "tilt": true.tilt_deg}
                | {"hit": k in hits, "visible": true.visible}
            )
            if k not in hits:
                print("missed", arguments.seed + n, true.name, _words(truth[-1]), flush=True)
    reported = [r for r in rows if r["kept"] and r["confidence"] >= THRESHOLD]
    wrong = sum(not r["right"] for r in reported)
    print(
        f"cover {cover[0]:.0%} to {cover[1]:.0%}: recall {_recall(truth)}, {wrong} wrong of "
        f"{len(reported)} reports, {cpu / arguments.scenes:.2f} s CPU an image",
        flush=True,
    )
    for light in LIGHTS:
        print(f"  {light}: recall {_recall([t for t in truth if t['light'] == light])}")
    for column, edges in _RANGES.items():
        for low, high in itertools.pairwise(edges):
            here = [t for t in truth if low <= t[column] < high]
            print(f"  {column} {low} to {high}: recall {_recall(here)}", flush=True)
    return rows


def _row(each: FoundObject, instance: FlatInstance, right: bool, cover: float) -> dict[str, Any]:
    """An instance as it is written for `fit`."""
    terms = evidence(instance.inliers, instance.coverage, instance.likeness)
    return {"terms": terms, "confidence": each.confidence, "right": right, "cover": cover}


def _recall(truth: list[dict[str, Any]]) -> str:
    return f"{sum(t['hit'] for t in truth)} of {len(truth)}"


def _words(true: dict[str, Any]) -> str:
    return (
        f"{true['light']}, scale {true['scale']:.2f}, {true['side']:.0f} px, "
        f"tilt {true['tilt']:.0f}, visible {true['visible']:.2f}"
    )


def _right(scene: Scene, name: str, outline: Floats) -> int | None:
    """The instance that a report is right about."""
    for n, instance in enumerate(scene.instances):
        size = np.sqrt(cv2.contourArea(instance.outline.astype(np.float32)))
        away = np.linalg.norm(outline - instance.outline, axis=1).mean()
        if instance.name == name and away <= _WRONG * size:
            return n
    return None


def on_unrelated(database: ObjectDatabase, paths: list[Path], wanted: int) -> list[dict[str, Any]]:
    """False reports in images that show none of the objects."""
    files = [
        file
        for path in paths
        for file in ([path] if path.is_file() else sorted(path.rglob("*")))
        if file.suffix.lower() in IMAGE_SUFFIXES
    ]
    chosen = np.linspace(0, len(files) - 1, min(wanted, len(files))).astype(int).tolist()
    rows: list[dict[str, Any]] = []
    false = 0
    for n in chosen:
        image = read_single_image(files[n]).image
        found = database.evidence(image)
        for each, instance in found:
            rows.append(_row(each, instance, False, -1.0) | {"kept": True})
            if each.confidence >= THRESHOLD:
                false += 1
                print("false", files[n], each.name, each.confidence)
    print(
        f"{len(chosen)} unrelated images: {false} false reports at confidence {THRESHOLD}, "
        f"{len(rows)} at any",
        flush=True,
    )
    return rows


def with_many(detector: str, count: int, file: Path | None) -> None:
    """Recall and time of an image with a large database, in as many threads as there are cores."""
    cv2.setNumThreads(available_cores())
    objects = make_objects(count)
    database = ObjectDatabase(detector)
    begin = time.process_time()
    if file is not None and file.exists():
        database = ObjectDatabase.load(file)
    else:
        for each in objects:
            try:
                database.add(each.name, [each.image])
            except VoError as error:
                print("refused", error)
        if file is not None:
            database.save(file)
    ready = time.process_time() - begin
    spent: list[tuple[float, float]] = []
    hits = total = wrong = 0
    for n in range(12):
        options = SceneOptions(3, (0.0, 0.3), light=LIGHTS[n % len(LIGHTS)])
        scene = make_scene(objects, 1000 + n, options)
        start, begin = time.perf_counter(), time.process_time()
        found = database.find(scene.image)
        spent.append((time.process_time() - begin, time.perf_counter() - start))
        right = [_right(scene, each.name, each.outline) for each in found]
        hits += len({each for each in right if each is not None})
        wrong += right.count(None)
        total += len(scene.instances)
    cpu, wall = np.median(spent[1:], axis=0)
    print(
        f"{len(database)} objects: {ready:.1f} s CPU to add or read them; first image "
        f"{spent[0][0]:.2f} s CPU (index), then median {cpu:.2f} s CPU, {wall:.2f} s; "
        f"{hits} of {total} found, {wrong} wrong"
    )


def fit(rows: list[dict[str, Any]]) -> None:
    """Weights of the logistic function by regularised maximum likelihood, and its reliability."""
    terms = np.array([row["terms"] for row in rows])
    right = np.array([row["right"] for row in rows], dtype=np.float64)
    design = np.column_stack([np.ones(len(terms)), terms])
    weights = np.zeros(design.shape[1])
    prior = np.diag([0.0, *[0.02] * terms.shape[1]])
    for _ in range(60):
        p = 1.0 / (1.0 + np.exp(-design @ weights))
        gradient = design.T @ (right - p) - prior @ weights
        hessian = (design * (p * (1.0 - p))[:, None]).T @ design + prior
        weights += np.linalg.solve(hessian + 1e-9 * np.eye(len(weights)), gradient)
    print(
        f"{len(rows)} instances, {int(right.sum())} right; weights", np.round(weights, 2).tolist()
    )
    p = 1.0 / (1.0 + np.exp(-design @ weights))
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 0.99), (0.99, 1.01)):
        here = (p >= low) & (p < high)
        if here.any():
            print(
                f"  confidence {low:.2f} to {min(high, 1.0):.2f}: {here.sum()} instances, "
                f"mean {p[here].mean():.3f}, right {right[here].mean():.3f}"
            )


if __name__ == "__main__":
    main()
