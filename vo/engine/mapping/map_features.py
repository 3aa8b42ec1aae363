"""Features of keyframes and landmarks of the map, to be exchanged for those of another kind."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Bools, Descriptors, Floats32, Ints, Keypoints
from vo.engine.frontend.contracts import PointDescriber
from vo.engine.geometry.neighbours import far_from
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.lookup import rows_of


class KeyframeFeatures(NamedTuple):
    """Features of a keyframe.

    Attributes:
        landmark: (n,) ids of landmarks that it observes.
    """

    keypoints: Keypoints
    landmark: Ints
    described: Keypoints


class MapFeatures(NamedTuple):
    """Features of one kind of a whole map.

    Attributes:
        free: (N,) of each keyframe, its features without a landmark.
        octave: (M,) of the landmarks.
        angle: (M,) of the landmarks.
        descriptor: (M, width) of the landmarks.
    """

    keypoints: list[Keypoints]
    free: list[Bools]
    octave: NDArray[np.int32]
    angle: Floats32
    descriptor: Descriptors


def features_of(
    local_map: LocalMap, keyframe: Keyframe, describer: PointDescriber
) -> KeyframeFeatures:
    """Extract the features of a keyframe and describe what it observes."""
    image, observed = local_map.images[keyframe.slot], keyframe.landmark
    keypoints, described = describer.extract_and_describe(image, keyframe.image_xy, keyframe.mask)
    inside = np.asarray(np.isfinite(local_map.rig.undistort(keypoints.xy)).all(axis=1))
    return KeyframeFeatures(keypoints.select(inside), observed, described)


def joined(local_map: LocalMap, features: list[KeyframeFeatures]) -> MapFeatures:
    """Features of the map from those of each of its keyframes, in order.

    A landmark is described as the newest keyframe sees it; the viewpoint of the next frame is the
    nearest to that.
    """
    count, layout = len(local_map), features[0].described.descriptor
    octave = np.zeros(count, np.int32)
    angle = np.full(count, np.nan, np.float32)
    descriptor: Descriptors = np.zeros((count, layout.shape[1]), layout.dtype)
    for each in features:
        rows = rows_of(each.landmark, local_map.id)
        known = rows >= 0
        octave[rows[known]] = each.described.octave[known]
        angle[rows[known]] = each.described.angle[known]
        descriptor[rows[known]] = each.described.descriptor[known]
    keypoints = [each.keypoints for each in features]
    free = [
        far_from(k.xy, keyframe.image_xy)
        for k, keyframe in zip(keypoints, local_map.keyframes, strict=True)
    ]
    return MapFeatures(keypoints, free, octave, angle, descriptor)


def exchange(local_map: LocalMap, new: MapFeatures) -> MapFeatures:
    """Replace the features of a map; those that it had, to be put back."""
    keyframes = local_map.keyframes
    old = MapFeatures(
        [k.keypoints for k in keyframes],
        [k.free for k in keyframes],
        local_map.octave,
        local_map.angle,
        local_map.descriptor,
    )
    for keyframe, keypoints, free in zip(keyframes, new.keypoints, new.free, strict=True):
        keyframe.keypoints, keyframe.free = keypoints, free
        keyframe.undistort(local_map.rig, local_map.inverse_depth(keyframe))
    local_map.octave, local_map.angle = new.octave, new.angle
    local_map.descriptor = new.descriptor
    return old
