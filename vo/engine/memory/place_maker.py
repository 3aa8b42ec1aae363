"""Places from keyframes that are removed from the local map."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bytes, Ints, Keypoints
from vo.engine.frontend.contracts import PointDescriber
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.keyframe_motion import motion_covariance
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.mapping.local_map import LocalMap
from vo.engine.places.patch_sampling import sampled_patches
from vo.engine.places.records import PathKeyframe, Place, PlaceKey, PlaceLandmarks
from vo.engine.places.thumbnails import thumbnail_of
from vo.engine.places.vocabulary import DESCRIPTOR_BYTES

_MAX_KNOWN = 0.7  # of the landmarks in the last place, so that a keyframe makes another one
_FIRST = 10  # keyframes of a segment, or after a doubted motion, that all make places


class PlaceMaker:
    """Makes places of consecutive keyframes.

    Args:
        describer: of keyframes with other features (`vo.engine.tracking.rescue`): places have one
            kind. None where there are no others.
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
        self._shown: Ints = np.empty(0, np.int64)  # landmarks in the last place
        self._segment = -1  # ... and its segment
        self._made = 0  # ... and the number of places since it began, or since a doubted motion

    def follow(self, keyframe: Keyframe) -> PathKeyframe:
        """A keyframe of the path, which follows that of the last call."""
        before, self._last = self._last, keyframe
        return self._of_path(before, keyframe)

    def shows_new(self, keyframe: Keyframe) -> bool:
        """Whether a keyframe shows enough that the one of the last place does not."""
        if keyframe.frame.segment != self._segment or self._made < _FIRST or keyframe.is_doubted:
            return True
        known = np.isin(keyframe.landmark, self._shown, assume_unique=True)
        return int(np.count_nonzero(known)) < _MAX_KNOWN * len(known)

    def make(
        self, of_path: PathKeyframe, keyframe: Keyframe, landmarks: StoredLandmarks, image: Bytes
    ) -> Place:
        """The place of a keyframe."""
        is_next = keyframe.frame.segment == self._segment and not keyframe.is_doubted
        self._made = self._made + 1 if is_next else 1
        self._shown, self._segment = keyframe.landmark, keyframe.frame.segment
        return self._place(of_path, keyframe, landmarks, image)

    def newest(self, local_map: LocalMap, count: int) -> list[Place]:
        """Places of the newest keyframes that are still in the local map, newest first."""
        keyframes = local_map.of_first_view
        return [
            self._place(
                self._of_path(keyframes[n - 1] if n > 0 else None, keyframes[n]),
                keyframes[n],
                local_map.landmarks_of(keyframes[n]),
                local_map.images[keyframes[n].slot],
            )
            for n in range(len(keyframes) - 1, -1, -1)[:count]
        ]

    def _of_path(self, before: Keyframe | None, keyframe: Keyframe) -> PathKeyframe:
        return PathKeyframe(
            PlaceKey(self.session, keyframe.id),
            keyframe.frame,
            self.is_metric,
            keyframe.world_from_cam.copy(),
            motion_covariance(before, keyframe),
            is_doubted=keyframe.is_doubted,
        )

    def _place(
        self, of_path: PathKeyframe, keyframe: Keyframe, landmarks: StoredLandmarks, image: Bytes
    ) -> Place:
        order = np.argsort(keyframe.landmark, kind="stable")
        order = order[np.isin(keyframe.landmark[order], landmarks.id, assume_unique=True)]
        keypoints, landmarks = self._of_one_kind(keyframe, landmarks, image, order)
        xyz = transform_points(inverse(keyframe.world_from_cam), landmarks.xyz)
        distance = np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
        return Place(
            **vars(of_path),
            descriptor=keypoints.descriptor,
            landmarks=PlaceLandmarks(
                id=landmarks.id,
                xyz=xyz.astype(np.float32),
                xy=keyframe.xy[order].astype(np.float32),
                sigma=(landmarks.sigma / distance).astype(np.float32),
                descriptor=landmarks.descriptor,
                octave=landmarks.octave,
                angle=landmarks.angle,
                patch=sampled_patches(
                    image, keyframe.image_xy[order], landmarks.octave, self._scale_factor
                ),
            ),
            thumbnail=thumbnail_of(image),
        )

    def _of_one_kind(
        self, keyframe: Keyframe, landmarks: StoredLandmarks, image: Bytes, order: Ints
    ) -> tuple[Keypoints, StoredLandmarks]:
        """Features and n landmarks of a keyframe, described anew if they are of another kind.

        `order` (n,) are the rows of its observations of the landmarks.
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
