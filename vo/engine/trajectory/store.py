"""The trajectory: every frame has a pose relative to a keyframe and moves with it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import inverse, whole_transforms
from vo.base.records.metric_scale import MetricScale
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Floats, Ints, KeyframePose, Trajectory
from vo.engine.trajectory.between import share_motion
from vo.engine.trajectory.inertial_frames import InertialFrame, inserted, with_inertial
from vo.engine.trajectory.interpolation import InterpolatedFrames, fill
from vo.engine.trajectory.map_frame import Anchor, make_anchors
from vo.engine.trajectory.metric_segments import MetricSegments
from vo.engine.trajectory.rows import (
    FRAME,
    KEYFRAME,
    TRIANGLE,
    apply_scale,
    keyframe_poses,
    keyframe_rows,
    symmetric,
)
from vo.engine.trajectory.table import Table


class TrajectoryStore:
    """Frames with a pose in time order, and the newest pose of every keyframe.

    Any keyframe, old ones too, can get a new pose at any time; the frames relative to it follow.
    Poses are stored in the odometry frame of their segment; once the pose graph has placed
    keyframes (`move_keyframes`), those come out in the map frame, and the others follow the last
    placed one before them.

    Attributes:
        interpolated: frames to be interpolated, None for no interpolation.
        metric: which segments are in metres, and by what.
    """

    def __init__(self, *, is_metric: bool = False) -> None:
        self.metric = MetricSegments(by_cameras=is_metric, world_of=self.world)
        self.interpolated: InterpolatedFrames | None = None
        self._frames = Table(FRAME)
        self._inertial: list[InertialFrame] = []
        self._keyframes = Table(KEYFRAME)
        self._changed = self._changed_keyframe = 0
        self._moved: set[int] = set()  # ids of keyframes
        self._anchors: dict[int, Anchor] = {}  # newest keyframe that was placed, by segment
        self._worlds: dict[int, int] = {}  # of segments that were connected to another one

    @property
    def frames(self) -> NDArray[Any]:
        """(n,) rows with `frame_index`, `stamp_ns`, `segment` and `keyframe` (an id)."""
        return self._frames.rows

    @property
    def keyframe_count(self) -> int:
        """Number of keyframes."""
        return len(self._keyframes)

    def add(
        self, frame_index: int, stamp_ns: int, segment: int, keyframe: int, odom_from_cam0: Floats
    ) -> None:
        """Append a frame with a pose (4, 4), and the frames to be interpolated before it."""
        self._add_interpolated(frame_index, segment)
        row = self._keyframe_row(keyframe)
        reference = whole_transforms(self._keyframes.rows["odom_from_cam0"][row : row + 1])[0]
        relative = inverse(reference) @ odom_from_cam0
        self._frames.append(frame_index, stamp_ns, segment, keyframe, 0.0, relative[:3])

    def add_inertial(self, added: Sequence[InertialFrame]) -> None:
        """Insert frames with poses by the inertial sensor, by increasing number, at the end."""
        if not added:
            return
        added = sorted(added, key=lambda frame: frame.frame_index)
        self._inertial = added
        rows = self._keyframes.rows[[self._keyframe_row(frame.keyframe) for frame in added]]
        poses = np.stack([frame.world_from_cam0 for frame in added])
        relative = inverse(whole_transforms(rows["world_from_cam0"])) @ poses
        relative[:, :3, 3] /= rows["scale"][:, None]
        self._frames.replace(inserted(self.frames, added, relative))
        self._changed = self._changed_keyframe = 0

    def store(self, keyframe: int, pose: KeyframePose) -> None:
        """Add a keyframe by its id, or replace its pose and covariance in the odometry frame."""
        self.store_all([keyframe], [pose])

    def store_all(self, keyframes: Sequence[int], poses: Sequence[KeyframePose]) -> None:
        """Do so with some keyframes, by increasing ids; at least one."""
        self._moved.update(keyframes)
        self._changed_keyframe = min(self._changed_keyframe, self._keyframe_row(keyframes[0]))
        rows = keyframe_rows(keyframes, poses, self._anchors)
        table = self._keyframes.rows
        at = self._keyframe_rows(keyframes)
        known = int(np.count_nonzero(at < len(table)))
        rows["previous_from_cam"][:known] = table["previous_from_cam"][at[:known]]
        table[at[:known]] = rows[:known]
        for fields in rows[known:]:
            self._keyframes.append(*fields)
        self._change_from(self._keyframe_row(keyframes[0]))

    def connect(self, keyframe: int) -> None:
        """Note where a new keyframe was tracked; frames since the last one share later motion."""
        row = self._keyframe_row(keyframe)
        pose = whole_transforms(self._keyframes.rows["odom_from_cam0"][row - 1 : row + 1])
        self._keyframes.rows["previous_from_cam"][row] = (inverse(pose[0]) @ pose[1])[:3]

    def measure(self, frames: Sequence[int], keyframe_from_cam: Floats) -> None:
        """Replace what consecutive frames measured: poses (n, 4, 4) in the keyframe before them.

        The last one may be the next keyframe, if it was connected.
        """
        rows = np.searchsorted(self.frames["frame_index"], frames)
        table = self._keyframes.rows
        following = bisect_left(table["frame_index"], frames[-1])
        if following < len(table) and table["frame_index"][following] == frames[-1]:
            table["previous_from_cam"][following] = keyframe_from_cam[-1, :3]
            rows = rows[:-1]
        self.frames["keyframe_from_cam"][rows] = keyframe_from_cam[: len(rows), :3]
        self._changed = min(self._changed, self._first_after_tracked(int(rows[0])))

    def anchor(self, segment: int) -> Anchor | None:
        """The newest keyframe of a segment that was placed, which its newer poses follow."""
        return self._anchors.get(segment)

    @property
    def worlds(self) -> dict[int, int]:
        """The worlds of the segments that were placed in the map frame."""
        return dict(self._worlds)

    def world(self, segment: int) -> int:
        """Number of the connected world that a segment belongs to: that of its first segment."""
        return self._worlds.get(segment, segment)

    def move_keyframes(
        self,
        keyframes: Ints,
        worlds: Ints,
        map_from_cam0: Floats,
        scale: Floats,
        covariance: Floats,
        *,
        keeps_earlier: bool = False,
    ) -> None:
        """Place keyframes in the map frame; all others of their segments follow.

        Args:
            keyframes: (n,) increasing ids.
            worlds: (n,) number of the world of each.
            map_from_cam0: (n, 4, 4).
            scale: (n,) length in the map of one unit of the odometry frame.
            covariance: (n, 6, 6), NaN if unknown.
            keeps_earlier: whether keyframes before them stay where they were placed before.
        """
        if len(keyframes) == 0:
            return
        rows = self._keyframes.rows
        registered = np.searchsorted(rows["id"], keyframes)
        segments = rows["segment"][registered]
        odom_covariance = symmetric(rows["odom_covariance"][registered])
        odom_from_cam0 = whole_transforms(rows["odom_from_cam0"][registered])
        first = len(rows)
        for segment in sorted(set(segments.tolist())):
            chosen = np.flatnonzero(segments == segment)
            self._worlds[segment] = int(worlds[chosen[0]])
            of_segment = np.flatnonzero(rows["segment"] == segment)
            if keeps_earlier and segment in self._anchors:
                of_segment = of_segment[np.searchsorted(of_segment, registered[chosen[0]]) :]
            # Each follows the last placed one before it, and the first ones the first placed one.
            ends = np.append(np.searchsorted(of_segment, registered[chosen[1:]]), len(of_segment))
            anchors = make_anchors(
                odom_from_cam0[chosen],
                map_from_cam0[chosen],
                scale[chosen],
                odom_covariance[chosen],
                covariance[chosen],
            )
            followed = np.repeat(np.arange(len(chosen)), np.diff(ends, prepend=0))
            self._follow(of_segment, anchors.rows(followed))
            self._anchors[segment] = anchors.row(-1)
            self._moved |= set(rows["id"][of_segment].tolist())
            first = min(first, int(of_segment[0]))
        self._changed_keyframe = min(self._changed_keyframe, first)
        self._change_from(first)

    def registered(self, world: int) -> tuple[Ints, Floats, Floats, Floats]:
        """Ids, poses, scales and covariances of a world's keyframes, as for `move_keyframes`."""
        table = self._keyframes.rows
        segments = [n for n in set(table["segment"].tolist()) if self.world(n) == world]
        rows = table[np.isin(table["segment"], segments)]
        poses = whole_transforms(rows["world_from_cam0"])
        return rows["id"].copy(), poses, rows["scale"].copy(), symmetric(rows["covariance"])

    def apply_scales(self, scales: Mapping[int, MetricScale]) -> None:
        """Convert the poses of worlds to metres by scales of some, once, after the last frame.

        Covariances get the part that the uncertainty of the scale adds: the error of a position is
        along the line to the origin of the world and in proportion to its distance.
        """
        self.metric.scales = scales
        table = self._keyframes.rows
        for number in sorted(set(table["segment"].tolist())):
            scale = self.metric.scale(number)
            if scale is not None:
                apply_scale(table, np.flatnonzero(table["segment"] == number), scale)
        self._changed = self._changed_keyframe = 0

    def scales_of_segments(self) -> dict[int, MetricScale]:
        """The scales that were applied, by number of the segment."""
        segments = sorted(set(self.frames["segment"].tolist()))
        found = ((segment, self.metric.scale(segment)) for segment in segments)
        return {segment: scale for segment, scale in found if scale is not None}

    def map_scales(self) -> dict[int, float]:
        """Length in the world of one unit of odometry, by frame number of the keyframe.

        Without the scales that were applied.
        """
        metric = self.scales_of_segments()
        found = {}
        for row in self._keyframes.rows:
            scale = metric.get(int(row["segment"]))
            value = 1.0 if scale is None else scale.value
            found[int(row["frame_index"])] = float(row["scale"]) / value
        return found

    def turn_worlds(self, new_from_old: Mapping[int, Floats]) -> None:
        """Give worlds other frames after the last frame: (4, 4) by number of the world."""
        table = self._keyframes.rows
        for row, segment in enumerate(table["segment"].tolist()):
            turn = new_from_old.get(self.world(segment))
            if turn is not None:
                table["world_from_cam0"][row] = turn[:3, :3] @ table["world_from_cam0"][row]
                table["world_from_cam0"][row, :, 3] += turn[:3, 3]
        self._changed = self._changed_keyframe = 0

    def _follow(self, rows: Ints, anchors: Anchor) -> None:
        """Set the poses of n rows of keyframes that follow n placed ones."""
        table = self._keyframes.rows
        odom_from_cam0 = whole_transforms(table["odom_from_cam0"][rows])
        table["world_from_cam0"][rows] = anchors.transform(odom_from_cam0)[:, :3]
        table["scale"][rows] = anchors.scale
        covariance = symmetric(table["odom_covariance"][rows])
        known = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
        i, j = TRIANGLE
        moved = anchors.rows(known).covariance(odom_from_cam0[known], covariance[known])
        table["covariance"][rows[known]] = moved[:, i, j]

    def remove_from(self, frame_index: int) -> Floats | None:
        """Remove a frame and all after it; the pose of the first in the odometry frame."""
        row = self._first_after_tracked(bisect_left(self.frames["frame_index"], frame_index))
        pose = None if row == len(self._frames) else self._poses(row, "odom_from_cam0")[0]
        keyframe_row = bisect_left(self._keyframes.rows["frame_index"], frame_index)
        self._moved -= set(self._keyframes.rows["id"][keyframe_row:].tolist())
        self._frames.truncate(row)
        self._keyframes.truncate(keyframe_row)
        self._changed = min(self._changed, row)
        self._changed_keyframe = min(self._changed_keyframe, keyframe_row)
        return pose

    def has_frame(self, segment: int, before: int) -> bool:
        """Whether the newest frame before another one is of this segment."""
        row = bisect_left(self.frames["frame_index"], before)
        return row > 0 and int(self.frames["segment"][row - 1]) == segment

    def take_changes(self) -> tuple[int, int]:
        """First rows of frames and of keyframes that are new or moved since the last call."""
        changed = self._changed, self._changed_keyframe
        self._changed, self._changed_keyframe = len(self._frames), len(self._keyframes)
        return changed

    def take_moved(self) -> tuple[KeyframePose, ...]:
        """Keyframes that were added or moved since the last call, in order of ids."""
        moved, self._moved = sorted(self._moved), set()
        return tuple(self.keyframes_by_id(moved)) if moved else ()

    def keyframes_by_id(self, keyframes: Sequence[int]) -> list[KeyframePose]:
        """Keyframes by increasing ids."""
        return keyframe_poses(self._keyframes.rows[self._keyframe_rows(keyframes)])

    def newest_certain(self, segment: int) -> KeyframePose | None:
        """The newest keyframe of a segment that has a covariance, None without one."""
        for row in range(len(self._keyframes) - 1, -1, -1):
            (pose,) = keyframe_poses(self._keyframes.rows[row : row + 1])
            if pose.segment != segment:
                return None
            if pose.covariance is not None:
                return pose
        return None

    def keyframes(self, row: int = 0) -> list[KeyframePose]:
        """Keyframes from a row on."""
        return keyframe_poses(self._keyframes.rows[row:]) if row < len(self._keyframes) else []

    def covariances(self, row: int = 0) -> list[KeyframePose]:
        """Keyframes from a row on, among the frames with a pose by the inertial sensor."""
        keyframes = self.keyframes(row)
        return with_inertial(keyframes, self._inertial) if self._inertial else keyframes

    def path(self, row: int = 0) -> PosedFrames:
        """All frames with their current poses, from a row on."""
        frames = self.frames[row:]
        rows = self._keyframe_rows(frames["keyframe"])
        frame_index, fraction = frames["frame_index"].copy(), frames["fraction"]
        is_keyframe = self._keyframes.rows["frame_index"][rows] == frame_index
        inertial = None
        if self._inertial:
            inertial = np.minimum(fraction, 0.0).astype(np.int64)
            is_keyframe &= inertial == 0
        world = segment = frames["segment"].astype(np.int64)
        if self._worlds:
            world = np.array([self.world(number) for number in segment.tolist()], np.int64)
        trajectory = self.trajectory(row)
        return PosedFrames(
            frame_index, segment, world, is_keyframe, fraction > 0, trajectory, inertial
        )

    def trajectory(self, row: int = 0) -> Trajectory:
        """The poses of `path` alone."""
        return Trajectory(self.frames["stamp_ns"][row:].copy(), self._poses(row, "world_from_cam0"))

    def odometry(self, *, in_metres: bool = False) -> Trajectory:
        """The path of the odometry alone, before any loop: each segment in its own frame.

        In metres where a scale was applied, or in the units of the odometry.
        """
        poses, segments = self._poses(0, "odom_from_cam0"), self.frames["segment"]
        for number, scale in self.scales_of_segments().items() if in_metres else ():
            poses[segments == number, :3, 3] *= scale.value
        return Trajectory(self.frames["stamp_ns"].copy(), poses)

    def trajectory_with(
        self, keyframes: Ints, worlds: Ints, map_from_cam0: Floats, scale: Floats
    ) -> Trajectory:
        """The path with keyframes placed otherwise; arguments as for `move_keyframes`.

        Segments without any are in their odometry frames. The store does not change.
        """
        other = TrajectoryStore()
        other._frames.replace(self.frames)  # which `move_keyframes` reads only
        table = self._keyframes.rows.copy()
        table["world_from_cam0"], table["scale"] = table["odom_from_cam0"], 1.0
        other._keyframes.replace(table)
        unknown = np.full((len(keyframes), 6, 6), np.nan)
        other.move_keyframes(keyframes, worlds, map_from_cam0, scale, unknown)
        return other.trajectory()

    def _poses(self, row: int, frame: str) -> Floats:
        """Poses (n, 4, 4) of all frames from a row on, by the name of the keyframes' poses."""
        first, fraction = row, self.frames["fraction"]
        while first < len(fraction) and fraction[first] > 0:
            first -= 1
        frames = self.frames[first:]
        rows = self._keyframe_rows(frames["keyframe"])
        moved = whole_transforms(frames["keyframe_from_cam"])
        if frame == "world_from_cam0":
            moved[:, :3, 3] *= self._keyframes.rows["scale"][rows, None]
        poses = whole_transforms(self._keyframes.rows[frame][rows]) @ moved
        if len(rows) and rows[0] + 1 < len(self._keyframes):
            share_motion(poses, frames, rows, self._keyframes.rows, frame)
        fill(poses, frames["fraction"])
        return np.asarray(poses[row - first :])

    def _add_interpolated(self, frame_index: int, segment: int) -> None:
        if self.interpolated is None or len(self._frames) == 0:
            return
        last = self.frames[-1]
        if last["segment"] == segment:
            for row in self.interpolated.rows(last, frame_index):
                self._frames.append(*row)

    def _change_from(self, row: int) -> None:
        """Note that a keyframe was moved, and with it the frames around it."""
        row -= bool(np.isfinite(self._keyframes.rows["previous_from_cam"][row, 0, 0]))
        first = bisect_left(self.frames["keyframe"], self._keyframes.rows["id"][row])
        self._changed = min(self._changed, self._first_after_tracked(first))

    def _first_after_tracked(self, row: int) -> int:
        """The row, or the first of the interpolated frames before it, which move with it."""
        while 0 < row < len(self._frames) and self.frames["fraction"][row - 1] > 0:
            row -= 1
        return row

    def _keyframe_row(self, keyframe: int) -> int:
        # NumPy would copy the whole column each time.
        return bisect_left(self._keyframes.rows["id"], keyframe)

    def _keyframe_rows(self, keyframes: Ints | Sequence[int]) -> Ints:
        """Rows (n,) of non-decreasing ids (n,)."""
        if len(keyframes) == 0:
            return np.zeros(0, np.int64)
        first = self._keyframe_row(int(keyframes[0]))
        return first + self._keyframes.rows["id"][first:].searchsorted(keyframes)
