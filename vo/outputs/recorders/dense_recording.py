"""Records dense results for the rerun viewer."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Bytes, Floats, Floats32
from vo.outputs.recorders import entities
from vo.outputs.recorders.sink import open_file
from vo.outputs.recorders.timelines import Moment, Timelines
from vo.recordings.formats.mesh import Mesh

_CLOUD, _MESH, _DEPTH = "world/cloud", "world/mesh", "world/cam0/depth"
_LEVELS = 65535  # of a depth


class DenseRecording:
    """An `.rrd` file with depths of keyframes, and what they are joined to.

    `far`: the largest depth.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(
        self, path: Path, name: str, size: tuple[int, int], camera: Intrinsics, far: float
    ) -> None:
        views = rrb.Spatial3DView(origin=entities.WORLD), rrb.Spatial2DView(origin=_DEPTH)
        self._sink = open_file(path, name, rrb.Blueprint(rrb.Horizontal(*views)))
        self._scale, self._times = _LEVELS / far, Timelines()
        pinhole = rr.Pinhole(
            focal_length=[camera.fx, camera.fy],
            principal_point=[camera.cx + 0.5, camera.cy + 0.5],
            resolution=list(size),
            camera_xyz=rr.ViewCoordinates.RDF,
        )
        self._sink.log_static(entities.WORLD, rr.ViewCoordinates.RDF)
        self._sink.log_static(_DEPTH, pinhole)

    def add(self, frame: int, stamp_ns: int, world_from_cam: Floats, depth: Floats32) -> None:
        """Add the depths (H, W) of a keyframe, 0 where unknown."""
        whole = np.rint(depth * np.float32(self._scale)).astype(np.uint16)
        times = self._times.columns([Moment(frame, stamp_ns)])
        turn = quat_xyzw_from_rotation(world_from_cam[:3, :3])
        pose = rr.Transform3D.columns(translation=[world_from_cam[:3, 3]], quaternion=[turn])
        image = rr.EncodedDepthImage.columns(
            blob=[cv2.imencode(".png", whole)[1].tobytes()],
            media_type=["image/png"],
            meter=[self._scale],
        )
        self._sink.send(_DEPTH, times, [*pose, *image])

    def finish(self, points: tuple[Floats, Bytes], mesh: Mesh | None, centres: Floats) -> None:
        """Add points (N, 3) with colours (N, 3), a mesh and a path (K, 3)."""
        sink = self._sink
        sink.log_static(_CLOUD, rr.Points3D(points[0], colors=points[1]))
        if mesh is not None:
            surface = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.triangles,
                vertex_colors=mesh.rgb,
            )
            sink.log_static(_MESH, surface)
        path_lines = rr.LineStrips3D([centres], colors=[entities.ORANGE])
        sink.log_static(entities.SMOOTHED_PATH, path_lines)
        sink.close()
