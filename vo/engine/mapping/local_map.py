"""Storage of the local map: the newest keyframes and the landmarks that they observe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.types import Bools, Bytes, Descriptors, Floats, Ints, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.geometry.point_uncertainty import position_sigma
from vo.engine.geometry.rolling_shutter import Velocity, disparity_at_middle_row
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.mapping.keyframe_store import KeyframeStore, StoredLandmarks
from vo.engine.mapping.lookup import rows_of


class LocalMap:
    """The newest `capacity` keyframes and their landmarks, as a struct of arrays.

    Landmark arrays have rows in order of id; rows move when landmarks are removed, ids never do.

    Attributes:
        rig: with all corrections of the calibration so far.
        keyframes: in time order; their ids are consecutive.
        images: (capacity, H, W) rectified images of camera 0, by `Keyframe.slot`.
        id: (M,) ids of the landmarks.
        xyz: (M, 3) in the world.
        normal: (M, 3) of the surface, in the world, of any length.
        descriptor: (M, width), of the layout that the first landmarks had.
        octave: (M,) pyramid level of the patch.
        angle: (M,) orientation of the feature, radians.
        reference: (M,) id of the keyframe whose image holds the patch.
        reference_xy: (M, 2) pixel of the patch in that image.
        last_seen: (M,) id of the newest keyframe that observes it.
        visible: (M,) frames in which it should have been found.
        found: (M,) frames in which it was found.

    Args:
        capacity: maximum number of keyframes.
        descriptors: layout of the descriptors of the first kind.
        stores: receive keyframes, see `newest`.
        sigma_disparity_px: standard deviation of a disparity.
        newest: number of newest keyframes that stay with the map alone; older ones, which the
            window does not move, go to the stores. By default those that leave the map do.
    """

    def __init__(
        self,
        rig: RectifiedRig,
        capacity: int,
        descriptors: DescriptorFormat,
        stores: Sequence[KeyframeStore] = (),
        sigma_disparity_px: float = 0.4,
        newest: int | None = None,
        views: int = 1,
    ) -> None:
        self.rig, self._k1 = rig, rig.k1_error
        self.keyframes: list[Keyframe] = []
        self.images: Bytes = np.zeros((capacity, rig.height, rig.width), dtype=np.uint8)
        self._capacity = capacity
        self._views = views
        self._descriptors = descriptors
        self._stores = tuple(stores)
        self._newest = capacity if newest is None else newest
        self._stored = 0  # number of oldest keyframes that the stores have
        self._sigma_disparity_px = sigma_disparity_px
        self._next_landmark = 0
        self._next_keyframe = 0
        self._fields: dict[str, tuple[tuple[int, ...], Any]] = {
            "id": ((), np.int64),
            "xyz": ((3,), np.float64),
            "normal": ((3,), np.float64),
            "descriptor": ((descriptors.width,), descriptors.dtype),
            "octave": ((), np.int32),
            "angle": ((), np.float32),
            "reference": ((), np.int64),
            "reference_xy": ((2,), np.float64),
            "last_seen": ((), np.int64),
            "visible": ((), np.int64),
            "found": ((), np.int64),
        }
        self.id: Ints
        self.xyz: Floats
        self.normal: Floats
        self.descriptor: Descriptors
        self.octave: NDArray[np.int32]
        self.angle: NDArray[np.float32]
        self.reference: Ints
        self.reference_xy: Floats
        self.last_seen: Ints
        self.visible: Ints
        self.found: Ints
        self._remove_landmarks()

    def __len__(self) -> int:
        return len(self.id)

    @property
    def poses(self) -> Floats:
        """(K, 4, 4) world_from_cam of the keyframes."""
        return np.array([k.world_from_cam for k in self.keyframes])

    @property
    def of_first_view(self) -> list[Keyframe]:
        """One keyframe of each instant, which stores receive."""
        return self.keyframes[:: self._views]

    @property
    def has_second_kind(self) -> bool:
        """Whether its features are of the second kind, see `vo.engine.tracking.rescue`."""
        return (self.descriptor.shape[1], self.descriptor.dtype) != self._descriptors

    def clear(self) -> None:
        """Remove all keyframes and landmarks; ids go on."""
        self.hand_over(self._stores)
        self.discard()

    def discard(self) -> None:
        """Remove all keyframes and landmarks, which stores do not receive; ids go on."""
        self.keyframes, self._stored = [], 0
        self._remove_landmarks()

    def hand_over(self, stores: Sequence[KeyframeStore]) -> None:
        """Hand the newest keyframes to stores, as they are now; they stay in the map."""
        for keyframe in self.keyframes[self._stored :]:
            self._hand_over(keyframe, stores)

    def add_keyframe(
        self,
        frame: FrameId,
        image: Bytes,
        world_from_cam: Floats,
        keypoints: Keypoints,
        free: Bools,
    ) -> Keyframe:
        """Add a keyframe without observations; the oldest one leaves if there is no room.

        `image` (H, W) is the rectified one of camera 0; `free` (N,) are features without landmark.
        """
        if len(self.keyframes) - self._stored == self._newest:
            self._hand_over(self.keyframes[self._stored], self._stores)
            self._stored += 1
        if len(self.keyframes) == self._capacity:
            self._remove_oldest()
        slot = min(set(range(self._capacity)) - {k.slot for k in self.keyframes})
        self.images[slot] = image
        keyframe = Keyframe(
            id=self._next_keyframe,
            frame=frame,
            slot=slot,
            world_from_cam=world_from_cam.copy(),
            covariance=None,
            cross_covariance={},
            keypoints=keypoints,
            undistorted=cache(partial(self.rig.undistort, keypoints.xy)),
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
        self, xyz: Floats, reference: Keyframe, features: Ints, last_seen: Keyframe
    ) -> Ints:
        """Add landmarks (n, 3) for features (n,) of a keyframe, which holds their patches.

        Returns:
            Their ids.
        """
        keypoints, n = reference.keypoints, len(xyz)
        ids = np.arange(self._next_landmark, self._next_landmark + n)
        self._next_landmark += n
        new = {
            "id": ids,
            "xyz": xyz,
            "normal": reference.world_from_cam[None, :3, 2].repeat(n, axis=0),  # facing it
            "descriptor": keypoints.descriptor[features],
            "octave": keypoints.octave[features],
            "angle": keypoints.angle[features],
            "reference": np.full(n, reference.id),
            "reference_xy": keypoints.xy[features].astype(np.float64),
            "last_seen": np.full(n, last_seen.id),
            "visible": np.ones(n, np.int64),
            "found": np.ones(n, np.int64),
        }
        if len(self) == 0:
            self.descriptor = keypoints.descriptor[:0]
        for name, values in new.items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))
        return ids

    def rows(self, ids: Ints) -> Ints:
        """Rows of landmarks by id, -1 for those that have been removed."""
        return rows_of(ids, self.id)

    def observation_rows(self) -> tuple[Ints, Ints]:
        """Index of the keyframe, and row of the landmark, of all N observations.

        They are ordered by keyframe, like concatenated arrays of the keyframes.
        """
        observed = [k.landmark for k in self.keyframes]
        number = np.arange(len(observed)).repeat([len(ids) for ids in observed])
        return number, self.rows(np.concatenate(observed))

    def keep_landmarks(self, mask: Bools) -> None:
        """Remove the landmarks outside of the mask (M,), and all observations of them."""
        rows = np.flatnonzero(mask)
        if len(rows) == len(mask):
            return
        first = self.id[0]
        kept = np.zeros(self.id[-1] - first + 1, dtype=bool)  # by id
        kept[self.id[rows] - first] = True
        for name in self._fields:
            setattr(self, name, getattr(self, name).take(rows, axis=0))
        for keyframe in self.keyframes:
            keyframe.keep_observations(kept[keyframe.landmark - first])

    def reference_slots(self, rows: Ints | slice = slice(None)) -> Ints:
        """Indices in `images` of the reference patches of landmarks, by default of all (M,)."""
        slots = np.array([k.slot for k in self.keyframes], dtype=np.int64)
        return slots[self.reference[rows] - self.keyframes[0].id]

    def set_reference(self, keyframe: Keyframe, observed: Ints, rows: Ints) -> None:
        """Take the patches of landmarks (n,), by row, from observations (n,) of a keyframe."""
        self.reference[rows] = keyframe.id
        self.reference_xy[rows] = keyframe.image_xy[observed]

    def clear_corrected(self) -> None:
        """Remove all keyframes and landmarks, and all corrections of the calibration."""
        self.clear()
        rig = _without_disparity_error(self.rig)
        self.rig = rig if rig.k1_error == self._k1 else rig.with_k1_error(self._k1)

    def correct_disparities(self, offset_px: float, curve_px: float, *, is_yaw: bool) -> None:
        """Replace the correction of the disparity bias, for measured disparities too."""
        before = self.rig
        self.rig = replace(
            before,
            disparity_offset_px=offset_px,
            disparity_curve_px=curve_px,
            offset_is_yaw=is_yaw,
        )
        for keyframe in self.keyframes:
            right_u = keyframe.image_xy[:, 0] - keyframe.disparity
            change = self.rig.disparity_error(right_u) - before.disparity_error(right_u)
            keyframe.disparity -= change

    def correct_radial_distortion(self, k1: float) -> None:
        """Replace the correction of all lenses; a bias of disparities found without it is void."""
        before, self.rig = self.rig, self.rig.with_k1_error(k1)
        if (before.k1_error == 0.0) != (k1 == 0.0):
            self.rig = _without_disparity_error(self.rig)
        for keyframe in self.keyframes:
            if self.rig.is_metric:
                right_xy = before.right_pixels(keyframe.image_xy, keyframe.disparity)
                keyframe.disparity = self.rig.ideal_disparity(keyframe.image_xy, right_xy)
            keyframe.undistort(self.rig, self.inverse_depth(keyframe))

    def correct_vertical_disparity(self, before: VerticalDisparity, now: VerticalDisparity) -> None:
        """Change measured disparities to those of a right camera that is corrected differently."""
        rig = self.rig
        for keyframe in self.keyframes:
            x = (keyframe.image_xy[:, 0] - keyframe.disparity - rig.cx) / rig.fx
            y = (keyframe.image_xy[:, 1] - rig.cy) / rig.fy
            keyframe.disparity += now.horizontal_px(x, y) - before.horizontal_px(x, y)

    def inverse_depth(self, keyframe: Keyframe) -> Floats:
        """(n,) of the landmarks that a keyframe observes, NaN of those removed or behind it."""
        rows = self.rows(keyframe.landmark)
        cam_from_world = inverse(keyframe.world_from_cam)
        depth = self.xyz[rows] @ cam_from_world[2, :3] + cam_from_world[2, 3]
        known = (rows >= 0) & (depth > 0.0)
        return np.asarray(np.where(known, 1.0 / np.where(known, depth, 1.0), np.nan))

    def set_velocity(self, keyframe: Keyframe, velocity: Velocity) -> None:
        """Correct what a keyframe observes for the velocity of the camera during the readout."""
        xy, before = keyframe.image_xy, keyframe.velocity
        measured = keyframe.disparity
        if before is not None:  # taken back, to first order
            measured = 2.0 * measured - disparity_at_middle_row(self.rig, xy, measured, before)
        if self.rig.is_metric:
            keyframe.disparity = disparity_at_middle_row(self.rig, xy, measured, velocity)
        keyframe.velocity = velocity
        keyframe.undistort(self.rig, self.inverse_depth(keyframe))

    def _remove_landmarks(self) -> None:
        for name, (shape, dtype) in self._fields.items():
            setattr(self, name, np.empty((0, *shape), dtype=dtype))

    def _remove_oldest(self) -> None:
        oldest = self.keyframes[0]
        number, row = self.observation_rows()
        image_xy = np.concatenate([k.image_xy for k in self.keyframes])
        orphaned = (self.reference[row] == oldest.id) & (number > 0)
        # In reverse order, so that the oldest of the remaining observers is assigned last.
        observed = np.flatnonzero(orphaned)[::-1]
        self.reference[row[observed]] = oldest.id + number[observed]
        self.reference_xy[row[observed]] = image_xy[observed]
        del self.keyframes[0]
        self._stored -= 1
        self.keep_landmarks(self.reference != oldest.id)

    def landmarks_of(self, keyframe: Keyframe) -> StoredLandmarks:
        """Copies of the landmarks that a keyframe observes."""
        rows = self.rows(keyframe.landmark)
        rows = np.sort(rows[rows >= 0])
        names = StoredLandmarks._fields[:-1]
        fields = {name: getattr(self, name).take(rows, axis=0) for name in names}
        return StoredLandmarks(**fields, sigma=self.position_sigma(rows))

    def _hand_over(self, keyframe: Keyframe, stores: Sequence[KeyframeStore]) -> None:
        if keyframe.id % self._views:
            return
        landmarks = cache(partial(self.landmarks_of, keyframe))
        for store in stores:
            store.add(keyframe, landmarks, self.images[keyframe.slot])

    def position_sigma(self, chosen: Ints) -> Floats:
        """Standard deviation (n,) of the positions of landmarks (n,), given exact poses."""
        place = np.full(len(self), -1)
        place[chosen] = np.arange(len(chosen))
        number, row = self.observation_rows()
        return position_sigma(
            self.xyz[chosen],
            np.stack([k.world_from_cam[:3, 3] for k in self.keyframes]),
            place[row],
            number,
            np.concatenate([k.disparity for k in self.keyframes]),
            np.concatenate([k.sigma_px for k in self.keyframes]),
            self.rig.fx,
            self.rig.fx * self.rig.baseline_m / self._sigma_disparity_px,
        )


def _without_disparity_error(rig: RectifiedRig) -> RectifiedRig:
    return replace(rig, disparity_offset_px=0.0, disparity_curve_px=0.0, offset_is_yaw=False)
