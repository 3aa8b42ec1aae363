"""Public data sets: their sequences, calibration and ground truth, and the table of papers.

Layouts are those in which the data sets are distributed, unpacked into one folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from vo.base.errors import SourceError
from vo.runs.batch.job import Job, JobResult

_MAX_DEPTH = 3  # of sequences below the folder of a data set
_HILTI_TOPICS = ("left=/alphasense/cam0/image_raw", "right=/alphasense/cam1/image_raw")
_HILTI_LOGS = (".bag", ".db3", ".mcap")


class Metric(NamedTuple):
    """A column of the table: its heading, and the attribute of `JobResult`."""

    heading: str
    attribute: str


ATE = Metric("ATE, m", "ate_m")
_DRIFT = (Metric("t_rel, %", "drift_percent"), Metric("r_rel, °/100 m", "drift_deg_per_100m"))


@dataclass(frozen=True)
class Dataset:
    """A public data set.

    Attributes:
        title: as papers name it.
        is_sequence: whether a file or folder is a sequence of it.
        options: attributes of the `Job` of a sequence.
        name: name of a sequence in tables.
        metrics: columns of the table.
        expected: what its folder contains, for messages.
    """

    title: str
    is_sequence: Callable[[Path], bool]
    expected: str
    options: Callable[[Path], dict[str, Any]] = lambda _: {}
    name: Callable[[Path], str] = lambda path: path.stem if path.is_file() else path.name
    metrics: tuple[Metric, ...] = (ATE,)


def sequences_of(key: str, folder: Path, options: Job) -> list[Job]:
    """A job for each sequence of a data set, in the order of their names.

    Raises:
        SourceError: there is no sequence of it.
    """
    dataset = DATASETS[key]
    found = sorted(_below(folder, dataset, _MAX_DEPTH)) if folder.is_dir() else []
    if not found:
        raise SourceError(
            f"{folder} has no sequence of {dataset.title}; expected is {dataset.expected}"
        )
    return [
        replace(
            options,
            **{
                "source": str(path),
                "name": dataset.name(path),
                "tags": {**options.tags, "dataset": key},
                **{k: v for k, v in dataset.options(path).items() if not getattr(options, k)},
            },
        )
        for path in found
    ]


def _below(path: Path, dataset: Dataset, depth: int) -> Iterator[Path]:
    if dataset.is_sequence(path):
        yield path
    elif depth and path.is_dir():
        for child in path.iterdir():
            if not child.name.startswith("."):
                yield from _below(child, dataset, depth - 1)


def table_of(key: str, results: Sequence[JobResult]) -> str:
    """The table that papers print, as Markdown: a row for each sequence, and the mean.

    A result that failed or is not to be trusted is marked, and a path in several parts has their
    number, as its errors are those of the longest. The mean is over the sequences with figures.
    """
    dataset = DATASETS[key]
    heads = ["sequence", "frames with a pose", *(metric.heading for metric in dataset.metrics)]
    rows = [_row(result, dataset.metrics) for result in results]
    means = [_mean(results, metric.attribute) for metric in dataset.metrics]
    ratios = [r.tracked_ratio for r in results if r.tracked_ratio is not None]
    rows.append(["mean", f"{100 * fmean(ratios):.1f} %" if ratios else "–", *means])
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _row(result: JobResult, metrics: Sequence[Metric]) -> list[str]:
    if not result.is_done:
        return [result.name, result.status.value, *["–"] * len(metrics)]
    share = f"{100 * (result.tracked_ratio or 0.0):.1f} %"
    if (result.segments or 0) > 1:
        share += f" in {result.segments}"
    if result.trusted is False:
        share += ", not to be trusted"
    return [result.name, share, *(_figure(getattr(result, m.attribute)) for m in metrics)]


def _mean(results: Sequence[JobResult], attribute: str) -> str:
    values = [getattr(result, attribute) for result in results]
    known = [value for value in values if value is not None]
    return _figure(fmean(known) if known else None)


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _is_euroc(path: Path) -> bool:
    return (path / "mav0" / "cam0").is_dir()


def _is_kitti(path: Path) -> bool:
    return (path / "times.txt").is_file() and any((path / f"image_{n}").is_dir() for n in (0, 2))


def _is_tum(path: Path) -> bool:
    return (path / "rgb.txt").is_file() and (path / "groundtruth.txt").is_file()


def _tum_options(path: Path) -> dict[str, Any]:
    """The calibration, which is published and not in the recordings."""
    found = re.search(r"freiburg([123])", path.name)
    if (path / "calibration.yaml").is_file() or found is None:
        return {}
    file = files("vo.runs.batch") / "tum_rgbd" / f"freiburg{found[1]}.yaml"
    return {"calibration": str(file)}


def _is_hilti(path: Path) -> bool:
    return path.suffix in _HILTI_LOGS or (path / "metadata.yaml").is_file()


def _hilti_options(path: Path) -> dict[str, Any]:
    """The front pair; calibration and ground truth of the IMU are files of their own."""
    options: dict[str, Any] = {"topics": _HILTI_TOPICS}
    beside = [path.parent, *(path.parent / name for name in ("calibration", "groundtruth", "gt"))]
    chains = [file for folder in beside for file in sorted(folder.glob("*camchain*.yaml"))]
    if chains:
        options["calibration"] = str(chains[0])
    key = _hilti_key(path.stem)
    truths = [
        file
        for folder in beside
        for file in sorted(folder.glob("*.txt"))
        if _hilti_key(file.stem) == key
    ]
    if truths:
        options |= {"truth": str(truths[0]), "is_truth_of_body": True}
    return options


def _hilti_key(stem: str) -> str:
    """`exp04` of `exp_04_construction_upper_level_imu` and of `exp04_construction_upper_level`."""
    found = re.match(r"exp_?(\d+)", stem)
    return f"exp{found[1]}" if found else re.sub(r"_(imu|prism|gt)$", "", stem)


DATASETS: dict[str, Dataset] = {
    "euroc": Dataset(
        "EuRoC MAV", _is_euroc, "MH_01_easy/mav0 and so on, with state_groundtruth_estimate0"
    ),
    "kitti": Dataset(
        "KITTI odometry",
        _is_kitti,
        "sequences/00 with image_0 and image_1 (or image_2 and image_3), and poses/00.txt",
        metrics=(*_DRIFT, ATE),
    ),
    "tum": Dataset(
        "TUM RGB-D",
        _is_tum,
        "rgbd_dataset_freiburg1_xyz and so on, each with rgb.txt and groundtruth.txt",
        options=_tum_options,
    ),
    "tumvi": Dataset("TUM-VI", _is_euroc, "dataset-room1_512_16/mav0 and so on"),
    "4seasons": Dataset(
        "4Seasons",
        lambda path: (path / "undistorted_images").is_dir(),
        "recording_…/undistorted_images and so on, and a folder calibration beside them",
    ),
    "hilti": Dataset(
        "Hilti SLAM Challenge",
        _is_hilti,
        "exp01_….bag and so on, beside them Kalibr's camchain file and exp01_…_imu.txt",
        options=_hilti_options,
    ),
}
