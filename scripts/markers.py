"""Errors of marker poses on rendered views with known poses, and false detections in images.

`--write` puts the table into docs/experiments/marker-accuracy.md; `--images FOLDER` counts markers
in images that have none.
"""

from __future__ import annotations

import argparse
import random
import time
from pathlib import Path

import cv2
import numpy as np
from common import write_section
from marker_views import Placed, developed, looking_at, random_background, render

from vo.base.geometry.transforms import inverse, rotation_angle, se3_log
from vo.base.types import Camera, Floats
from vo.engine.markers.dictionaries import CANDIDATES, dictionary_name
from vo.tools.markers.detection import MarkerDetector, Refinement
from vo.tools.markers.search import MarkerFinder

CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
LENGTH_M = 0.16
NAME, COUNT = "4X4_50", 50
DISTANCES_M = (0.3, 0.5, 1.0, 2.0, 3.0, 5.0)
FLIPPED_DEG = 10.0
PAGE = Path(__file__).resolve().parents[1] / "docs" / "experiments" / "marker-accuracy.md"
HEADING = """\
| distance, m | corners | found | position, mm (median, 95 %) | angle, degrees (median, 95 %) | \
flipped and told | ambiguous | NEES | CPU ms |
| ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"""


def row(distance: float, kind: Refinement, views: int) -> str:
    """One line of the table."""
    rng = np.random.default_rng(round(1000 * distance))
    finder = MarkerFinder(MarkerDetector(NAME, kind), LENGTH_M, CAMERA)
    errors, told, flipped, ambiguous, spent = [], 0, 0, 0, 0.0
    for n in range(views):
        truth = _pose(rng, distance)
        placed = Placed(NAME, n % COUNT, LENGTH_M, truth)
        levels = render(CAMERA, placed, random_background(rng, (480, 640)))
        image = developed(levels, rng, blur_px=rng.uniform(0.4, 1.2), noise=rng.uniform(1, 4))
        begun = time.process_time()
        markers = [m for m in finder.find(image).markers if m.id == placed.id]
        spent += time.process_time() - begun
        if not markers or markers[0].pose is None:
            continue
        pose = markers[0].pose
        turned = np.rad2deg(rotation_angle(pose.cam_from_marker[:3, :3] @ truth[:3, :3].T))
        ambiguous += pose.is_ambiguous
        if turned > FLIPPED_DEG:
            flipped += 1
            told += pose.is_ambiguous
            continue
        apart = 1e3 * np.linalg.norm(pose.cam_from_marker[:3, 3] - truth[:3, 3])
        xi = se3_log(truth @ inverse(pose.cam_from_marker))
        errors.append((apart, turned, xi @ np.linalg.solve(pose.covariance, xi)))
    apart, turned, nees = np.array(errors).T
    found = (len(errors) + flipped) / views
    return (
        f"| {distance:g} | {kind.value} | {found:.0%} | {_two(apart)} | {_two(turned)} | "
        f"{flipped}, {told} | {ambiguous} | {nees.mean():.1f} | {1e3 * spent / views:.0f} |"
    )


def _two(values: Floats) -> str:
    return f"{np.median(values):.2f}, {np.percentile(values, 95):.2f}"


def _pose(rng: np.random.Generator, distance: float) -> Floats:
    """A marker that lies in the image as a whole."""
    reach = max(0.0, 0.3 * distance - 0.6 * LENGTH_M)
    position = np.array([rng.uniform(-reach, reach), rng.uniform(-reach, reach) * 0.7, distance])
    tilt = np.deg2rad(rng.uniform(0.0, 60.0))
    return looking_at(position, tilt, rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi))


def count_false(folder: Path, limit: int, names: list[str]) -> None:
    """Print the markers found in images that have none."""
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".png", ".jpg", ".ppm"))
    random.Random(0).shuffle(files)
    counts, images = dict.fromkeys(names, 0), 0
    detectors = [MarkerDetector(name) for name in names]
    for path in files[:limit]:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            continue
        images += 1
        for detector in detectors:
            counts[detector.name] += len(detector.detect(image))
    print(f"{images} images without markers: {counts}")


def main() -> None:
    """Print the table, or count false detections."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=100)
    parser.add_argument("--all", action="store_true", help="all refinements, not only lines")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--images", type=Path)
    parser.add_argument("--limit", type=int, default=1000)
    parser.add_argument("--dictionaries", default=",".join(CANDIDATES))
    arguments = parser.parse_args()
    if arguments.images is not None:
        names = [dictionary_name(name) for name in arguments.dictionaries.split(",")]
        count_false(arguments.images, arguments.limit, names)
        return
    kinds = [Refinement.LINES, Refinement.SUBPIX, Refinement.APRILTAG]
    lines = [HEADING]
    for distance in DISTANCES_M:
        for kind in kinds if arguments.all or distance == 1.0 else kinds[:1]:
            views = arguments.views if distance >= 1.0 else max(arguments.views // 5, 5)
            lines.append(row(distance, kind, views))
            print(lines[-1], flush=True)
    if arguments.write:
        write_section(PAGE, "markers", "\n".join(lines))


if __name__ == "__main__":
    main()
