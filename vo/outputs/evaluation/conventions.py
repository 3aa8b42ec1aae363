"""Conventions of a reference that explain its rotations or positions much better than its own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import (
    inverse,
    quat_xyzw_from_rotation,
    rotation_angle,
    rotation_from_quat_xyzw,
    so3_log,
)
from vo.base.types import Floats
from vo.outputs.evaluation.association import MatchedPoses
from vo.outputs.evaluation.pose_errors import rotation_angles_deg

_BETTER = 4.0  # ratio of errors at which another convention is named
_MIN_ERROR_DEG = 1.0
_MIN_POSES = 20
_MOST_POSES = 400
_MAX_SHIFT_S = 1.0
_MIN_UNEXPLAINED = 0.01  # of the variance of positions


def convention_notes(matched: MatchedPoses) -> list[str]:
    """What is said in one sentence, if the poses of one side follow another convention.

    Compared are motions over a twentieth of the path, which no alignment changes: with quaternions
    of another order, inverted poses, another frame on the body, mirrored axes, other stamps.
    """
    rows = slice(None, None, max(1, len(matched) // _MOST_POSES))
    estimate, reference = matched.estimate[rows], matched.reference[rows]
    if len(estimate) < _MIN_POSES:
        return []
    inverted = inverse(reference)
    as_given, other = (_unexplained(estimate, each) for each in (reference, inverted))
    if as_given > _MIN_UNEXPLAINED and as_given > _BETTER**2 * other:
        return ["the positions fit if the poses of one side are inverted: world_from_cam is needed"]
    motions, true = _motions(estimate[:, :3, :3]), _motions(reference[:, :3, :3])
    error = _error(motions, true)
    if error < _MIN_ERROR_DEG:
        return []
    step_s = float(np.median(np.diff(matched.seconds[rows])))
    mirrored = reference * np.array([[1.0], [1.0], [-1.0], [1.0]])
    is_mirrored = as_given > 2.0 * _unexplained(estimate, mirrored)
    tried = _alternatives(estimate[:, :3, :3], reference[:, :3, :3], step_s, is_mirrored)
    found = min(tried, key=lambda each: each[0])
    if error < _BETTER * found[0]:
        return []
    return [f"motions differ by {error:.1f}° in rotation, by {found[0]:.1f}° {found[1]}"]


def _alternatives(
    estimate: Floats, reference: Floats, step_s: float, is_mirrored: bool
) -> Iterator[tuple[float, str]]:
    """Errors in degrees under other conventions, with what each is."""
    motions, true = _motions(estimate), _motions(reference)
    for name, sides in (("estimate", (estimate, reference)), ("reference", (reference, estimate))):
        quat = np.array([quat_xyzw_from_rotation(each) for each in sides[0]])
        for order, columns in (("qw qx qy qz", [1, 2, 3, 0]), ("qx qy qz qw", [3, 0, 1, 2])):
            again = rotation_from_quat_xyzw(quat[:, columns])
            error = _error(_motions(again), _motions(sides[1]))
            yield error, f"if the quaternions of the {name} are read in the order {order}"
    most = min(len(motions) // 4, round(_MAX_SHIFT_S / max(step_s, 1e-9)))
    for shift in range(1, most + 1):
        late, early = _error(motions[shift:], true[:-shift]), _error(motions[:-shift], true[shift:])
        word = "later" if late < early else "earlier"
        yield min(late, early), f"with stamps of the reference {shift * step_s:.2g} s {word}"
    vectors, wanted = (np.array([so3_log(each) for each in rows]) for rows in (motions, true))
    u, _, vt = np.linalg.svd(wanted.T @ vectors)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    angles = np.rad2deg(np.linalg.norm(wanted - vectors @ turn.T, axis=1))
    yield (
        float(np.sqrt(np.mean(angles**2))),
        "if an axis of one side is mirrored"
        if is_mirrored
        else f"in a frame that is turned by {np.rad2deg(rotation_angle(turn)):.0f}° against the "
        "camera's, such as that of a body, whose positions are those of another point, too",
    )


def _motions(rotations: Floats) -> Floats:
    step = max(1, len(rotations) // 20)
    return np.swapaxes(rotations[:-step], 1, 2) @ rotations[step:]


def _error(motions: Floats, true: Floats) -> float:
    """Root mean square in degrees."""
    angles = rotation_angles_deg(np.swapaxes(true, 1, 2) @ motions)
    return float(np.sqrt(np.mean(angles**2)))


def _unexplained(estimate: Floats, reference: Floats) -> float:
    """Fraction of the variance of the reference's positions that no similarity explains."""
    target = reference[:, :3, 3]
    try:
        moved = umeyama(estimate[:, :3, 3], target, with_scale=True)
    except ValueError:
        return 0.0
    residuals = moved.transform_points(estimate[:, :3, 3]) - target
    return float((residuals**2).sum() / ((target - target.mean(axis=0)) ** 2).sum())
