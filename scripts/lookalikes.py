"""How different places that look alike are: the ratio of step 6 of the verification of loops.

Keyframes of a map file are compared with others of it, or with those of a second map, which are
chosen by their words: for each keyframe those that resemble it most among the ones that show
another place (further apart than 6 m, or turned by more than 45 degrees), and among those that show
the same place again (within 2 m and 30 degrees, more than 10 s apart). Counted are pairs that pass
all steps of the verification but the last one, by whether the relation that was found is true. Maps
are written by `vo run RECORDING --loops --save-map MAP --no-imu`. The results are in
docs/experiments/loop-verification.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from loops import pose_at, read_truth

from vo.base.config import Config
from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.types import Camera, Floats
from vo.engine.geometry import sim3
from vo.engine.places import loop_verification
from vo.engine.places.image_comparison import ComparedWindows, compare_images
from vo.engine.places.inverted_index import InvertedIndex
from vo.engine.places.landmark_search import KeyframePair
from vo.engine.places.loop_verification import LoopVerifier
from vo.engine.places.map_file import MapFile
from vo.engine.places.records import Loop, Place
from vo.engine.places.vocabulary_file import built_in_vocabulary

_SAME_M, _SAME_DEG, _AGAIN_S = 2.0, 30.0, 10.0
_OTHER_M, _OTHER_DEG = 6.0, 45.0
_NEIGHBOURS, _REACH, _MIN_SHARED = 6, 12, 15  # as in a run
_LIMIT = 0.04  # of the ratio, in step 6
_TRUE_M, _TRUE_DEG = 1.0, 5.0  # errors of a relation that is true


class Visit(NamedTuple):
    """The keyframes of a map in order, their camera, and their true poses (None: unknown)."""

    camera: Camera
    places: list[Place]
    poses: list[Floats | None]


class Compared(NamedTuple):
    """A pair that passed all steps but the last: whether its relation is true, and the ratio."""

    is_true: bool
    different: float


def main() -> None:
    """Print a row of the table for each of the two kinds of pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("recording", type=Path)
    parser.add_argument("other", nargs="*", type=Path, help="a map of another world, its recording")
    parser.add_argument("--queries", type=int, default=150)
    parser.add_argument("--alike", type=int, default=3, help="pairs of each kind for each of them")
    arguments = parser.parse_args()
    visit = _read(arguments.map, arguments.recording)
    other = _read(*arguments.other) if arguments.other else None
    tried, found = _compare(visit, other, arguments.queries, arguments.alike)
    for name, is_true in (("same place", True), ("another place", False)):
        ratios = np.array([pair.different for pair in found if pair.is_true == is_true])
        figures = "none"
        if len(ratios):
            figures = "smallest {:.3f}, median {:.3f}, 95 % {:.3f}, largest {:.3f}".format(
                *np.quantile(ratios, (0.0, 0.5, 0.95, 1.0))
            )
            figures += f", above {_LIMIT}: {int((ratios > _LIMIT).sum())}"
        print(f"{arguments.map.stem}, {name}: {tried[is_true]} tried, {len(ratios)}: {figures}")


def _read(file: Path, recording: Path) -> Visit:
    with MapFile(file) as stored:
        places = [stored.place(key) for key in sorted(stored.keys)]
        truth = read_truth(recording)
        return Visit(
            stored.header.camera, places, [pose_at(truth, p.frame.stamp_ns) for p in places]
        )


