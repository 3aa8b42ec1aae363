"""Places from keyframes that are removed from the local map."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.geometry.transforms import inverse, transform_points
from vo.mapping.keyframe import Keyframe
from vo.mapping.keyframe_motion import motion_covariance
from vo.mapping.keyframe_store import StoredLandmarks
from vo.mapping.local_map import LocalMap
from vo.mapping.map_features import PointDescriber
from vo.places.records import PATCH_PX, Place, PlaceKey, PlaceLandmarks
from vo.places.vocabulary import DESCRIPTOR_BYTES
from vo.types import Bytes, Floats, Ints, Keypoints

_THUMBNAIL_HEIGHT = 120  # of images by which places are compared


class PlaceMaker:
    """Makes places of consecutive keyframes.

    Attributes:
        session: number of the session.
        is_metric: whether lengths are metres.

    Args:
        session: number of the session.
        scale_factor: size ratio of two pyramid levels.
        is_metric: whether lengths are metres.
        describer: of keyframes with other features (`vo.tracking.rescue`): places have one kind.
            None where there are no others.
    """

    def __init__(
        self,
        session: int,
        scale_factor: float,
        *,
        is_metric: bool,
        describer: PointDescriber | None = None,
    ) -> None:
        self.session = session
        self._describer = describer
        self._scale_factor = scale_factor
        self.is_metric = is_metric
        self._last: Keyframe | None = None  # the one before

    def make(self, keyframe: Keyframe, landmarks: StoredLandmarks, image: Bytes) -> Place:
        """The place of a keyframe that follows the one of the last call."""
        before, self._last = self._last, keyframe
        return self._place(before, keyframe, landmarks, image)

    def newest(self, local_map: LocalMap, count: int) -> list[Place]:
        """Places of the newest keyframes that are still in the local map, newest first."""
        keyframes = local_map.keyframes
        return [
            self._place(
                keyframes[n - 1] if n > 0 else None,
                keyframes[n],
                local_map.landmarks_of(keyframes[n]),
                local_map.images[keyframes[n].slot],
            )
            for n in range(len(keyframes) - 1, -1, -1)[:count]
        ]

    def _place(
        self, before: Keyframe | None, keyframe: Keyframe, landmarks: StoredLandmarks, image: Bytes
    ) -> Place:
        order = np.argsort(keyframe.landmark, kind="stable")
        order = order[np.isin(keyframe.landmark[order], landmarks.id, assume_unique=True)]
        keypoints, landmarks = self._of_one_kind(keyframe, landmarks, image, order)
        xyz = transform_points(inverse(keyframe.world_from_cam), landmarks.xyz)
        distance = np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
        height, width = image.shape
        thumbnail_height = min(_THUMBNAIL_HEIGHT, height)
        thumbnail_width = max(1, round(width * thumbnail_height / height))
        return Place(
            key=PlaceKey(self.session, keyframe.id),
            frame=keyframe.frame,
            is_metric=self.is_metric,
            odom_from_cam=keyframe.world_from_cam.copy(),
            covariance=motion_covariance(before, keyframe),
            descriptor=keypoints.descriptor,
            landmarks=PlaceLandmarks(
                id=landmarks.id,
                xyz=xyz.astype(np.float32),
                xy=keyframe.xy[order].astype(np.float32),
                sigma=(landmarks.sigma / distance).astype(np.float32),
                descriptor=landmarks.descriptor,
                octave=landmarks.octave,
                angle=landmarks.angle,
                patch=patches(
                    image, keyframe.image_xy[order], landmarks.octave, self._scale_factor
                ),
            ),
            thumbnail=cv2.resize(
                image, (thumbnail_width, thumbnail_height), interpolation=cv2.INTER_AREA
            ),
            is_doubted=keyframe.is_doubted,
        )

    def _of_one_kind(
        self, keyframe: Keyframe, landmarks: StoredLandmarks, image: Bytes, order: Ints
    ) -> tuple[Keypoints, StoredLandmarks]:
        """Features of a keyframe and its landmarks, described anew if they are of another kind.

        Args:
            keyframe: the keyframe.
            landmarks: n that it observes.
            image: its image.
            order: (n,) rows of its observations of them.
        """
        descriptor = keyframe.keypoints.descriptor
        is_own = descriptor.shape[1] == DESCRIPTOR_BYTES and descriptor.dtype == np.uint8
        if is_own or self._describer is None:
            return keyframe.keypoints, landmarks
        at = keyframe.image_xy[order]
        keypoints, given = self._describer.extract_and_describe(image, at, keyframe.mask)
        described = landmarks._replace(
            descriptor=given.descriptor, octave=given.octave, angle=given.angle
        )
        return keypoints, described


def patches(image: Bytes, xy: Floats, octave: NDArray[np.int32], scale_factor: float) -> Bytes:
    """(n, PATCH_PX, PATCH_PX) around pixels (n, 2) of an image, at their pyramid levels (n,)."""
    result = np.zeros((len(xy), PATCH_PX, PATCH_PX), np.uint8)
    offset = np.arange(PATCH_PX, dtype=np.float32) - PATCH_PX // 2
    height, width = image.shape
    reduced, size = image, (width, height)
    for level in range(int(octave.max(initial=-1)) + 1):
        if level > 0:  # of the level before, as for the features: much faster than of the image
            size = tuple(math.ceil(side / scale_factor**level) for side in (width, height))
            reduced = cv2.resize(reduced, size, interpolation=cv2.INTER_LINEAR)
        rows = np.flatnonzero(octave == level)
        if not len(rows):
            continue
        ratio = np.array([size[0] / width, size[1] / height])
        centre = ((xy[rows] + 0.5) * ratio - 0.5).astype(np.float32)
        u, v = (
            np.ascontiguousarray(np.broadcast_to(at, (len(rows), PATCH_PX, PATCH_PX)))
            for at in (
                centre[:, 0, None, None] + offset[None, None, :],
                centre[:, 1, None, None] + offset[None, :, None],
            )
        )
        flat = (len(rows), PATCH_PX * PATCH_PX)
        sampled = cv2.remap(
            reduced,
            u.reshape(flat),
            v.reshape(flat),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        result[rows] = sampled.reshape(-1, PATCH_PX, PATCH_PX)
    return result
