"""Valid samples of every kind of input, small, to be damaged."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from fuzz_beside import beside_recordings
from fuzz_kinds import Sample

ROOT = Path(__file__).resolve().parent.parent
for _folder in ("tests/recordings/sources", "tests/recordings/formats/calibration"):
    sys.path.insert(0, str(ROOT / _folder))

_POSES = 40
_SIZES = ((640, 480), (752, 480), (1242, 375), (1241, 376), (512, 512), (1280, 720))
_CALIBRATIONS = {
    "calibration_files": (
        *("KITTI_RAW", "KALIBR", "EUROC", "OPENCV_YAML", "OPENCV_XML", "ROS", "OWN", "BASALT"),
        *("ORB_FISHEYE", "COLMAP", "KITTI"),
    ),
    "foreign_files": (
        *("OPENVINS", "CAMODOCAL_PINHOLE", "CAMODOCAL_MEI", "CAMODOCAL_KANNALA_BRANDT"),
        *("STELLA", "MAPLAB", "ZED", "ROS_INI"),
    ),
    "test_damage": ("KALIBR", "EUROC", "ROS", "OPENCV_XML", "OWN"),
    "test_orb_slam": ("ORB_RECTIFIED",),
}


def make_samples(root: Path) -> list[Sample]:
    """Write all samples into a folder."""
    return [
        *_recordings(root),
        *_logs(root),
        *_videos(root),
        *_images(root),
        *_calibrations(root),
        *_trajectories(root),
        *_runs(root),
        *_configs(root),
        *beside_recordings(root),
    ]


def _recordings(root: Path) -> Iterator[Sample]:
    layouts = importlib.import_module("layouts")
    for kind in layouts.WRITERS:
        folder, path = root / kind, layouts.PATHS.get(kind, "recording")
        folder.mkdir()
        layouts.WRITERS[kind](folder / path)
        yield Sample(kind, "recording", folder, path)
        tables = {".txt", ".csv", ".json", ".yaml"} & {f.suffix for f in folder.rglob("*")}
        if tables and kind not in ("glob", "rosbag2"):
            yield Sample(f"{kind} tables", "recording", folder, path, tuple(sorted(tables)))


def _logs(root: Path) -> Iterator[Sample]:
    layouts, bags = importlib.import_module("layouts"), importlib.import_module("bag_logs")
    logs = importlib.import_module("mcap_logs")
    packed, modes = bags.Packed1, bags.CompressionMode
    for name, compression in (("bz2", packed.BZ2), ("none", None)):
        (root / f"bag {name}").mkdir()
        bags.write_bag1(root / f"bag {name}" / "a.bag", layouts.log_messages("png"), compression)
        yield Sample(f"rosbag1 {name}", "recording", root / f"bag {name}", "a.bag")
    for name, mode in (("message", modes.MESSAGE), ("file", modes.FILE)):
        bags.write_bag2(root / f"bag2 {name}" / "bag", layouts.log_messages(), compression=mode)
        yield Sample(f"rosbag2 zstd {name}", "recording", root / f"bag2 {name}", "bag")
    bags.write_bag2(root / "bag2 values" / "bag", layouts.log_messages())
    yield Sample("rosbag2 values", "recording", root / "bag2 values", "bag", (".db3",))
    for name, codec in (("mcap png", "png"), ("mcap again", "mono8")):
        (root / name).mkdir()
        logs.write_log(root / name / "a.mcap", layouts.log_messages(codec))
        yield Sample(name, "recording", root / name, "a.mcap")


def _videos(root: Path) -> Iterator[Sample]:
    for suffix, code in ((".avi", "MJPG"), (".mp4", "mp4v")):
        folder = root / f"video{suffix}"
        folder.mkdir()
        writer = cv2.VideoWriter(
            str(folder / f"v{suffix}"), cv2.VideoWriter.fourcc(*code), 10, (64, 48)
        )
        for number in range(8):
            writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
        writer.release()
        _write_calibration(folder)
        yield Sample(f"video {suffix}", "recording", folder, f"v{suffix}", (suffix,))


def _images(root: Path) -> Iterator[Sample]:
    noise = np.random.default_rng(5).integers(0, 255, (48, 64, 3), np.uint8)
    for suffix in (".png", ".jpg", ".bmp", ".ppm", ".tiff", ".webp"):
        folder = root / f"images{suffix}"
        folder.mkdir()
        for number in range(3):
            image = noise if number == 0 or suffix == ".ppm" else noise[:, :, number]
            assert cv2.imwrite(str(folder / f"{number}{suffix}"), image)
        _write_calibration(folder)
        yield Sample(f"images {suffix}", "recording", folder, ".", (suffix,))


def _write_calibration(folder: Path) -> None:
    text = "cam0: {resolution: [64, 48], intrinsics: [50, 50, 32, 24]}\n"
    (folder / "calibration.yaml").write_text(text, encoding="utf-8")


def _calibrations(root: Path) -> Iterator[Sample]:
    for module, names in _CALIBRATIONS.items():
        texts = vars(importlib.import_module(module))
        for name in names:
            if not isinstance(texts.get(name), str):
                continue
            folder = root / f"{module} {name}"
            folder.mkdir()
            start = texts[name].lstrip()[:1]
            path = f"calibration{'.xml' if start == '<' else '.json' if start == '{' else '.yaml'}"
            (folder / path).write_text(texts[name], encoding="utf-8")
            size = _size_of(folder / path)
            (folder / "size").write_text(json.dumps(size), encoding="utf-8")
            suffix = Path(path).suffix
            yield Sample(f"calibration {module} {name}", "calibration", folder, path, (suffix,))


def _size_of(calibration: Path) -> tuple[int, int] | None:
    """A size of images with which a calibration is read."""
    from vo.base.errors import VoError
    from vo.recordings.formats.calibration import read_calibration

    for size in (None, *_SIZES):
        try:
            read_calibration(calibration, size)
        except VoError:
            continue
        return size
    return None


def _trajectories(root: Path) -> Iterator[Sample]:
    rows = {
        "tum": "".join(f"{k / 10:.9f} {k} {k * k / 50} 0 0 0 0 1\n" for k in range(_POSES)),
        "kitti": "".join(f"1 0 0 {k} 0 1 0 {k * k / 50} 0 0 1 0\n" for k in range(_POSES)),
        "euroc": "#timestamp,x\n"
        + "".join(f"{k * 10**8},{k},{k * k / 50},0,1,0,0,0,0,0,0\n" for k in range(_POSES)),
    }
    for kind, text in rows.items():
        folder = root / f"trajectory {kind}"
        folder.mkdir()
        (folder / "estimate.txt").write_text(text, encoding="utf-8")
        shutil.copy(folder / "estimate.txt", folder / "truth")
        yield Sample(f"trajectory {kind}", "trajectory", folder, "estimate.txt", (".txt",))


def _runs(root: Path) -> Iterator[Sample]:
    from vo.base.config import load_config
    from vo.runs.run_recording import run

    folder = root / "run"
    folder.mkdir()
    layouts = importlib.import_module("layouts")
    layouts.write_folder(folder / "recording")
    run(folder / "recording", folder / "out", config=load_config(overrides=["threads=1"]))
    poses = root / "trajectory tum" / "estimate.txt"
    shutil.copy(poses, folder / "out" / "trajectory.tum")
    shutil.copy(poses, folder / "truth")
    for name in ("summary.json", "frames.csv", "config.yaml", "trajectory.tum"):
        yield Sample(f"run {name}", "report", folder, "out", (Path(name).suffix,))


def _configs(root: Path) -> Iterator[Sample]:
    for name in ("default", "accurate"):
        folder = root / f"config {name}"
        folder.mkdir()
        shutil.copy(ROOT / "configs" / f"{name}.yaml", folder / "config.yaml")
        yield Sample(f"config {name}", "config", folder, "config.yaml")
