"""Writer of Foxglove's protobuf messages for display: paths, point clouds, image annotations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion

from vo.base.types import Bytes, Floats, Floats32
from vo.recordings.formats.foxglove import quaternion, schema_of, timestamp, vector
from vo.recordings.formats.messages import Schema

_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    + [("alpha", "u1")]
)
_NUMERIC = {"f": PackedElementField.FLOAT32, "u": PackedElementField.UINT8}


class Colour(NamedTuple):
    """Red, green and blue, 0 to 1."""

    red: float
    green: float
    blue: float


def path_schema() -> Schema:
    """The schema of a path."""
    return schema_of(PosesInFrame)


def path_message(stamp_ns: int, frame: str, poses: Floats) -> PosesInFrame:
    """A path of poses (N, 4, 4) in `frame`."""
    return PosesInFrame(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        poses=[Pose(position=vector(p[:3, 3]), orientation=quaternion(p)) for p in poses],
    )


def cloud_message(stamp_ns: int, frame: str, xyz: Floats, grey: Bytes) -> PointCloud:
    """A cloud of points (M, 3) in `frame` with their grey levels (M,)."""
    rows = np.empty(len(xyz), dtype=_POINT)
    rows["x"], rows["y"], rows["z"] = xyz.T
    rows["red"] = rows["green"] = rows["blue"] = grey
    rows["alpha"] = 255
    fields = [
        PackedElementField(name=name, offset=field[1], type=_NUMERIC[field[0].kind])
        for name, field in (_POINT.fields or {}).items()
    ]
    return PointCloud(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        pose=Pose(position=vector(np.zeros(3)), orientation=Quaternion(w=1.0)),
        point_stride=_POINT.itemsize,
        fields=fields,
        data=rows.tobytes(),
    )


def marks_message(
    stamp_ns: int, marks: Mapping[Colour, Floats32], size_px: float
) -> ImageAnnotations:
    """Annotations of an image: pixels (N, 2) by colour."""
    stamp = timestamp(stamp_ns)
    return ImageAnnotations(
        points=[
            PointsAnnotation(
                timestamp=stamp,
                type=PointsAnnotation.POINTS,
                points=[Point2(x=u, y=v) for u, v in xy.tolist()],
                outline_color=Color(r=colour.red, g=colour.green, b=colour.blue, a=1.0),
                thickness=size_px,
            )
            for colour, xy in marks.items()
        ]
    )
