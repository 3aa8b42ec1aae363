"""Bounding-volume hierarchy of the solids."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, Ints


class Tree(NamedTuple):
    """Nodes in depth-first order."""

    bounds: Floats  # (M, 6) lower then upper corners
    skip: Ints  # (M,) the next node if the ray misses this one
    solid: Ints  # (M,) the solid of a leaf, -1 for inner nodes


def build_tree(bounds: Floats) -> Tree:
    """Build the tree of solids with bounds (N, 6); traversal is in order, without a stack."""
    nodes: list[Floats] = []
    leaf: list[int] = []
    pending = [np.arange(len(bounds))] if len(bounds) else []
    while pending:
        members = pending.pop()
        lower, upper = bounds[members, :3].min(axis=0), bounds[members, 3:].max(axis=0)
        nodes.append(np.concatenate([lower, upper]))
        leaf.append(int(members[0]) if len(members) == 1 else -1)
        if len(members) > 1:
            pending.extend(reversed(_split(bounds, members)))
    skip = np.arange(1, len(nodes) + 1)
    for node in range(len(nodes) - 1, -1, -1):
        if leaf[node] < 0:
            skip[node] = skip[skip[node + 1]]  # behind its first child, then behind its second
    return Tree(np.array(nodes).reshape(-1, 6), skip, np.array(leaf, dtype=np.int64))


def _split(bounds: Floats, members: Ints) -> tuple[Ints, Ints]:
    """Split by the surface area heuristic (MacDonald and Booth 1990), along any axis."""
    best, halves = np.inf, (members[:1], members[1:])
    counts = np.arange(1, len(members))
    for axis in range(3):
        middles = bounds[members, axis] + bounds[members, axis + 3]
        order = members[np.argsort(middles, kind="stable")]
        before = _growing_areas(bounds[order])[:-1]
        after = _growing_areas(bounds[order[::-1]])[:-1][::-1]
        costs = before * counts + after * counts[::-1]
        at = int(np.argmin(costs))
        if costs[at] < best:
            best, halves = float(costs[at]), (order[: at + 1], order[at + 1 :])
    return halves


def _growing_areas(bounds: Floats) -> Floats:
    """Half the surface area of the bounds of the first 1, 2, … boxes."""
    lower = np.minimum.accumulate(bounds[:, :3])
    upper = np.maximum.accumulate(bounds[:, 3:])
    x, y, z = (upper - lower).T
    return np.asarray(x * y + y * z + z * x)
