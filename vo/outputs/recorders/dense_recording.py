"""Records dense results for the rerun viewer."""

from __future__ import annotations

from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from vo.base.types import Bytes, Floats
from vo.outputs.recorders import entities
from vo.outputs.recorders.sink import open_file
from vo.recordings.formats.mesh import Mesh

_CLOUD, _MESH = "world/cloud", "world/mesh"


def record_dense(
    path: Path, name: str, points: tuple[Floats, Bytes], mesh: Mesh | None, centres: Floats
) -> None:
    """Write points (N, 3) with colours (N, 3), a mesh and a path (K, 3) to an `.rrd` file.

    Raises:
        OutputError: the file cannot be written.
    """
    sink = open_file(path, name, rrb.Blueprint(rrb.Spatial3DView(origin=entities.WORLD)))
    sink.log_static(entities.WORLD, rr.ViewCoordinates.RDF)
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
