"""Recognition of objects in rendered scenes and in unrelated images: recall, precision, time.

Twenty flat objects are added from one image each. In a scene, instances turn in the plane by any
angle and out of it by up to 45 degrees, at 0.3 to 3 times of their stored size, in clutter and in
six kinds of light. A report is right if it has the name of an instance and an outline within 15 %
of its size.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from objects_scenes import LIGHTS, Scene, SceneOptions, TrueObject, make_objects, make_scene

from vo.errors import VoError
from vo.objects.confidence import THRESHOLD, evidence
from vo.objects.database import DETECTOR, ObjectDatabase
from vo.objects.overlap import without_overlaps
from vo.sources.listing import IMAGE_SUFFIXES
from vo.sources.single_image import read_single_image
from vo.types import Floats

COVERS = ((0.0, 0.0), (0.0, 0.3), (0.3, 0.5))
_WRONG = 0.15  # mean distance of corners, of the size of the instance


def main() -> None:
    """Print tables, and write what was measured as JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--detector", default=DETECTOR)
    parser.add_argument("--scenes", type=int, default=20, help="for each of three ranges of cover")
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--unrelated", nargs="*", type=Path, default=[], help="images, or folders")
    parser.add_argument("--images", type=int, default=500, help="of them, spread evenly")
    parser.add_argument("--many", type=int, default=0, help="objects of a large database")
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
        rows += on_scenes(database, objects, arguments.scenes, arguments.seed)
    if arguments.unrelated:
        rows += on_unrelated(database, arguments.unrelated, arguments.images)
    if arguments.many:
        with_many(arguments.detector, arguments.many)
    if arguments.rows is not None:
        arguments.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))


def on_scenes(
    database: ObjectDatabase, objects: list[TrueObject], count: int, seed: int
) -> list[dict[str, Any]]:
    """Recall by cover, light and scale, and precision."""
    rows: list[dict[str, Any]] = []
    truth: list[tuple[Any, ...]] = []
    for cover in COVERS:
        cpu = 0.0
        for n in range(count):
            light = LIGHTS[n % len(LIGHTS)]
            options = SceneOptions(count=3, cover=cover, light=light)
            scene = make_scene(objects, seed + n, options)
            begin = time.process_time()
            found = database.evidence(scene.image)
            cpu += time.process_time() - begin
            kept = without_overlaps([each for each, _ in found])
            hits: set[int] = set()
            for k, (each, instance) in enumerate(found):
                row = _right(scene, each.name, each.outline)
                terms = evidence(instance.inliers, instance.coverage, instance.likeness)
                rows.append(
                    {
                        "terms": terms,
                        "confidence": each.confidence,
                        "right": row is not None,
                        "cover": cover[1],
                        "kept": k in kept,
                    }
                )
                if row is not None and k in kept and each.confidence >= THRESHOLD:
                    hits.add(row)
            for k, instance in enumerate(scene.instances):
                truth.append((cover[1], light, instance.scale, instance.tilt_deg, k in hits))
                if k not in hits:
                    print(
                        "missed",
                        seed + n,
                        light,
                        instance.name,
                        f"scale {instance.scale:.2f}",
                        f"tilt {instance.tilt_deg:.0f} visible {instance.visible:.2f}",
                        flush=True,
                    )
        here = [t[-1] for t in truth if t[0] == cover[1]]
        reported = [r for r in rows if r["cover"] == cover[1] and r["kept"]]
        reported = [r for r in reported if r["confidence"] >= THRESHOLD]
        wrong = sum(not r["right"] for r in reported)
        print(
            f"cover {cover[0]:.0%} to {cover[1]:.0%}: recall {np.mean(here):.3f} of {len(here)}, "
            f"{wrong} wrong of {len(reported)} reports, {cpu / count:.2f} s CPU an image",
            flush=True,
        )
    for column, groups in ((1, LIGHTS), (2, (0.3, 0.5, 1.0, 3.0)), (3, (0, 15, 30, 45))):
        for low, high, part in _groups(truth, column, groups):
            print(f"  {low}{high}: recall {np.mean([t[-1] for t in part]):.3f} of {len(part)}")
    return rows


def _groups(
    truth: list[tuple[Any, ...]], column: int, groups: tuple[Any, ...]
) -> Iterator[tuple[str, str, list[tuple[Any, ...]]]]:
    """Instances up to 30 % cover by light, or by ranges of a number."""
    known = [t for t in truth if t[0] <= 0.3]
    if isinstance(groups[0], str):
        for name in groups:
            yield name, "", [t for t in known if t[column] == name]
        return
    for low, high in zip(groups, groups[1:], strict=False):
        yield (
            f"{'scale' if column == 2 else 'tilt'} {low}",
            f" to {high}",
            [t for t in known if low <= t[column] <= high],
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
            terms = evidence(instance.inliers, instance.coverage, instance.likeness)
            row = {"terms": terms, "confidence": each.confidence, "right": False, "cover": -1.0}
            rows.append(row | {"kept": True})
            if each.confidence >= THRESHOLD:
                false += 1
                print("false", files[n], each.name, each.confidence)
    print(
        f"{len(chosen)} unrelated images: {false} false reports at confidence {THRESHOLD}, "
        f"{len(rows)} at any",
        flush=True,
    )
    return rows


def with_many(detector: str, count: int) -> None:
    """CPU time of one image with a large database."""
    objects = make_objects(count)
    database = ObjectDatabase(detector)
    begin = time.process_time()
    refused = 0
    for each in objects:
        try:
            database.add(each.name, [each.image])
        except VoError as error:
            refused += 1
            print("refused", error)
    added = time.process_time() - begin
    times, hits, total = [], 0, 0
    for n in range(10):
        scene = make_scene(objects, 1000 + n, SceneOptions(count=3, cover=(0.0, 0.3)))
        begin = time.process_time()
        found = database.find(scene.image)
        times.append(time.process_time() - begin)
        hits += sum(any(f.name == i.name for f in found) for i in scene.instances)
        total += len(scene.instances)
    print(
        f"{len(database)} objects: {added / count:.2f} s CPU to add one, {times[0]:.2f} s the "
        f"first image (index), then median {np.median(times[1:]):.2f} s, maximum "
        f"{max(times[1:]):.2f} s; {hits} of {total} found"
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
