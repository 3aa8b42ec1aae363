"""Writer of messages in Foxglove's protobuf schemas."""

from __future__ import annotations

from functools import cache

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform as PbTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import descriptor_pool
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.message import Message as PbMessage
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

from vo.base.geometry.transforms import quat_xyzw_from_rotation
from vo.base.types import Floats
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    Dialect,
    ImageMessage,
    ImuMessage,
    Message,
    PoseMessage,
    Schema,
    TransformsMessage,
    lens_model,
)

_NS_PER_S = 1_000_000_000


@cache
def imu_class() -> type[PbMessage]:
    """The protobuf class `vo.Imu`, because Foxglove has no schema for inertial sensors.

    Field types are those of Foxglove (timestamp, frame_id, Vector3), field names those of ROS's
    Imu message.
    """
    file = FileDescriptorProto(name="vo/Imu.proto", package="vo", syntax="proto3")
    file.dependency.extend(["google/protobuf/timestamp.proto", Vector3.DESCRIPTOR.file.name])
    message = file.message_type.add(name="Imu")
    record, text = FieldDescriptorProto.TYPE_MESSAGE, FieldDescriptorProto.TYPE_STRING
    for number, (name, kind, type_name) in enumerate(
        [
            ("timestamp", record, ".google.protobuf.Timestamp"),
            ("frame_id", text, None),
            ("angular_velocity", record, ".foxglove.Vector3"),
            ("linear_acceleration", record, ".foxglove.Vector3"),
        ],
        start=1,
    ):
        message.field.add(
            name=name,
            number=number,
            type=kind,
            type_name=type_name,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
    pool = descriptor_pool.Default()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("vo.Imu"))


def schema(kind: type[Message]) -> Schema:
    """The protobuf schema of a message type, with its dependencies."""
    return schema_of(_class_of(kind))


def schema_of(message_class: type[PbMessage]) -> Schema:
    """The schema of a protobuf class, with its dependencies."""
    definition = build_file_descriptor_set(message_class).SerializeToString(deterministic=True)
    return Schema(message_class.DESCRIPTOR.full_name, definition)


def encode(message: Message) -> bytes:
    """Serialise a message."""
    return as_protobuf(message).SerializeToString(deterministic=True)


def _class_of(kind: type[Message]) -> type[PbMessage]:
    classes: dict[type[Message], type[PbMessage]] = {
        ImageMessage: RawImage,
        CompressedImageMessage: CompressedImage,
        CalibrationMessage: CameraCalibration,
        ImuMessage: imu_class(),
        PoseMessage: PoseInFrame,
        TransformsMessage: FrameTransforms,
    }
    return classes[kind]


def as_protobuf(message: Message) -> PbMessage:
    """Convert a message to its protobuf class."""
    stamp = timestamp(message.stamp_ns)
    match message:
        case ImageMessage():
            return RawImage(
                timestamp=stamp,
                frame_id=message.frame,
                width=message.width,
                height=message.height,
                encoding=message.pixel_format,
                step=message.row_bytes,
                data=bytes(message.data),
            )
        case CompressedImageMessage():
            return CompressedImage(
                timestamp=stamp,
                frame_id=message.frame,
                format=message.image_format,
                data=message.data,
            )
        case CalibrationMessage():
            return _calibration(message, stamp)
        case ImuMessage():
            return imu_class()(
                timestamp=stamp,
                frame_id=message.frame,
                angular_velocity=vector(message.gyro),
                linear_acceleration=vector(message.accel),
            )
        case PoseMessage():
            pose = Pose(position=vector(message.pose[:3, 3]), orientation=quaternion(message.pose))
            return PoseInFrame(timestamp=stamp, frame_id=message.frame, pose=pose)
        case TransformsMessage():
            return _transforms(message, stamp)


def _calibration(message: CalibrationMessage, stamp: Timestamp) -> CameraCalibration:
    camera = message.camera
    model, coefficients = lens_model(camera, fisheye="kannala_brandt")
    return CameraCalibration(
        timestamp=stamp,
        frame_id=message.frame,
        width=camera.width,
        height=camera.height,
        distortion_model=model,
        D=coefficients,
        K=camera.matrix.ravel().tolist(),
        R=message.rectified_from_cam.ravel().tolist(),
        P=message.projection.ravel().tolist(),
    )


def _transforms(message: TransformsMessage, stamp: Timestamp) -> FrameTransforms:
    return FrameTransforms(
        transforms=[
            PbTransform(
                timestamp=stamp,
                parent_frame_id=each.parent,
                child_frame_id=each.child,
                translation=vector(each.parent_from_child[:3, 3]),
                rotation=quaternion(each.parent_from_child),
            )
            for each in message.transforms
        ]
    )


def timestamp(stamp_ns: int) -> Timestamp:
    """Convert a stamp to protobuf."""
    seconds, nanos = divmod(stamp_ns, _NS_PER_S)
    return Timestamp(seconds=seconds, nanos=nanos)


def vector(xyz: Floats) -> Vector3:
    """Convert coordinates (3,) to protobuf."""
    x, y, z = xyz.tolist()
    return Vector3(x=x, y=y, z=z)


def quaternion(transform: Floats) -> Quaternion:
    """Convert the rotation of a transform (4, 4) to protobuf."""
    x, y, z, w = quat_xyzw_from_rotation(transform[:3, :3]).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _no_metadata(topic: str) -> dict[str, str]:
    return {}


FOXGLOVE = Dialect(
    profile="",
    message_encoding=MessageEncoding.Protobuf,
    schema_encoding=SchemaEncoding.Protobuf,
    schema=schema,
    encode=encode,
    channel_metadata=_no_metadata,
    metadata={},
)
