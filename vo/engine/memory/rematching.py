"""Search for the landmarks of a path in all of its keyframes, with the poses and points so far.

The window sees a landmark for as long as it is tracked. At the end of a run all keyframes are
known, and each landmark is searched wherever it should be in view: for longer, and in revisits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bytes, Floats, Ints
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.frontend.patch_alignment import PatchAligner, Patches
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.frontend.stereo_matching import StereoMatcher
from vo.engine.geometry.image_masks import used_at
from vo.engine.geometry.patch_prediction import PatchPrediction, predict_patches
from vo.engine.geometry.surfaces import surface_normals

_BORDER_PX = 8.0  # of an image, where no patch is searched
_MAX_MEDIANS = 3.0  # errors of new disparities of a landmark, relative to those of most
_MAX_SCALE = 3.0  # size ratio of a patch and its reference
# Standard deviations of aligned positions as in `tracking.landmark_alignment`.
_MEDIAN_SIGMA_PX, _CONSTANT_VARIANCE, _MAX_SIGMA = 0.06, 0.4, 4.0


@dataclass(frozen=True, eq=False)
class PathViews:
    """Observations of M landmarks by K keyframes, ordered by keyframe.

    Attributes:
        images: (K, H, W) of the rectified camera 0.
        masks: of each image, None where all of it is used.
        world_from_cam: (K, 4, 4).
        points: (M, 3) in the world.
        normals: (M, 3) of their surfaces, of any length.
        keyframe: (N,) row of the keyframe of each observation.
        point: (N,) row of the landmark.
        image_xy: (N, 2) pixels of the rectified image.
        disparity: (N,) pixels, NaN without a measurement.
        sigma_px: (N,) standard deviation of image_xy.
    """

    images: Bytes
    masks: list[Bytes | None]
    world_from_cam: Floats
    points: Floats
    normals: Floats
    keyframe: Ints
    point: Ints
    image_xy: Floats
    disparity: Floats
    sigma_px: Floats

    def select(self, chosen: Ints) -> PathViews:
        """Some of the observations, in this order."""
        return replace(
            self,
            keyframe=self.keyframe[chosen],
            point=self.point[chosen],
            image_xy=self.image_xy[chosen],
            disparity=self.disparity[chosen],
            sigma_px=self.sigma_px[chosen],
        )

    def predicted(self, k: int, rows: Ints, reference: Ints, rig: RectifiedRig) -> PatchPrediction:
        """How keyframe k should see landmarks (n,) whose patches are in keyframes (M,)."""
        camera, poses = np.full(len(rows), k), self.world_from_cam
        return predict_patches(
            self.points, self.normals, reference, rows, camera, poses, rig.intrinsics
        )

    def problem(self, rig: RectifiedRig, sigma_disparity_px: float) -> WindowProblem:
        """All keyframes as one window whose first pose is fixed."""
        return WindowProblem(
            rig.intrinsics,
            rig.baseline_m if rig.is_metric else 0.0,
            sigma_disparity_px,
            self.world_from_cam,
            np.arange(len(self.world_from_cam)) == 0,
            self.points,
            self.keyframe,
            self.point,
            rig.undistort(self.image_xy),
            self.disparity,
            self.sigma_px,
            estimates_calibration=False,
        )


# Rows of the landmarks that are observed, and of all (M,) and (M, 2): keyframe and pixel of the
# patch, that of the middle one of the keyframes that observe it.
References = tuple[Ints, tuple[Ints, Floats]]


def references(views: PathViews) -> References:
    """Where the patch of each landmark is."""
    observed, row = np.unique(views.point[order := _by_point(views)], return_index=True)
    count = np.diff(np.append(row, len(order)))
    middle = order[row + (count - 1) // 2]
    reference, reference_xy = (
        np.zeros(len(views.points), np.int64),
        np.zeros((len(views.points), 2)),
    )
    reference[observed], reference_xy[observed] = views.keyframe[middle], views.image_xy[middle]
    return observed, (reference, reference_xy)


def found_in(
    views: PathViews,
    rows: Ints,
    place: tuple[Floats, Bytes, Bytes | None],
    of_landmarks: References,
    rig: RectifiedRig,
    patches: PatchAligner,
) -> tuple[Ints, Floats, Floats]:
    """Landmark, pixel and standard deviation of those of `rows` that another image shows.

    `place`: its pose (4, 4), the image, and its mask.
    """
    pose, image, mask = place
    poses = np.concatenate([views.world_from_cam, pose[None]])
    views = replace(views, world_from_cam=poses, masks=[*views.masks, mask])
    last = len(poses) - 1
    _, rows, xy, sigma = _found(views, last, rows, of_landmarks[1], rig, patches, image[None])
    return rows, xy, patches.sigma_px * _relative_sigma(sigma)


def rematched(
    views: PathViews, measured: PathViews, rig: RectifiedRig, patches: PatchAligner
) -> PathViews:
    """Observations of all landmarks in all keyframes that should show them.

    The patch of each is that of the middle one of the keyframes that observe it, from which the
    others differ least. Disparities are those that `measured` has.
    """
    observed, (reference, reference_xy) = references(views)
    views = replace(views, normals=_normals(views, reference, rig))
    usable = observed[np.isfinite(views.points[observed]).all(axis=1)]
    parts = []
    for k in range(len(views.images)):
        own = usable[reference[usable] == k]
        parts.append((np.full(len(own), k), own, reference_xy[own], np.zeros(len(own))))
        others = usable[reference[usable] != k]
        parts.append(_found(views, k, others, (reference, reference_xy), rig, patches))
    keyframe, point, image_xy, sigma = (np.concatenate(each) for each in zip(*parts, strict=True))
    found = replace(
        views,
        keyframe=keyframe,
        point=point,
        image_xy=image_xy,
        disparity=_disparities(measured, keyframe, point),
        sigma_px=patches.sigma_px * _relative_sigma(sigma),
    )
    return found.select(np.lexsort((point, keyframe)))


def with_depths(
    views: PathViews,
    pairs: Sequence[PreprocessedFrame | None],
    rig: RectifiedRig,
    stereo: StereoMatcher,
) -> PathViews:
    """Disparities, in the pairs of the K keyframes, of landmarks of which none was measured.

    Further ones of the others err by what theirs do: the patch is the same. Landmarks whose
    disparities fit the path badly, such as edges of objects, keep none.
    """
    disparity, error = views.disparity.copy(), np.full(len(views.point), np.nan)
    measured = np.bincount(views.point, np.isfinite(disparity), len(views.points)) > 0
    newest = next((pair.corrected for pair in reversed(pairs) if pair is not None), None)
    for k, pair in enumerate(pairs):
        rows = np.flatnonzero((views.keyframe == k) & ~measured[views.point])
        pose, point = views.world_from_cam[k], views.points[views.point[rows]]
        depth = transform_points(inverse(pose), point)[:, 2]
        rows, depth = rows[ahead := depth > 1e-6], depth[ahead]
        if pair is None or newest is None or len(rows) == 0:
            continue
        xy, here = views.image_xy[rows], np.full(len(views.points), k)
        slope = views.predicted(k, views.point[rows], here, rig).slope
        expected = rig.fx * rig.baseline_m / depth
        found = stereo.measure(pair, xy, expected, rig, slope)
        x, y = (xy[:, 0] - found - rig.cx) / rig.fx, (xy[:, 1] - rig.cy) / rig.fy
        change = newest.horizontal_px(x, y) - pair.corrected.horizontal_px(x, y)
        disparity[rows] = found + change
        error[rows] = disparity[rows] - expected
    new = np.flatnonzero(np.isfinite(error))
    if len(new):
        _, of = np.unique(views.point[new], return_inverse=True)
        squared = np.bincount(of, error[new] ** 2) / np.bincount(of)
        disparity[new[squared[of] > _MAX_MEDIANS**2 * np.median(squared)]] = np.nan
    return replace(views, disparity=disparity)


def _relative_sigma(sigma_px: Floats) -> Floats:
    """Standard deviations of aligned positions, relative to those of most."""
    relative = np.minimum(sigma_px / _MEDIAN_SIGMA_PX, _MAX_SIGMA)
    return np.asarray(np.sqrt(_CONSTANT_VARIANCE + (1.0 - _CONSTANT_VARIANCE) * relative**2))


def _by_point(views: PathViews) -> Ints:
    """Observations ordered by landmark, then by keyframe."""
    return np.lexsort((views.keyframe, views.point))


def _found(
    views: PathViews,
    k: int,
    rows: Ints,
    references: tuple[Ints, Floats],
    rig: RectifiedRig,
    patches: PatchAligner,
    target: Bytes | None = None,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Keyframe, landmark, pixel and standard deviation of those of `rows` that keyframe k shows.

    `target`: (1, H, W) its image, if it is not in `views`.
    """
    at = transform_points(inverse(views.world_from_cam[k]), views.points[rows])
    rows, at = rows[ahead := at[:, 2] > 1e-6], at[ahead]
    u = rig.fx * at[:, 0] / at[:, 2] + rig.cx
    v = rig.fy * at[:, 1] / at[:, 2] + rig.cy
    rows = rows[(np.abs(u - rig.cx) < rig.width) & (np.abs(v - rig.cy) < rig.height)]
    reference, reference_xy = references
    seen = views.predicted(k, rows, reference, rig)
    expected = rig.distort(seen.xy)
    farthest = (rig.width - _BORDER_PX, rig.height - _BORDER_PX)
    with np.errstate(invalid="ignore"):
        kept = ((expected >= _BORDER_PX) & (expected < farthest)).all(axis=1)
    kept &= (seen.scale < _MAX_SCALE) & (seen.scale > 1.0 / _MAX_SCALE)
    mask = views.masks[k]
    if mask is not None:
        kept[kept] = used_at(mask, expected[kept])
    rows, expected, warp = rows[kept], expected[kept], seen.reference_from_target[kept]
    found = patches.align_in(
        Patches(views.images, reference[rows], reference_xy[rows], warp),
        views.images if target is None else target,
        np.full(len(rows), k if target is None else 0),
        expected,
    )
    good = patches.is_found(found)
    good &= np.linalg.norm(found.xy - expected, axis=1) <= patches.max_shift_px
    good[good] = np.isfinite(rig.undistort(found.xy[good])).all(axis=1)
    return np.full(np.count_nonzero(good), k), rows[good], found.xy[good], found.sigma_px[good]


def _normals(views: PathViews, reference: Ints, rig: RectifiedRig) -> Floats:
    """(M, 3) from the landmarks around each in the keyframe of its patch."""
    normals = views.normals.copy()
    xy = rig.undistort(views.image_xy)
    for k, pose in enumerate(views.world_from_cam):
        here = np.flatnonzero(views.keyframe == k)
        depth = transform_points(inverse(pose), views.points[views.point[here]])[:, 2]
        here, depth = here[ahead := depth > 1e-6], depth[ahead]
        own = np.flatnonzero(reference[views.point[here]] == k)
        if len(own):
            found = surface_normals(xy[here], depth, own, pose, rig.intrinsics)
            normals[views.point[here[own]]] = found
    return normals


def _disparities(measured: PathViews, keyframe: Ints, point: Ints) -> Floats:
    """(n,) of observations that were measured, NaN of the others."""
    known = measured.keyframe * len(measured.points) + measured.point
    order = np.argsort(known)
    wanted = keyframe * len(measured.points) + point
    place = order[np.minimum(np.searchsorted(known[order], wanted), len(order) - 1)]
    return np.where(known[place] == wanted, measured.disparity[place], np.nan)
