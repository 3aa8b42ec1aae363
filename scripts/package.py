"""Builds the sdist and the wheel, checks them, and tries the wheel with every extra alone.

Each extra is installed in an environment of its own, and used from another folder: a recording is
rendered and run, what the extra is for must work, and what needs another extra must be refused in
one line. Prints the size of each installation and the time of `import vo`, as the table of
docs/benchmarks.md. Needs the package index, and some minutes.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EXTRAS = (
    *(
        "",
        "view",
        "video",
        "report",
        "ros",
        "foxglove",
        "learned",
        "onnxruntime",
        "cluster",
        "sweep",
    ),
    "all",
)
_MB = 1e6
_REPEATS = 7
_RECORDING = ["--set", "scale=0.25", "--seconds", "2", "--mono", "--quiet"]
_MAKE_VIDEO = """
import cv2, numpy as np
writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (160, 120))
for i in range(9):
    writer.write(np.full((120, 160, 3), 20 * i, np.uint8))
writer.release()
"""


_MAKE_CALIBRATION = """
import vo
camera = vo.Camera(160, 120, 120.0, 120.0, 80.0, 60.0)
vo.write_calibration("camera.yaml", vo.Rig(camera))
shift = __import__("numpy").eye(4)
shift[0, 3] = -0.1
vo.write_calibration("pair.yaml", vo.Rig(camera, camera, shift))
"""
_EXAMPLES = (
    ("recording.py", "walk"),
    ("webcam.py", "camera.yaml", "clip.avi"),
    ("stereo_rig.py", "pair.yaml", "clip.avi", "clip.avi"),
)


@dataclass(frozen=True)
class Trial:
    """A command, and what its output must contain with and without the extra that it needs."""

    command: tuple[str, ...]
    extra: str
    without: str
    is_refused: bool = True


TRIALS = (
    Trial(("info", "clip.avi"), "video", "is decoded by OpenCV", is_refused=False),
    Trial(("run", "walk", "-o", "shown", "--rrd", "a.rrd"), "view", "need the extra 'view'"),
    Trial(("report", "run", "-o", "page.html"), "report", "need the extra 'report'"),
    Trial(("synth", "ros.mcap", "--to", "mcap-ros2", *_RECORDING), "ros", "need the extra 'ros'"),
)


def main() -> None:
    """Build, check and try; exit with status 1 at the first thing that is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder of the packages")
    parser.add_argument("--build-only", action="store_true", help="do not install anything")
    parser.add_argument("--extras", nargs="*", default=EXTRAS, help="extras to try; '' is the core")
    arguments = parser.parse_args()
    wheel = build(arguments.output)
    if arguments.build_only:
        return
    print("| installed | size, MB | `import vo`, s |\n| --- | ---: | ---: |")
    with tempfile.TemporaryDirectory() as work:
        for extra in arguments.extras:
            name = f"`visual-odometry[{extra}]`" if extra else "`visual-odometry`"
            size_mb, import_s = try_extra(wheel, extra, Path(work))
            print(f"| {name} | {size_mb:.0f} | {import_s:.2f} |", flush=True)


def build(output: Path) -> Path:
    """Build both packages in a folder, check them, and return the wheel."""
    output.mkdir(parents=True, exist_ok=True)
    for old in output.glob("visual_odometry-*"):
        old.unlink()
    _call([sys.executable, "-m", "hatchling", "build", "-d", str(output)], ROOT)
    [sdist], [wheel] = output.glob("*.tar.gz"), output.glob("*.whl")
    _call([sys.executable, "-m", "twine", "check", "--strict", str(sdist), str(wheel)], ROOT)
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(sdist) as archive:
            archive.extractall(folder, filter="data")
        [unpacked] = Path(folder).iterdir()
        _call([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], unpacked)
        [second] = Path(folder).glob("*.whl")
        if contents(second) != contents(wheel):
            raise SystemExit(f"error: the wheel built from {sdist.name} has other files")
    return wheel


def contents(wheel: Path) -> dict[str, int]:
    """Checksums of the files of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return {entry.filename: entry.CRC for entry in archive.infolist()}


def try_extra(wheel: Path, extra: str, work: Path) -> tuple[float, float]:
    """Install the wheel with an extra and use it; its size in MB and the time of `import vo`."""
    environment, folder = work / f"env-{extra}", work / f"use-{extra}"
    folder.mkdir()
    _call([sys.executable, "-m", "venv", str(environment)], work)
    python, vo = environment / "bin" / "python", environment / "bin" / "vo"
    before = _size(environment)
    target = f"{wheel}[{extra}]" if extra else str(wheel)
    _call([str(python), "-m", "pip", "install", "--quiet", "--no-compile", target], folder)
    size = _size(environment) - before
    _call([str(python), "-c", _MAKE_VIDEO], folder)
    _call([str(vo), "synth", "walk", *_RECORDING], folder)
    _call([str(vo), "run", "walk", "--output", "run"], folder)
    _call([str(vo), "eval", "run", "walk"], folder)
    _call([str(python), "-c", _MAKE_CALIBRATION], folder)
    for name, *words in _EXAMPLES:
        _call([str(python), str(ROOT / "examples" / name), *words], folder)
    for trial in TRIALS:
        _try(trial, extra, vo, folder)
    if extra in ("foxglove", "all"):
        _call([str(python), "-c", "import foxglove"], folder)
    _call([str(python), "-m", "pip", "check"], folder)
    return size / _MB, _import_time(python, folder)


def _try(trial: Trial, extra: str, vo: Path, folder: Path) -> None:
    """Run a command that needs an extra, with or without it."""
    result = _run([str(vo), *trial.command], folder)
    has_extra = extra in (trial.extra, "all")
    is_told = trial.without in result.stdout + result.stderr
    is_right = is_told != has_extra
    if trial.is_refused and not has_extra:
        is_right &= result.returncode == 1 and result.stderr.count("\n") == 1
    if not is_right:
        raise SystemExit(
            f"error: with extra '{extra}', vo {' '.join(trial.command)} ended with status "
            f"{result.returncode}:\n{result.stdout}{result.stderr}"
        )


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _import_time(python: Path, folder: Path) -> float:
    """Wall time of `import vo` in a new process, less that of an empty one; medians."""
    times = {}
    for code in ("import vo", "pass"):
        walls = []
        for _ in range(_REPEATS):
            start = time.perf_counter()
            _call([str(python), "-c", code], folder)
            walls.append(time.perf_counter() - start)
        times[code] = statistics.median(walls)
    return times["import vo"] - times["pass"]


def _call(command: list[str], folder: Path) -> None:
    result = _run(command, folder)
    if result.returncode != 0:
        raise SystemExit(f"error: {' '.join(command)}:\n{result.stdout}{result.stderr}")


def _run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder, without the paths of this environment."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=1200
    )


if __name__ == "__main__":
    main()
