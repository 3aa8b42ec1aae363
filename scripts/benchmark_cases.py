"""Sequences of the benchmark, the results of other systems on them, and the targets of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Peer:
    """Result of another system: frames with a pose, ATE in metres, RPE in metres per frame."""

    system: str
    frames: str
    ate: float | None = None
    ate_causal: float | None = None
    rpe: float | None = None


@dataclass(frozen=True)
class Case:
    """A sequence in one mode, with its targets and the results of other systems."""

    folder: str  # name of the sequence's folder inside the data folder
    mode: str  # `mono` or `stereo`
    images: tuple[str, ...]  # glob patterns of the images of each camera
    ate: float | None = None  # maximum ATE in metres
    scale: float | None = None  # maximum error of scale in percent
    # minimum number of frames with a pose; by default all after the start-up
    frames: int | None = None
    # the images show too little: a loss is correct, only a wrong path is a failure
    hard: bool = False
    ate_percent: float | None = None
    t_rel: float | None = None  # maximum drift in percent
    imu: bool = False  # with the inertial sensor, in metres with one camera too
    peers: tuple[Peer, ...] = ()

    @property
    def name(self) -> str:
        """Sequence, mode and sensor."""
        return f"{self.folder} {self.mode}" + (" + IMU" if self.imu else "")


# On a hard sequence tracking may be lost, but the poses given must be this close to the truth.
HARD_ATE_M, HARD_ATE_RATIO = 0.1, 0.02

_KITTI = ("image_0/*.png", "image_1/*.png")
_RAW = ("cam0/data/*.png", "cam1/data/*.png")
_MAV = ("mav0/cam0/data/*.png", "mav0/cam1/data/*.png")
_06, _07, _HALL = "kitti06_stereo_000-050", "kitti07_mono_000-099", "rendered_hall_stereo"

CASES = (
    Case(_06, "stereo", _KITTI, ate=0.10, scale=2.0, peers=(
        Peer("ORB-SLAM3", "51/51", 0.051, None, 0.011),
        Peer("libviso2", "51/51", None, 0.120, 0.014),
        Peer("tutorial", "51/51", None, 0.419, 0.044),
    )),
    Case(_06, "mono", _KITTI[:1], ate=0.08, peers=(
        Peer("ORB-SLAM3", "50/51", 0.023, 0.066, 0.010),
        Peer("pycolmap", "51/51", 0.026, None, 0.008),
        Peer("libviso2", "51/51", None, 0.236, 0.060),
        Peer("tutorial", "51/51", None, 0.350, 0.236),
    )),
    Case(_07, "mono", _KITTI[:1], ate=0.35, frames=90, peers=(
        Peer("ORB-SLAM3", "96/100", 0.277, 0.288, 0.023),
    )),
    Case("kitti_raw_stereo_000-099", "stereo", _RAW, ate=0.25, scale=1.0, peers=(
        Peer("ORB-SLAM3", "98/98", 0.495, None, 0.101),
        Peer("libviso2", "98/98", None, 0.159, 0.024),
    )),
    Case(_HALL, "stereo", _MAV, ate=0.03, peers=(
        Peer("ORB-SLAM3", "200/200", 0.0051, 0.0065, 0.0032),
        Peer("libviso2", "200/200", None, 0.030, 0.0048),
    )),
    Case(_HALL, "mono", _MAV[:1], ate=0.10),
    Case("tum_fr3_cabinet_58_lowtexture", "mono", ("rgb/*.*",), hard=True),
)  # fmt: skip


def suite_cases(folders: list[str]) -> tuple[Case, ...]:
    """The synthetic suite in stereo and mono; `_hard_` in a name marks a hard sequence."""
    cases = []
    for folder in folders:
        if "_hard_" in folder:
            cases += [Case(folder, "stereo", _MAV, hard=True)]
            cases += [Case(folder, "mono", _MAV[:1], hard=True)]
        else:
            cases += [Case(folder, "stereo", _MAV, ate_percent=0.3, t_rel=0.3)]
            cases += [Case(folder, "mono", _MAV[:1], ate_percent=0.5)]
    return tuple(cases)


def hard_cases(folders: list[str]) -> tuple[Case, ...]:
    """The set that only a camera with an inertial sensor can pass, with and without it."""
    cases = []
    for folder in folders:
        cases += [Case(folder, "stereo", _MAV, ate_percent=0.2, imu=True)]
        cases += [Case(folder, "mono", _MAV[:1], scale=1.0, imu=True)]
        cases += [Case(folder, "stereo", _MAV, hard=True)]
        cases += [Case(folder, "mono", _MAV[:1], hard=True)]
    return tuple(cases)


def judge(case: Case, result: dict[str, Any]) -> list[tuple[str, bool]]:
    """Each target of a case, and whether the result reaches it."""
    if result.get("failed"):
        return [("runs to its end", False)]
    targets = [("same bits", result["same_bits"])] if result["same_bits"] is not None else []
    if case.hard:
        return [*targets, ("no wrong path", not _is_wrong(result))]
    posed = result["frames"] - result["starting"] if case.frames is None else case.frames
    targets += [
        (f"frames ≥ {posed}", result["posed"] >= posed),
        ("one segment", result["segments"] == 1),
    ]
    for name, key, limit in (
        (f"ATE ≤ {case.ate or 0:.2f}", "ate_m", case.ate),
        (f"ATE ≤ {case.ate_percent or 0:g} %", "ate_percent", case.ate_percent),
        (f"t_rel ≤ {case.t_rel or 0:g} %", "t_rel_percent", case.t_rel),
        (f"scale within {case.scale or 0:g} %", "scale_percent", case.scale),
    ):
        if limit is not None:
            value = result[key]
            targets.append((name, value is not None and abs(value) <= limit))
    return targets


def missed(cases: dict[str, Case], results: list[dict[str, Any]]) -> list[str]:
    """Lines that name each run with a missed target."""
    lines = []
    for result in results:
        case = cases[result["name"]]
        targets = [name for name, reached in judge(case, result) if not reached]
        if targets:
            lines.append(f"{case.name}: {'; '.join(targets)}")
    return lines


def _is_wrong(result: dict[str, Any]) -> bool:
    """Whether a path is too far from the truth even for a hard sequence."""
    limit_m = max(HARD_ATE_M, HARD_ATE_RATIO * (result["path_m"] or 0.0))
    return result["ate_m"] is not None and bool(result["ate_m"] > limit_m)
