"""Keyframes, landmarks and observations; bounded, because what is old is dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vo.geometry.rectification import RectifiedRig
from vo.mapping.lookup import rows_of
from vo.types import Bools, Bytes, Floats, Ints, Keypoints


@dataclass(eq=False)
class Keyframe:
    """A frame that the map keeps.

    Attributes:
        id: number among the keyframes, from 0, never used again.
        frame_index: number of its frame in the source.
        stamp_ns: its time.
        segment: number of its segment.
        slot: where its image lies in `Map.images`.
        world_from_cam: (4, 4), changed by smoothing.
        covariance: (6, 6) in the camera's frame, or None before it was smoothed.
        shared: (6, 6) with keyframes before it, by their ids: rows its own errors, columns theirs.
        keypoints: its features.
        undistorted_xy: (N, 2) undistorted pixels of its features.
        free: (N,) features that have no landmark.
        landmark: (n,) ids of the landmarks it sees.
        xy: (n, 2) ideal pixels where it sees them.
        image_xy: (n, 2) the same in its working image.
        disparity: (n,) pixels, NaN without a right match.
        sigma_px: (n,) standard deviation of xy.
    """

    id: int
    frame_index: int
    stamp_ns: int
    segment: int
    slot: int
    world_from_cam: Floats
    covariance: Floats | None
    shared: dict[int, Floats]
    keypoints: Keypoints
    undistorted_xy: Floats
    free: Bools
    landmark: Ints
    xy: Floats
    image_xy: Floats
    disparity: Floats
    sigma_px: Floats

    def see_through(self, rig: RectifiedRig) -> None:
        """Find the ideal pixels anew, for a lens that bends the image otherwise."""
        self.xy = rig.undistort(self.image_xy)
        self.undistorted_xy = rig.undistort(self.keypoints.xy)

    def add_observations(
        self, landmark: Ints, xy: Floats, image_xy: Floats, disparity: Floats, sigma_px: Floats
    ) -> None:
        """Note that this keyframe sees landmarks, each of them not noted yet."""
        self.landmark = np.concatenate([self.landmark, landmark])
        self.xy = np.concatenate([self.xy, xy])
        self.image_xy = np.concatenate([self.image_xy, image_xy])
        self.disparity = np.concatenate([self.disparity, disparity])
        self.sigma_px = np.concatenate([self.sigma_px, sigma_px])

    def keep_observations(self, mask: Bools) -> None:
        """Forget the observations outside of the mask."""
        kept = np.flatnonzero(mask)  # taking rows is several times as fast as masking them
        if len(kept) == len(mask):
            return
        self.landmark = self.landmark.take(kept)
        self.xy = self.xy.take(kept, axis=0)
        self.image_xy = self.image_xy.take(kept, axis=0)
        self.disparity = self.disparity.take(kept)
        self.sigma_px = self.sigma_px.take(kept)


_LANDMARK_FIELDS: dict[str, tuple[tuple[int, ...], type]] = {
    "id": ((), np.int64),
    "xyz": ((3,), np.float64),
    "normal": ((3,), np.float64),  # of the surface it lies on, in the world, of any length
    "descriptor": ((32,), np.uint8),
    "octave": ((), np.int32),
    "angle": ((), np.float32),
    "reference": ((), np.int64),  # keyframe whose image holds the patch
    "reference_xy": ((2,), np.float64),  # working-image pixel of the patch
    "last_seen": ((), np.int64),  # newest keyframe that sees it
    "visible": ((), np.int64),  # frames in which it should have been seen
    "found": ((), np.int64),  # frames in which it was seen
}


class Map:
    """The newest `capacity` keyframes and the landmarks that they see, as a struct of arrays.

    Landmark arrays (`id`, `xyz`, `descriptor`, …) are rows in order of id; rows move when
    landmarks are dropped, ids never do.
    """

    def __init__(self, capacity: int, height: int, width: int) -> None:
        self.keyframes: list[Keyframe] = []
        self.images: Bytes = np.zeros((capacity, height, width), dtype=np.uint8)
        self._capacity = capacity
        self._next_landmark = 0
        self._next_keyframe = 0
        self.id: Ints
        self.xyz: Floats
        self.normal: Floats
        self.descriptor: Bytes
        self.octave: NDArray[np.int32]
        self.angle: NDArray[np.float32]
        self.reference: Ints
        self.reference_xy: Floats
        self.last_seen: Ints
        self.visible: Ints
        self.found: Ints
        self.clear()

    def __len__(self) -> int:
        return len(self.id)

    def clear(self) -> None:
        """Forget all keyframes and landmarks; ids go on."""
        self.keyframes = []
        for name, (shape, dtype) in _LANDMARK_FIELDS.items():
            setattr(self, name, np.empty((0, *shape), dtype=dtype))

    def add_keyframe(
        self,
        *,
        frame_index: int,
        stamp_ns: int,
        segment: int,
        image: Bytes,
        world_from_cam: Floats,
        keypoints: Keypoints,
        undistorted_xy: Floats,
        free: Bools,
    ) -> Keyframe:
        """Store a keyframe, in place of the oldest if there is no room."""
        if len(self.keyframes) == self._capacity:
            self._drop_oldest()
        slot = min(set(range(self._capacity)) - {k.slot for k in self.keyframes})
        self.images[slot] = image
        keyframe = Keyframe(
            id=self._next_keyframe,
            frame_index=frame_index,
            stamp_ns=stamp_ns,
            segment=segment,
            slot=slot,
            world_from_cam=world_from_cam.copy(),
            covariance=None,
            shared={},
            keypoints=keypoints,
            undistorted_xy=undistorted_xy,
            free=free.copy(),
            landmark=np.empty(0, np.int64),
            xy=np.empty((0, 2)),
            image_xy=np.empty((0, 2)),
            disparity=np.empty(0),
            sigma_px=np.empty(0),
        )
        self._next_keyframe += 1
        self.keyframes.append(keyframe)
        return keyframe

    def add_landmarks(
        self,
        xyz: Floats,
        descriptor: Bytes,
        octave: NDArray[np.int32],
        angle: NDArray[np.float32],
        reference: Keyframe,
        reference_xy: Floats,
        last_seen: Keyframe,
    ) -> Ints:
        """Store landmarks, new ones all; returns their ids."""
        n = len(xyz)
        ids = np.arange(self._next_landmark, self._next_landmark + n)
        self._next_landmark += n
        new = {
            "id": ids,
            "xyz": xyz,
            "normal": np.tile(reference.world_from_cam[:3, 2], (n, 1)),  # facing that camera
            "descriptor": descriptor,
            "octave": octave,
            "angle": angle,
            "reference": np.full(n, reference.id),
            "reference_xy": reference_xy,
            "last_seen": np.full(n, last_seen.id),
            "visible": np.ones(n, np.int64),
            "found": np.ones(n, np.int64),
        }
        for name, values in new.items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))
        return ids

    def rows(self, ids: Ints) -> Ints:
        """Rows of landmarks by id, -1 for those no longer there."""
        return rows_of(ids, self.id)

    def sightings(self) -> tuple[Ints, Ints]:
        """Number of the keyframe in `keyframes`, and row of the landmark, of all N observations.

        They come keyframe by keyframe, as when an array of theirs is concatenated.
        """
        seen = [k.landmark for k in self.keyframes]
        number = np.repeat(np.arange(len(seen)), [len(ids) for ids in seen])
        return number, self.rows(np.concatenate(seen))

    def keep_landmarks(self, mask: Bools) -> None:
        """Drop the landmarks outside of the mask, and all observations of them."""
        rows = np.flatnonzero(mask)
        if len(rows) == len(mask):
            return
        first = self.id[0]
        kept = np.zeros(self.id[-1] - first + 1, dtype=bool)  # by id
        kept[self.id[rows] - first] = True
        for name in _LANDMARK_FIELDS:
            setattr(self, name, getattr(self, name).take(rows, axis=0))
        for keyframe in self.keyframes:
            keyframe.keep_observations(kept[keyframe.landmark - first])

    def reference_slots(self) -> Ints:
        """(n,) where in `images` each landmark's reference patch lies."""
        slots = np.array([k.slot for k in self.keyframes], dtype=np.int64)  # their ids go up by one
        return slots[self.reference - self.keyframes[0].id]

    def take_reference(self, keyframe: Keyframe, mask: Bools) -> None:
        """Let landmarks (n,) that a keyframe sees have their reference patch there."""
        rows = self.rows(keyframe.landmark)
        chosen = (rows >= 0) & mask[rows]
        self.reference[rows[chosen]] = keyframe.id
        self.reference_xy[rows[chosen]] = keyframe.image_xy[chosen]

    def _drop_oldest(self) -> None:
        dropped = self.keyframes[0]
        number, row = self.sightings()
        image_xy = np.concatenate([k.image_xy for k in self.keyframes])
        orphaned = (self.reference[row] == dropped.id) & (number > 0)
        # From the newest to the oldest: of those that see a landmark the oldest takes it last.
        seen = np.flatnonzero(orphaned)[::-1]
        self.reference[row[seen]] = dropped.id + number[seen]
        self.reference_xy[row[seen]] = image_xy[seen]
        del self.keyframes[0]
        self.keep_landmarks(self.reference != dropped.id)
