"""Pose graph of a run: collects stored keyframes, and has them placed by loops between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.scheduling import give_way
from vo.base.types import Floats
from vo.engine.places.records import InertialPose, Loop, PathKeyframe, PlaceKey, RegisteredKeyframes

if TYPE_CHECKING:  # imported with the first graph: it takes 15 ms
    from vo.engine.backend.graph_problem import GraphProblem


@dataclass(eq=False)
class _Node:
    key: PlaceKey
    chain: int
    is_rigid: bool
    is_metric: bool
    odom_from_cam: Floats
    scale: float
    covariance: Floats
    is_doubted: bool = False
    is_inertial: bool = False


class PoseGraph:
    """Collects stored keyframes, and has them optimised with loops.

    The result of `submit` is to be requested (`result`) at a fixed keyframe, so that it does not
    depend on the load of the machine.

    Args:
        threads: with more than one, graphs with loops are optimised in another thread.
    """

    def __init__(self, threads: int = 1) -> None:
        # Later graphs place the keyframes beside a motion anew, and less accurately.
        self._confirmed: set[PlaceKey] = set()  # by images in an earlier graph
        thread = partial(ThreadPoolExecutor, 1, thread_name_prefix="graph", initializer=give_way)
        self._thread = thread() if threads > 1 else None
        self._nodes: dict[PlaceKey, _Node] = {}
        self._first_segment = 0  # number of the chain of the run's segment 0
        self._submitted: GraphProblem | None = None
        self._solved: Callable[[], RegisteredKeyframes]  # that problem

    def add_keyframe(self, keyframe: PathKeyframe) -> None:
        """Add a keyframe of the run, after all before it in its segment."""
        self._nodes[keyframe.key] = _Node(
            keyframe.key,
            self._first_segment + keyframe.frame.segment,
            False,
            keyframe.is_metric,
            keyframe.odom_from_cam,
            1.0,
            keyframe.covariance,
            keyframe.is_doubted,
        )

    def add_map(self, registered: RegisteredKeyframes, *, is_metric: bool) -> None:
        """Add the keyframes of a loaded map, which keep their relative poses.

        To be called before any keyframe of the run is added. Worlds of the map keep their numbers,
        and segments of the run are numbered after them.
        """
        for n, key in enumerate(registered.keys):
            self._nodes[key] = _Node(
                key,
                int(registered.world[n]),
                True,
                is_metric,
                registered.world_from_cam[n],
                float(registered.scale[n]),
                np.zeros((6, 6)),
            )
        self._first_segment = int(registered.world.max(initial=-1)) + 1

    def remove_keyframes(self, keys: Sequence[PlaceKey], loops: Iterable[Loop] = ()) -> None:
        """Remove culled keyframes; the motions before and after each are joined.

        Keyframes of `loops` stay, for what these measured. Those removed before are ignored.
        """
        gone = {key for key in keys if key in self._nodes}
        gone -= {key for loop in loops if gone for key in (loop.earlier, loop.later)}
        if not gone:  # nothing to sort, as with most keyframes
            return
        carried: _Node | None = None
        for node in self._ordered():
            if carried is not None and carried.chain == node.chain:
                node.covariance = _joined(carried, node)
                node.is_doubted |= carried.is_doubted
            carried = node if node.key in gone else None
        for key in gone:
            del self._nodes[key]

    def submit(
        self,
        loops: Sequence[Loop],
        inertial: Mapping[PlaceKey, InertialPose] | None = None,
        doubted: Sequence[int] = (),
    ) -> None:
        """Begin to optimise the graph as it is now.

        Args:
            loops: verified, between its keyframes.
            inertial: poses of keyframes by an inertial sensor, where it has given them. They take
                the place of those by odometry, and other keyframes of their segments follow the
                nearest one before them. Segments in one world by the sensor are one chain.
            doubted: ids of markers whose loops are false.
        """
        self._start(self._problem(loops, inertial or {}, doubted))

    def _start(self, problem: GraphProblem) -> None:
        from vo.engine.backend.graph_solution import optimise_graph

        self._submitted, self._solved = problem, partial(optimise_graph, problem)
        if self._thread is not None and problem.loops:
            self._solved = self._thread.submit(self._solved).result

    def result(
        self, unconfirmed: Callable[[RegisteredKeyframes], Sequence[PlaceKey]] = lambda _: ()
    ) -> RegisteredKeyframes:
        """Wait for the placed keyframes of the graph that was submitted.

        Loops that the graph takes for false are in `rejected`; they may be accepted later, with
        more loops.

        Args:
            unconfirmed: names those keyframes of `RegisteredKeyframes.wrong` whose motion the
                images do not confirm. Their motions stay as they were.

        Raises:
            RuntimeError: nothing was submitted.
        """
        if self._submitted is None:
            raise RuntimeError("no graph was submitted")
        problem = self._submitted
        registered = self._solved()
        while refused := set(unconfirmed(registered) if registered.wrong else ()) - self._confirmed:
            trusted = [PlaceKey(*key) in refused for key in problem.keys.tolist()]
            problem = replace(problem, is_doubted=problem.is_doubted & ~np.array(trusted))
            self._start(problem)
            registered = self._solved()
        self._confirmed.update(registered.wrong)
        self._submitted = None
        return registered

    def close(self) -> None:
        """End the other thread."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)

    def _ordered(self) -> list[_Node]:
        return sorted(self._nodes.values(), key=_order)

    def _problem(
        self,
        loops: Sequence[Loop],
        inertial: Mapping[PlaceKey, InertialPose],
        doubted: Sequence[int],
    ) -> GraphProblem:
        from vo.engine.backend.graph_problem import GraphProblem

        nodes = self._ordered()
        if inertial:
            nodes = self._by_inertial_poses(nodes, inertial)
        return GraphProblem(
            keys=np.array([node.key for node in nodes], dtype=np.int64).reshape(-1, 2),
            chain=np.array([node.chain for node in nodes], dtype=np.int64),
            is_rigid=np.array([node.is_rigid for node in nodes], dtype=bool),
            is_metric=np.array([node.is_metric for node in nodes], dtype=bool),
            is_inertial=np.array([node.is_inertial for node in nodes], dtype=bool),
            odom_from_cam=np.array([node.odom_from_cam for node in nodes]).reshape(-1, 4, 4),
            scale=np.array([node.scale for node in nodes]),
            covariance=np.array([node.covariance for node in nodes]).reshape(-1, 6, 6),
            is_doubted=np.array([node.is_doubted for node in nodes], dtype=bool),
            loops=tuple(loops),
            doubted=tuple(doubted),
        )

    def _by_inertial_poses(
        self, nodes: Sequence[_Node], inertial: Mapping[PlaceKey, InertialPose]
    ) -> list[_Node]:
        """All nodes in their order, those of segments with inertial poses at these."""
        result: list[_Node] = []
        for segment, group in groupby(nodes, key=lambda node: node.chain):
            members = list(group)
            last = next((node for node in members if node.key in inertial), None)
            if last is None:
                result += members
                continue
            chain = self._first_segment + inertial[last.key].world
            for number, node in enumerate(members):
                last = node if node.key in inertial else last
                registered = _follow(node, last, inertial[last.key], chain)
                if number == 0 and segment != chain:  # no images lead here
                    registered.covariance = np.full((6, 6), np.nan)
                result.append(registered)
        return sorted(result, key=_order)


def _order(node: _Node) -> tuple[int, PlaceKey]:
    return node.chain, node.key


def _follow(node: _Node, last: _Node, known: InertialPose, chain: int) -> _Node:
    """A keyframe at the place that follows from the inertial pose of another one."""
    motion = inverse(last.odom_from_cam) @ node.odom_from_cam
    motion[:3, 3] *= known.scale
    return replace(
        node,
        chain=chain,
        odom_from_cam=known.world_from_cam @ motion,
        scale=known.scale,
        is_inertial=True,
    )


def _joined(before: _Node, after: _Node) -> Floats:
    """Covariance of two steps, of which the first ends in `before`, in the frame of `after`."""
    carried = adjoint(inverse(after.odom_from_cam) @ before.odom_from_cam)
    return np.asarray(carried @ before.covariance @ carried.T + after.covariance)
