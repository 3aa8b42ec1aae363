"""Compares rigs of several cameras with the best pair of each, on recordings that it renders."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from common import EXPERIMENTS, VoRun, parser_of, run_vo, write_section

import vo

_CASES: dict[str, tuple[str, str, str, int, tuple[str, ...]]] = {
    # rig, world, motion, frames per second, and further settings; 12 seconds each
    "car_street": ("car", "street", "car", 10, ()),
    "car_street_late": ("car", "street", "car", 10, ("effects.stagger=1",)),
    "car_traffic": ("car", "street", "car", 10, ("effects.movers=1", "seed=5")),
    "car_warehouse": ("car", "warehouse", "robot", 8, ()),
    "car_warehouse_dark": ("car", "warehouse", "robot", 8, ("effects.light=0.08", "seed=5")),
    "robot_corridor": ("robot", "corridor", "robot", 8, ("seed=4",)),
    "robot_corridor_wall": ("robot", "corridor", "robot", 8, ("seed=4", "aside_m=-0.9")),
    "robot_room": ("robot", "room", "handheld", 8, ()),
    "robot_room_late": ("robot", "room", "handheld", 8, ("effects.stagger=1",)),
    "robot_street": ("robot", "street", "robot", 8, ()),
    "robot_warehouse": ("robot", "warehouse", "robot", 8, ()),
    "drone_corridor": ("drone", "corridor", "robot", 8, ()),
    "drone_room": ("drone", "room", "handheld", 8, ()),
    "drone_street": ("drone", "street", "drone", 8, ()),
    "drone_warehouse": ("drone", "warehouse", "drone", 8, ()),
}
_SECONDS = 12
_COVERED_S = 5.0
_COVER_GREY = 6
_HEADING = (
    "| recording | cameras | rig, mm | best pair, mm | ratio | worst covered, mm | ratio | lost |"
    " ms per image, rig | pair |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
)


def main() -> None:
    """Print a row for each recording."""
    parser = parser_of("rigs", __doc__, "write", "only", "cache")
    parser.add_argument("--no-cover", action="store_true", help="cover no camera")
    options = parser.parse_args()
    lines = [_HEADING]
    for name, case in _CASES.items():
        if options.only in name:
            lines.append(_row(name, case, options.cache / "rigs", is_covered=not options.no_cover))
            print(lines[-1], flush=True)
    if options.write:
        write_section(EXPERIMENTS / "rigs.md", "rigs", "\n".join(lines))


def _row(name: str, case: tuple[Any, ...], cache: Path, *, is_covered: bool) -> str:
    rig_name, world, motion, fps, further = case
    recording = cache / name
    if not recording.exists():
        settings = [f"world={world}", f"motion={motion}", f"seconds={_SECONDS}", f"fps={fps}"]
        settings += ["seed=3", *further]
        vo.synth(recording, camera=rig_name, overrides=settings)
    count = len(vo.open(recording).rig.cameras)
    whole = _run(recording, "rig")
    error = _error(recording, whole)
    # Images of the pair are not of one time, or have nothing in common.
    if name.endswith("_late") or rig_name == "drone":
        return f"| {name} | {count} | {1e3 * error:.2f} | | | | | | {_ms(whole, count):.1f} | |"
    pair = _run(recording, "pair", "--mode", "stereo")
    best = _error(recording, pair)
    covered = "| | | "
    if is_covered:
        runs = [_covered(recording, number) for number in range(count)]
        worst, lost = max(each[0] for each in runs), sum(each[1] for each in runs)
        covered = f"| {1e3 * worst:.2f} | {worst / error:.2f} | {lost} "
    return (
        f"| {name} | {count} | {1e3 * error:.2f} | {1e3 * best:.2f} | {error / best:.2f} {covered}"
        f"| {_ms(whole, count):.1f} | {_ms(pair, 2):.1f} |"
    )


def _run(recording: Path, kind: str, *options: str) -> VoRun:
    output = recording.with_name(f"{recording.name}_{kind}")
    done = run_vo(recording, output, "--no-imu", *options)
    if done.failure:
        raise SystemExit(f"{recording.name}, {kind}: {done.failure}")
    return done


def _error(recording: Path, run: VoRun) -> float:
    return float(vo.evaluate(run.output, recording, align="auto").ate.translation.rmse)


def _ms(run: VoRun, cameras: int) -> float:
    frames: int = run.summary["frames"]
    return 1e3 * run.cpu_s / max(1, frames) / cameras


def _covered(recording: Path, number: int) -> tuple[float, int]:
    """Error and lost frames where a camera is covered for 5 s in the middle."""
    covered = recording.with_name(f"{recording.name}_covered{number}")
    images = sorted((recording / "mav0" / f"cam{number}" / "data").iterdir())
    if not covered.exists():
        folder = covered / "mav0" / f"cam{number}"
        (folder / "data").mkdir(parents=True)
        for each in [*recording.iterdir(), *(recording / "mav0").iterdir()]:
            target = covered / each.relative_to(recording)
            if not target.exists():
                target.symlink_to(each.resolve())
        for file in ("data.csv", "sensor.yaml"):
            source = recording / "mav0" / f"cam{number}" / file
            (folder / file).symlink_to(source.resolve())
        first = cv2.imread(str(images[0]), cv2.IMREAD_GRAYSCALE)
        assert first is not None
        noise = np.random.default_rng(number).integers(0, 2, first.shape, dtype=np.uint8)
        cover = covered / "cover.png"
        cv2.imwrite(str(cover), noise + np.uint8(_COVER_GREY))
        stamps = np.array([int(each.stem) for each in images])
        away = np.abs(stamps - np.median(stamps)) > 0.5e9 * _COVERED_S
        for image, is_seen in zip(images, away, strict=True):
            os.symlink(
                image.resolve() if is_seen else cover.resolve(), folder / "data" / image.name
            )
    run = _run(covered, "rig")
    return _error(recording, run), int(run.summary["lost"])


if __name__ == "__main__":
    main()
