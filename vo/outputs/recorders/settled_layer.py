"""The settled path, its uncertainty and the settled landmarks in the map view.

They are logged piece by piece, at the moment when each piece settles. Pieces cannot be taken back:
once an old keyframe is re-posed, they are hidden, and the settled map is logged in chunks instead.
A chunk is an entity (`…_chunks/0` and so on), of which the newest row is valid, so that only chunks
that have moved are logged again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vo.base.geometry.transforms import quat_xyzw_from_rotation, transform_points
from vo.base.types import Bools, Bytes, Floats, Floats32, Ints, KeyframePose, Landmarks, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.timelines import Batch, Moment, Strips

_KEYFRAMES_PER_CHUNK = 32  # more make each growth of the newest chunk larger, fewer more entities


class ChunkContent(NamedTuple):
    """One chunk of the settled map at its current place."""

    number: int  # from 0, in order of time
    moment: Moment  # of its newest keyframe or landmark
    keyframes: list[KeyframePose]
    strips: list[Floats]  # the path (N, 3) through them, from the chunk before on; one per segment
    points: Points


@dataclass
class _Chunk:
    moment: Moment
    keyframes: set[int] = field(default_factory=set)
    points: list[Points] = field(default_factory=list)


class SettledMap:
    """What has left the window and the local map.

    `poses`: the current poses of all keyframes by frame number.
    """

    def __init__(self, poses: Mapping[int, KeyframePose]) -> None:
        self._poses = poses
        self._chunk_of: dict[int, int] = {}  # by frame number of settled keyframes
        self._chunks: list[_Chunk] = []
        self._changed: set[int] = set()

    def add_keyframes(self, moment: Moment, keyframes: Iterable[KeyframePose]) -> None:
        """Add newly settled keyframes."""
        for keyframe in keyframes:
            number = len(self._chunk_of) // _KEYFRAMES_PER_CHUNK
            number = self._chunk_of.setdefault(keyframe.frame_index, number)
            self._chunk(moment, number).keyframes.add(keyframe.frame_index)

    def add_points(self, moment: Moment, points: Points) -> None:
        """Add landmarks that have left the local map, each to the chunk of its keyframe."""
        newest = max(len(self._chunks) - 1, 0)  # for keyframes that have not settled yet
        frames = points.keyframe.tolist()
        numbers = np.array([self._chunk_of.get(frame, newest) for frame in frames], np.int64)
        points = replace(points, xyz=points.xyz.astype(np.float32))  # as logged
        for number in np.unique(numbers).tolist():
            self._chunk(moment, number).points.append(points.take(numbers == number))

    def move(self, moves: Mapping[int, Floats]) -> None:
        """Move landmarks with their re-posed keyframes (`KeyframeChanges.moves`)."""
        frames = np.array(list(moves), dtype=np.int64)
        for number, chunk in enumerate(self._chunks):
            points = concatenate(chunk.points)
            has_points = bool(np.isin(points.keyframe, frames).any())
            if has_points:
                chunk.points = [points.moved(moves)]
            is_moved = has_points or not chunk.keyframes.isdisjoint(moves)
            # The path through a chunk begins in the chunk before it.
            begins_moved = number > 0 and not self._chunks[number - 1].keyframes.isdisjoint(moves)
            if is_moved or begins_moved:
                self._changed.add(number)

    def take_changed(self) -> list[ChunkContent]:
        """Chunks that have grown or moved since the last call."""
        changed, self._changed = sorted(self._changed), set()
        return [self._content(number) for number in changed]

    def _chunk(self, moment: Moment, number: int) -> _Chunk:
        """The chunk with a number, to be extended; created if it is the next one."""
        if number == len(self._chunks):
            self._chunks.append(_Chunk(moment))
        chunk = self._chunks[number]
        chunk.moment = moment
        self._changed.add(number)
        return chunk

    def _content(self, number: int) -> ChunkContent:
        chunk = self._chunks[number]
        keyframes = [self._poses[frame] for frame in sorted(chunk.keyframes)]
        before = self._chunks[number - 1].keyframes if number else set()
        chain = [self._poses[max(before)], *keyframes] if before else keyframes
        points = concatenate(chunk.points)
        return ChunkContent(number, chunk.moment, keyframes, _strips(chain), points)


def _strips(chain: Sequence[KeyframePose]) -> list[Floats]:
    segments = np.array([keyframe.segment for keyframe in chain])
    positions = np.array([keyframe.world_from_cam0[:3, 3] for keyframe in chain]).reshape(-1, 3)
    return [positions[segments == segment] for segment in np.unique(segments)]


_UNKNOWN_GREY = 160
_WHITE_RATIO = 0.35  # of white mixed in, so that dark points are visible on the dark background
_CERTAIN, _UNCERTAIN = 0.003, 0.1  # standard deviation relative to the distance
_MIN_RADIUS, _MAX_RADIUS, _STEPS = 0.9, 2.6, 4  # ui points, by uncertainty


@dataclass(frozen=True, eq=False)
class Points:
    """Points to draw; row i of each array belongs together."""

    xyz: Floats | Floats32  # (N, 3) in the world
    colours: NDArray[np.uint32]  # (N,) uint32 RGBA
    radii: Floats32  # (N,) in ui points, negative as rerun requires
    keyframe: Ints  # (N,) frame number of the last keyframe that observes the point, -1 if unknown

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, rows: Bools) -> Points:
        """The selected points."""
        return Points(self.xyz[rows], self.colours[rows], self.radii[rows], self.keyframe[rows])

    def moved(self, moves: Mapping[int, Floats]) -> Points:
        """The points, each moved with its keyframe.

        `moves`: motions (4, 4) in the world by frame number of keyframes.
        """
        xyz = self.xyz.copy()
        for frame in np.unique(self.keyframe).tolist():
            if frame in moves:
                rows = self.keyframe == frame
                xyz[rows] = transform_points(moves[frame], xyz[rows])
        return replace(self, xyz=xyz)


NO_POINTS = Points(
    np.empty((0, 3)), np.empty(0, np.uint32), np.empty(0, np.float32), np.empty(0, np.int64)
)


def concatenate(pieces: list[Points]) -> Points:
    """All points of several pieces."""
    pieces = pieces or [NO_POINTS]
    return Points(
        np.concatenate([piece.xyz for piece in pieces]),
        np.concatenate([piece.colours for piece in pieces]),
        np.concatenate([piece.radii for piece in pieces]),
        np.concatenate([piece.keyframe for piece in pieces]),
    )


class LandmarkHistory:
    """The landmarks of the local map when it was logged last."""

    def __init__(self) -> None:
        self._ids: Ints = np.empty(0, dtype=np.int64)
        self._points = NO_POINTS

    def update(self, landmarks: Landmarks, world_from_cam0: Floats) -> tuple[Points, Points]:
        """Replace the local map; its points, and the points that have left it."""
        settled = self._points.take(~np.isin(self._ids, landmarks.ids))
        self._ids = landmarks.ids
        distance = np.linalg.norm(landmarks.xyz - world_from_cam0[:3, 3], axis=1)
        colours = _colours(landmarks.grey, len(distance))
        radii = _radii(landmarks.sigma, distance)
        self._points = Points(landmarks.xyz, colours, radii, _last_keyframe(landmarks))
        return self._points, settled

    def move(self, moves: Mapping[int, Floats]) -> None:
        """Move the points with their re-posed keyframes."""
        self._points = self._points.moved(moves)


def _last_keyframe(landmarks: Landmarks) -> Ints:
    """Frame number (M,) of the last keyframe that observes each landmark, -1 without one."""
    keyframe = np.full(len(landmarks.ids), -1, dtype=np.int64)
    for each in landmarks.sightings:  # in time order
        keyframe[np.isin(landmarks.ids, each.ids)] = each.frame_index
    return keyframe


def _colours(grey: Bytes | None, count: int) -> NDArray[np.uint32]:
    level = np.full(count, _UNKNOWN_GREY) if grey is None else grey.astype(np.float64)
    shown = np.asarray(255 * _WHITE_RATIO + (1.0 - _WHITE_RATIO) * level).astype(np.uint32) & 0xFC
    return np.asarray(shown * 0x01010100 + 0xFF, dtype=np.uint32)


def _radii(sigma: Floats | None, distance: Floats) -> Floats32:
    """Radii (N,) that grow with the uncertainty, in a few steps; negative means ui points."""
    if sigma is None:
        return np.full(len(distance), -_MIN_RADIUS, dtype=np.float32)
    ratio = np.log(sigma / np.maximum(distance, 1e-9) / _CERTAIN) / np.log(_UNCERTAIN / _CERTAIN)
    step = np.round(np.nan_to_num(ratio, nan=1.0, posinf=1.0).clip(0.0, 1.0) * _STEPS) / _STEPS
    return np.asarray(-(_MIN_RADIUS + (_MAX_RADIUS - _MIN_RADIUS) * step), dtype=np.float32)


_SHOWN_SIGMAS = 10.0  # one sigma would be too small to be visible


class SettledLayer:
    """Logs keyframes that have left the window, and landmarks that have left the local map.

    `poses`: the current poses of all keyframes by frame number.
    """

    def __init__(self, batch: Batch, poses: Mapping[int, KeyframePose]) -> None:
        self._batch = batch
        self._map = SettledMap(poses)
        self._in_chunks = False
        self._chunks: set[int] = set()  # numbers of the chunks that were logged

    def log_styles(self) -> None:
        """Log colours and sizes of the entities."""
        self._log_styles("")

    def add_keyframes(
        self, moment: Moment, keyframes: Sequence[KeyframePose], lines: list[Floats]
    ) -> None:
        """Add newly settled keyframes, and the lines (2, 3) to them."""
        self._map.add_keyframes(moment, keyframes)
        if self._in_chunks:
            return
        if lines:
            add_strips(self._batch, moment, entities.SMOOTHED_PATH, lines)
        self._add_covariances(moment, entities.COVARIANCE, keyframes)

    def add_landmarks(self, moment: Moment, points: Points) -> None:
        """Add landmarks that have left the local map."""
        self._map.add_points(moment, points)
        if len(points) and not self._in_chunks:
            add_points(self._batch, moment, entities.SETTLED_LANDMARKS, points)

    def repose(self, moves: Mapping[int, Floats]) -> None:
        """Move landmarks with their re-posed keyframes (`KeyframeChanges.moves`)."""
        if not self._in_chunks:
            self._in_chunks = True
            self._hide_pieces()
        self._map.move(moves)

    def log_changed_chunks(self, moment: Moment) -> None:
        """Log the chunks that have grown or moved; after the first re-posing, all of them."""
        if self._in_chunks:
            for chunk in self._map.take_changed():
                self._log_chunk(moment, chunk)

    def finish(
        self, moment: Moment, window: Sequence[KeyframePose], pieces: Sequence[Trajectory]
    ) -> None:
        """Log the final path, one strip per segment, instead of the growing one.

        `window`: keyframes that have not settled.
        """
        self.add_keyframes(moment, window, [])
        self.log_changed_chunks(moment)
        for number in sorted(self._chunks):
            self._log_static_path(_suffix(number), [])
        self._log_static_path("", [piece.positions for piece in pieces])

    def _log_chunk(self, moment: Moment, chunk: ChunkContent) -> None:
        suffix = _suffix(chunk.number)
        if chunk.number not in self._chunks:
            self._chunks.add(chunk.number)
            self._log_styles(suffix)
            moment = chunk.moment  # not hidden before the re-posing
        add_strips(self._batch, moment, entities.SMOOTHED_PATH + suffix, chunk.strips)
        add_points(self._batch, moment, entities.SETTLED_LANDMARKS + suffix, chunk.points)
        self._add_covariances(moment, entities.COVARIANCE + suffix, chunk.keyframes)

    def _log_styles(self, suffix: str) -> None:
        path = rr.LineStrips3D.from_fields(colors=[entities.SKY], radii=rr.Radius.ui_points(2.0))
        self._batch.log_static(entities.SMOOTHED_PATH + suffix, path)
        shells = rr.Ellipsoids3D.from_fields(
            colors=[entities.PINK], line_radii=rr.Radius.ui_points(0.4)
        )
        self._batch.log_static(entities.COVARIANCE + suffix, shells)

    def _hide_pieces(self) -> None:
        """Hide all pieces by empty static data, which take precedence."""
        self._log_static_path("", [])
        points = rr.Points3D.from_fields(positions=[])
        self._batch.log_static(entities.SETTLED_LANDMARKS, points)
        shells = rr.Ellipsoids3D.from_fields(half_sizes=[], centers=[], quaternions=[])
        self._batch.log_static(entities.COVARIANCE, shells)

    def _log_static_path(self, suffix: str, strips: list[Floats]) -> None:
        path = rr.LineStrips3D.from_fields(strips=strips)
        self._batch.log_static(entities.SMOOTHED_PATH + suffix, path)

    def _add_covariances(
        self, moment: Moment, entity: str, keyframes: Iterable[KeyframePose]
    ) -> None:
        known = [k for k in keyframes if k.covariance is not None and k.covariance.any()]
        if not known:
            return
        shells = [_ellipsoid(keyframe) for keyframe in known]
        self._batch.add(
            moment,
            entity,
            rr.Ellipsoids3D,
            centers=np.array([k.world_from_cam0[:3, 3] for k in known]),
            half_sizes=np.array([half for half, _ in shells]),
            quaternions=np.array([quat for _, quat in shells]),
        )


def _suffix(chunk: int) -> str:
    # Not below the entity of the pieces, whose visible time range children could inherit.
    return f"_chunks/{chunk}"


def add_strips(batch: Batch, moment: Moment, entity: str, lines: list[Floats]) -> None:
    """Add a row of lines (N, 3)."""
    points = np.concatenate([np.empty((0, 3)), *lines]).astype(np.float32)
    strips = Strips(points, [len(line) for line in lines])
    batch.add(moment, entity, rr.LineStrips3D, strips=strips)


def add_points(batch: Batch, moment: Moment, entity: str, points: Points) -> None:
    """Add a row of points."""
    batch.add(
        moment,
        entity,
        rr.Points3D,
        positions=points.xyz.astype(np.float32),
        colors=points.colours,
        radii=points.radii,
    )


def _ellipsoid(keyframe: KeyframePose) -> tuple[Floats, Floats]:
    """Half sizes (3,) and orientation (xyzw) of the position's covariance in the world."""
    assert keyframe.covariance is not None
    variance, axes = np.linalg.eigh(keyframe.covariance[3:, 3:])
    rotation = keyframe.world_from_cam0[:3, :3] @ axes
    rotation[:, 0] *= np.sign(np.linalg.det(rotation))  # eigenvectors may be left-handed
    half_sizes = _SHOWN_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return half_sizes, quat_xyzw_from_rotation(rotation)
