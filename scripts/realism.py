"""Compares image and feature statistics of real and synthetic recordings, as a Markdown table."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe, recipe_names
from vo.base.geometry.cameras import normalise
from vo.base.types import Bytes, Camera
from vo.recordings.sources.registry import open_source

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "synth.md"
BEGIN, END = "<!-- realism: begin -->", "<!-- realism: end -->"
FEATURES = 2000
FRAMES = 60
TUM_CALIBRATION = "cam0: {resolution: [640, 480], intrinsics: [535.4, 539.2, 320.1, 247.6]}\n"
REAL = (
    "kitti06_stereo_000-050",
    "kitti07_mono_000-099",
    "kitti_raw_stereo_000-099",
    "rendered_hall_stereo",
    "tum_fr3_cabinet_58_lowtexture",
)
HEAD = (
    "recording", "mean grey", "contrast", "corners per Mpx", "matched", "inliers", "motion, px",
    "track, frames", "tracks ≥ 10 frames",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """Medians over the frames of a recording.

    Attributes:
        name: of the recording.
        grey: mean grey level.
        contrast: standard deviation of grey levels.
        corners: FAST corners (threshold 20) per million pixels.
        matched: ratio of 2000 ORB features with a match in the next frame.
        inliers: ratio of the matches within 1 px of their epipolar line.
        motion_px: image motion of the inliers.
        track: mean length of a track of matches, in frames.
        long_tracks: ratio of the features that belong to tracks of 10 and more frames.
    """

    name: str
    grey: float
    contrast: float
    corners: float
    matched: float
    inliers: float
    motion_px: float
    track: float
    long_tracks: float

    def cells(self) -> list[str]:
        """The cells of the row as text."""
        return [
            self.name, f"{self.grey:.0f}", f"{self.contrast:.0f}", f"{self.corners:.0f}",
            f"{100 * self.matched:.0f} %", f"{100 * self.inliers:.0f} %", f"{self.motion_px:.1f}",
            f"{self.track:.1f}", f"{100 * self.long_tracks:.0f} %",
        ]  # fmt: skip


def main() -> None:
    """Measure, print the table, and write it where requested."""
    parser = argparse.ArgumentParser(prog="scripts/realism", description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--only", default="", metavar="TEXT", help="only names that contain this")
    parser.add_argument("--write", action="store_true", help="write the table into docs/synth.md")
    options = parser.parse_args()
    rows = list(_rows(options))
    lines = ["| " + " | ".join(cells) + " |" for cells in (HEAD, ["---"] + ["---:"] * 8)]
    text = "\n".join([*lines, *("| " + " | ".join(row.cells()) + " |" for row in rows)])
    print(text)
    if options.write:
        page = PAGE.read_text(encoding="utf-8")
        before, after = page.split(BEGIN)[0], page.split(END)[1]
        PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


def _rows(options: argparse.Namespace) -> Iterator[Row]:
    for name in REAL:
        if options.only in name and (options.data / name).is_dir():
            _say(name)
            yield _real(name, options.data / name)
    for name in recipe_names():
        if options.only in name:
            _say(name)
            yield _synthetic(name)


def _real(name: str, folder: Path) -> Row:
    """The middle frames of a recording on disk."""
    with tempfile.TemporaryDirectory() as work:
        calibration = Path(work) / "tum.yaml"
        calibration.write_text(TUM_CALIBRATION, encoding="utf-8")
        given = calibration if name.startswith("tum") else None
        source = open_source(folder, calibration=given, mode="mono")
        middle = max(0, len(source) // 2 - FRAMES // 2)
        images = [frame.image0 for frame in source.frames(middle, middle + FRAMES)]
    return _row(f"real: {name}", images, source.rig.cam0)


def _synthetic(name: str) -> Row:
    """The middle frames of a preset's recording, rendered with one camera."""
    plan = make_plan(load_recipe(name, ["mono=true", "format=euroc"]))
    middle = max(0, len(plan.recording) // 2 - FRAMES // 2)
    with ThreadPoolExecutor() as pool:
        shots = list(render_frames(plan, pool, range(middle, middle + FRAMES)))
    images = [shot.images[0] for shot in shots if shot.images[0] is not None]
    return _row(f"`{name}`", images, plan.recording.rig.cam0)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _row(name: str, images: list[Bytes], camera: Camera) -> Row:
    orb = cv2.ORB_create(FEATURES)
    found = [orb.detectAndCompute(image, None) for image in images]
    pairs = [_pair(camera, first, second) for first, second in zip(found, found[1:], strict=False)]
    lengths = _track_lengths(pairs, [len(points) for points, _ in found])
    mega = images[0].size / 1e6
    fast = cv2.FastFeatureDetector_create(20)
    return Row(
        name=name,
        grey=float(np.median([image.mean() for image in images])),
        contrast=float(np.median([image.std() for image in images])),
        corners=float(np.median([len(fast.detect(image)) for image in images])) / mega,
        matched=float(np.median([len(p[0]) / FEATURES for p in pairs])),
        inliers=float(np.median([p[1].mean() if len(p[1]) else 0.0 for p in pairs])),
        motion_px=float(np.median([np.median(p[2]) if len(p[2]) else 0.0 for p in pairs])),
        track=float(lengths.mean()),
        long_tracks=float(lengths[lengths >= 10].sum() / lengths.sum()),
    )


def _pair(
    camera: Camera, first: tuple, second: tuple
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
    """Matches (M, 2) of two images, inlier mask (M,), and image motion of the inliers in px."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    if first[1] is None or second[1] is None:
        return np.empty((0, 2), np.int64), np.empty(0, bool), np.empty(0)
    matches = [m for m in matcher.match(first[1], second[1]) if m.distance < 64]
    index = np.array([(m.queryIdx, m.trainIdx) for m in matches], np.int64).reshape(-1, 2)
    a = np.array([first[0][i].pt for i in index[:, 0]]).reshape(-1, 2)
    b = np.array([second[0][i].pt for i in index[:, 1]]).reshape(-1, 2)
    keep = np.zeros(len(index), bool)
    if len(index) >= 8:
        rays = [np.ascontiguousarray(normalise(camera, p)) for p in (a, b)]
        _, mask = cv2.findEssentialMat(
            *rays, np.eye(3), cv2.USAC_DEFAULT, 0.999, 1.0 / camera.fx, 2000
        )
        keep = np.zeros(len(index), bool) if mask is None else mask.ravel().astype(bool)
    return index, keep, np.linalg.norm(a - b, axis=1)[keep]


def _track_lengths(pairs: list, counts: list[int]) -> NDArray[np.int64]:
    """Length in frames of each chain of inlier matches."""
    done: list[int] = []
    lengths = np.ones(counts[0], np.int64)
    for (index, keep, _), count in zip(pairs, counts[1:], strict=True):
        following = np.ones(count, np.int64)
        going = index[keep]
        following[going[:, 1]] = lengths[going[:, 0]] + 1
        ended = np.ones(len(lengths), bool)
        ended[going[:, 0]] = False
        done += lengths[ended].tolist()
        lengths = following
    return np.array(done + lengths.tolist())


if __name__ == "__main__":
    main()
