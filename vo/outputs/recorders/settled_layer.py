"""The settled path, its uncertainty and the settled landmarks in the map view.

They are logged piece by piece, at the moment when each piece settles. Pieces cannot be taken back:
once an old keyframe is re-posed, they are hidden, and the settled map is logged in chunks instead.
A chunk is an entity (`…_chunks/0` and so on), of which the newest row is valid, so that only chunks
that have moved are logged again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import rerun as rr

from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Floats, KeyframePose, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.batch import Batch, Strips
from vo.outputs.recorders.landmark_history import Points
from vo.outputs.recorders.settled_map import ChunkContent, SettledMap
from vo.outputs.recorders.timelines import Moment

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
