"""Pose graph: places stored keyframes in the map frame, by odometry and loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vo.places.records import Loop, Place, PlacedKeyframes, PlaceKey
from vo.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class GraphProblem:
    """Stored keyframes and loops between them, as plain arrays for another process.

    Rows are keyframes in order of their keys. Those of a chain follow each other.

    Attributes:
        keys: (n, 2) session and keyframe.
        chain: (n,) number of the chain of each: a segment, or a world of a loaded map.
        is_rigid: (n,) keyframes of a loaded map, which do not move relative to each other.
        is_metric: (n,) whether lengths of the chain are metres.
        odom_from_cam: (n, 4, 4), in a loaded map its world_from_cam.
        covariance: (n, 6, 6) of the motion since the row before, in this camera's frame; ignored
            in the first row of a chain, and where keyframes are rigid.
        loops: between them.
    """

    keys: Ints
    chain: Ints
    is_rigid: Bools
    is_metric: Bools
    odom_from_cam: Floats
    covariance: Floats
    loops: tuple[Loop, ...]


class PoseGraph:
    """Collects stored keyframes and loops, and has them optimised.

    The answer to `submit` is to be taken in by `result` at a fixed keyframe, so that it does not
    depend on the load of the machine.

    Args:
        threads: with more than one, graphs are optimised in another process, which is started by
            the first `submit`.
    """

    def __init__(self, threads: int = 1) -> None:
        self._threads = threads
        self._places: list[Place] = []
        self._loops: list[Loop] = []

    def add_keyframe(self, place: Place) -> None:
        """Add a keyframe that was stored, after all before it in its segment."""
        self._places.append(place)

    def add_map(self, placed: PlacedKeyframes, is_metric: Sequence[bool]) -> None:
        """Add the keyframes of a loaded map, which keep their relative poses.

        Args:
            placed: where they are in the map.
            is_metric: (n,) whether lengths are metres.
        """

    def add_loop(self, loop: Loop) -> None:
        """Add a verified loop between keyframes that were added."""
        self._loops.append(loop)

    def submit(self) -> None:
        """Begin to optimise the graph as it is now."""

    def result(self) -> PlacedKeyframes:
        """Wait for the placed keyframes of the graph that was submitted.

        Loops that the graph does not believe are in `rejected`; they stay in the graph and may be
        believed later, with more evidence.

        Raises:
            RuntimeError: nothing was submitted.
        """
        return optimise_graph(self._problem())

    def remove_keyframes(self, keys: Sequence[PlaceKey]) -> None:
        """Remove culled keyframes; the motions of their neighbours are joined.

        Keyframes of loops stay.
        """

    def close(self) -> None:
        """End the other process."""

    def _problem(self) -> GraphProblem:
        raise NotImplementedError


def optimise_graph(problem: GraphProblem) -> PlacedKeyframes:
    """Place all keyframes in worlds, in this process."""
    count = len(problem.keys)
    keys = tuple(PlaceKey(int(s), int(k)) for s, k in problem.keys)
    return PlacedKeyframes(
        keys,
        problem.chain,
        problem.odom_from_cam.copy(),
        np.ones(count),
        np.full((count, 6, 6), np.nan),
        (),
    )