def _compare(
    visit: Visit, other: Visit | None, queries: int, alike: int
) -> tuple[dict[bool, int], list[Compared]]:
    """Numbers of pairs of the same and of another place that were tried, and those compared."""
    vocabulary, config = built_in_vocabulary(), Config()
    searched = visit if other is None else other
    index = InvertedIndex(vocabulary.words)
    for place in searched.places:
        index.add(vocabulary.bag(place.descriptor))
    verifier = LoopVerifier(config.features.scale_factor, sigma_px=config.patches.sigma_px)
    tried, found = {True: 0, False: 0}, []
    step = max(1, len(visit.places) // queries)
    for n in range(2, len(visit.places), step):
        later = [visit.places[n - k] for k in range(3)]
        if len({place.frame.segment for place in later}) > 1 or visit.poses[n] is None:
            continue
        order = np.argsort(-index.scores(vocabulary.bag(later[0].descriptor)), kind="stable")
        kinds = [_kind(visit, n, searched, m, other is not None) for m in order.tolist()]
        for is_same in (True, False):
            rows = [m for m, kind in zip(order.tolist(), kinds, strict=True) if kind is is_same]
            for m in rows[:alike]:
                tried[is_same] += 1
                pair = _verify(verifier, visit, n, searched, m, is_other=other is not None)
                found += [] if pair is None else [pair]
    return tried, found


def _kind(visit: Visit, n: int, searched: Visit, m: int, is_other: bool) -> bool | None:
    """Whether two keyframes show the same place; None between the two kinds."""
    if is_other:
        return False
    first, second = visit.poses[n], searched.poses[m]
    if first is None or second is None:
        return None
    motion = inverse(first) @ second
    metres, degrees = np.linalg.norm(motion[:3, 3]), np.degrees(rotation_angle(motion[:3, :3]))
    if metres > _OTHER_M or degrees > _OTHER_DEG:
        return False
    apart_s = 1e-9 * abs(visit.places[n].frame.stamp_ns - searched.places[m].frame.stamp_ns)
    return True if metres < _SAME_M and degrees < _SAME_DEG and apart_s > _AGAIN_S else None


def _verify(
    verifier: LoopVerifier, visit: Visit, n: int, searched: Visit, m: int, *, is_other: bool
) -> Compared | None:
    """The pair if it passes all steps but the last one."""
    ratios: list[float] = []

    def compare(
        pair: KeyframePair, earlier: Sequence[Place], later: Sequence[Place], relation: Floats
    ) -> ComparedWindows:
        windows = compare_images(pair, earlier, later, relation)
        ratios.append(windows.different / max(windows.compared, 1))
        return ComparedWindows(windows.compared, 0)  # so that no pair is refused

    later = [visit.places[n - k] for k in range(3)]
    with patch.object(loop_verification, "compare_images", compare):
        result = verifier.verify(later, _beside(searched, m), visit.camera, searched.camera)
    if not isinstance(result, Loop):
        return None
    is_true = not is_other and _is_true(result, visit, n, searched, m)
    return Compared(is_true, ratios[0])


def _beside(visit: Visit, m: int) -> list[Place]:
    """A keyframe, then those of its visit with landmarks in common, most first."""
    place = visit.places[m]
    shared = []
    for other in visit.places[max(m - _REACH, 0) : m + _REACH + 1]:
        if other is not place and other.frame.segment == place.frame.segment:
            count = len(np.intersect1d(place.landmarks.id, other.landmarks.id, assume_unique=True))
            shared += [(-count, other.key, other)] if count >= _MIN_SHARED else []
    return [place, *(other for _, _, other in sorted(shared, key=lambda s: s[:2])[:_NEIGHBOURS])]


def _is_true(loop: Loop, visit: Visit, n: int, searched: Visit, m: int) -> bool:
    """Whether a relation is that of the true poses."""
    first, second = searched.poses[m], visit.poses[n]
    assert first is not None and second is not None
    true = inverse(first) @ second
    found = sim3.rigid_part(loop.earlier_from_later).copy()
    found[:3, 3] *= _metres(searched, m)
    error = inverse(true) @ found
    turned = np.degrees(rotation_angle(error[:3, :3]))
    return bool(np.linalg.norm(error[:3, 3]) < _TRUE_M and turned < _TRUE_DEG)


def _metres(visit: Visit, m: int) -> float:
    """Metres of a unit of the map near a keyframe, by the keyframes beside it."""
    if visit.places[m].is_metric:
        return 1.0
    near = [
        k
        for k in range(max(m - _REACH, 0), min(m + _REACH + 1, len(visit.places)))
        if visit.places[k].frame.segment == visit.places[m].frame.segment
        and visit.poses[k] is not None
    ]
    known = np.array([pose[:3, 3] for k in near if (pose := visit.poses[k]) is not None])
    odometry = np.array([visit.places[k].odom_from_cam[:3, 3] for k in near])
    return float(
        np.linalg.norm(known - known.mean(0)) / np.linalg.norm(odometry - odometry.mean(0))
    )


if __name__ == "__main__":
    main()
