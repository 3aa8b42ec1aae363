"""Whether images confirm a motion that loops have put in place of a doubted one.

Loops that agree with each other may all be false, as of a copy of a place. The keyframes before
and after the motion saw the same surroundings a moment apart: under the right motion they look the
same around their landmarks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from vo.base.types import Camera, Floats
from vo.engine.geometry import sim3
from vo.engine.loop_verification.image_comparison import ComparedWindows, compare_images
from vo.engine.loop_verification.landmark_search import keyframe_pair
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Place, PlaceKey, RegisteredKeyframes

_BESIDE = 3  # keyframes that are compared on each side
# Windows that are compared in all pairs, and ratio of those that may look different. Of motions
# drawn within the limits of repairs none had less than 0.57, and of true ones 19 in 20 had less
# than 0.17. Odometry that agrees as well must be improved by a factor.
_MIN_WINDOWS, _MAX_DIFFERENT, _MIN_IMPROVEMENT = 30, 0.3, 2.0


def unconfirmed_repairs(
    database: KeyframeDatabase, camera: Camera, registered: RegisteredKeyframes
) -> tuple[PlaceKey, ...]:
    """Those of the keyframes `registered.wrong` whose new motion the images do not confirm.

    Where images confirm odometry, only these are returned: a motion that is free without need takes
    a part of the correction of others.
    """
    keys = [key for key in registered.keys if key in database or key in registered.wrong]
    poses = sim3.similarity(registered.world_from_cam, registered.scale)
    world_from = dict(zip(registered.keys, poses, strict=True))
    right: list[PlaceKey] = []
    unconfirmed: list[PlaceKey] = []
    for motion in _consecutive(keys, registered.wrong):
        first, last = keys.index(motion[0]), keys.index(motion[-1])
        before = _stored(database, keys[max(first - 2 * _BESIDE, 0) : first][::-1])
        after = _stored(database, keys[last : last + 2 * _BESIDE])
        by_loops, by_odometry = _compared(before, after, camera, world_from)
        if by_odometry.agree and by_odometry.ratio <= _MIN_IMPROVEMENT * by_loops.ratio:
            right += motion
        elif not by_loops.agree or by_odometry.ratio <= by_loops.ratio:
            unconfirmed += motion
    return tuple(right or unconfirmed)


def _consecutive(keys: Sequence[PlaceKey], wrong: Sequence[PlaceKey]) -> list[list[PlaceKey]]:
    """The wrong keyframes, in groups that follow each other."""
    groups: list[list[PlaceKey]] = []
    number = {key: n for n, key in enumerate(keys)}
    for key in sorted(wrong):
        if groups and number[groups[-1][-1]] + 1 == number[key]:
            groups[-1].append(key)
        else:
            groups.append([key])
    return groups


def _stored(database: KeyframeDatabase, keys: Sequence[PlaceKey]) -> list[Place]:
    """Keyframes of the segment of the first one."""
    places = [database.get(key) for key in keys if key in database]
    return [p for p in places if p.frame.segment == places[0].frame.segment]


class _Windows(ComparedWindows):
    """Those of several pairs of keyframes."""

    @property
    def ratio(self) -> float:
        """Those that look different, all if too few were compared."""
        return self.different / self.compared if self.compared >= _MIN_WINDOWS else 1.0

    @property
    def agree(self) -> bool:
        """Whether hardly any look different."""
        return self.ratio <= _MAX_DIFFERENT


def _compared(
    before: Sequence[Place],
    after: Sequence[Place],
    camera: Camera,
    world_from: Mapping[PlaceKey, Floats],
) -> tuple[_Windows, _Windows]:
    """Windows by the graph and by odometry, of all pairs of the nearest keyframes."""
    by_loops, by_odometry = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for a, b in product(range(len(before[:_BESIDE])), range(len(after[:_BESIDE]))):
        earlier, later = before[a:], after[b:]
        if earlier[0].frame.segment != later[0].frame.segment:
            continue
        pair = keyframe_pair(later[0], earlier[:1], camera)
        registered = sim3.inverse(world_from[earlier[0].key]) @ world_from[later[0].key]
        tracked = sim3.inverse(earlier[0].odom_from_cam) @ later[0].odom_from_cam
        by_loops += compare_images(pair, earlier, later, registered)
        by_odometry += compare_images(pair, earlier, later, tracked)
    return _Windows(*by_loops.tolist()), _Windows(*by_odometry.tolist())
