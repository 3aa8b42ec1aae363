"""Runs `vo run` on one camera with and without its inertial sensor, and compares with the truth.

Recordings are the suite of `vo synth`, rendered once into --cache, or those given as arguments:
EuRoC folders with true states of the body. The second of each pair of runs has --no-imu; the ratio
of their CPU times is that of one pair.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from common import EXPERIMENTS, parser_of, run_vo, suite, write_section

from vo.base.geometry.similarity import umeyama
from vo.base.types import Floats
from vo.recordings.formats.trajectory import read_trajectory
from vo.recordings.sources.registry import open_source

PAGE = EXPERIMENTS / "inertial-accuracy.md"
HEADING = (
    "| recording | path, m | known after, s | scale error, % | stated, % | ATE, m | ATE, % | "
    "tilt, ° | gyro bias, mrad/s | accelerometer bias, m/s² | CPU time |",
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
)


def main() -> int:
    """Run all, print the table, and with --write put it into the page."""
    parser = parser_of("inertial", __doc__, "only", "cache", "write")
    parser.add_argument("recordings", nargs="*", type=Path, help="recordings instead of the suite")
    arguments = parser.parse_args()
    rendered = suite(arguments.cache, "format=euroc")
    chosen = [make for name, make in rendered.items() if arguments.only in name]
    rows = [measure(path) for path in arguments.recordings or (make() for make in chosen)]
    table = "\n".join((*HEADING, *rows))
    print(table)
    if arguments.write:
        write_section(PAGE, "inertial", table)
    return 0


def measure(recording: Path) -> str:
    """Row of the table of one recording."""
    name = re.sub(r"-[0-9a-f]{10}$", "", recording.name)
    with TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        options = ("--mode", "mono", "--quiet")
        run = run_vo(recording, output, *options)
        without = run_vo(recording, Path(folder) / "without", *options, "--no-imu")
        ratio, summary = run.cpu_s / without.cpu_s, run.summary
        use = summary["inertial"]
        if use["states"] is None or summary["length_unit"] != "m":
            return (
                f"| {name} | {use['reason'] or summary['verdict']} | | | | | | | | | {ratio:.2f} |"
            )
        rows = np.loadtxt(output / "poses.csv", delimiter=",", skiprows=1)
        found = read_trajectory(output / "trajectory.tum")
    longest = np.bincount(rows[:, 2].astype(int)).argmax()
    chosen = rows[:, 2] == longest
    stamps, poses = found.stamps_ns[chosen], found.world_from_cam[chosen]
    truth = open_source(recording).ground_truth
    assert truth is not None
    at = np.clip(np.searchsorted(truth.stamps_ns, stamps - 1_000_000), 0, len(truth) - 1)
    true = truth.world_from_cam[at]
    length = float(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum())
    scale = umeyama(poses[:, :3, 3], true[:, :3, 3], with_scale=True).scale
    ate = _ate(poses, true)
    known = 1e-9 * float(stamps[np.searchsorted(rows[chosen, 0], use["first_frame"])] - stamps[0])
    states = use["states"]
    tilt, gyro, accel = _against_states(recording, int(stamps[-1]), poses, true, states)
    return (
        f"| {name} | {length:.1f} | {known:.1f} | {100 * (1 / scale - 1):+.2f} "
        f"| {100 * states['scale_sigma']:.2f} | {ate:.4f} | {100 * ate / length:.2f} "
        f"| {tilt} | {gyro} | {accel} | {ratio:.2f} |"
    )


def _ate(poses: Floats, true: Floats) -> float:
    fit = umeyama(poses[:, :3, 3], true[:, :3, 3], with_scale=False)
    moved = poses[:, :3, 3] @ fit.rotation.T + fit.translation
    return float(np.sqrt(((moved - true[:, :3, 3]) ** 2).sum(axis=1).mean()))


def _against_states(
    recording: Path, stamp_ns: int, poses: Floats, true: Floats, states: dict[str, Any]
) -> tuple[str, str, str]:
    """Largest tilt, and errors of the biases at the end, where the truth has them."""
    table = recording / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    rows = np.loadtxt(table, delimiter=",", comments="#", ndmin=2)
    cosine = (poses[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2))[:, 2, 2]
    tilt = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max()
    if rows.shape[1] < 17:
        return f"{tilt:.2f}", "", ""
    row = rows[np.argmin(np.abs(rows[:, 0] - stamp_ns))]
    gyro = np.linalg.norm(states["gyro_bias_rad_s"] - row[11:14])
    accel = np.linalg.norm(states["accel_bias_m_s2"] - row[14:17])
    return f"{tilt:.2f}", f"{1e3 * gyro:.2f}", f"{accel:.3f}"


if __name__ == "__main__":
    sys.exit(main())
