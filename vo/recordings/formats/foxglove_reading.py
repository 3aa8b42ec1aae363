"""Reader of Foxglove's messages in protobuf and JSON, and of `vo.Imu`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform as PbTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.json_format import ParseDict
from google.protobuf.json_format import ParseError as JsonError
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as PbMessage
from google.protobuf.timestamp_pb2 import Timestamp

from vo.base.errors import SourceError
from vo.base.files.bounded_json import load_json
from vo.recordings.formats.camera_messages import RawCalibration, calibration_message
from vo.recordings.formats.foxglove import imu_class
from vo.recordings.formats.messages import (
    CalibrationMessage,
    Codec,
    CompressedImageMessage,
    CompressedVideoMessage,
    FrameTransform,
    ImageMessage,
    ImuMessage,
    PoseMessage,
    ReadMessage,
    TransformsMessage,
    encoded_message,
    rigid_transform,
    vector3,
)

_NS_PER_S = 1_000_000_000
_FIRST_FIELD = b"\x0a"  # field 1, length-delimited: the stamp of all messages but FrameTransforms


def foxglove_codec(schema: str, message_encoding: str) -> Codec | None:
    """The codec of one of Foxglove's message types; None for unsupported types."""
    if schema not in _CONVERTERS:
        return None
    kind, message_class, convert = _CONVERTERS[schema]
    parse = _from_json if message_encoding == "json" else _from_protobuf
    peek = _no_stamp if message_encoding == "json" or kind is TransformsMessage else _peek

    def decode(data: bytes) -> ReadMessage:
        try:
            record = parse(data, message_class)
        except (DecodeError, JsonError, ValueError, RecursionError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SourceError(f"{schema} cannot be decoded: {reason}") from error
        return convert(record)

    return Codec(kind, decode, peek)


def _from_protobuf(data: bytes, message_class: type[PbMessage]) -> Any:
    return message_class.FromString(data)


def _from_json(data: bytes, message_class: type[PbMessage]) -> Any:
    content = load_json(data.decode())
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    return ParseDict(_times_as_text(content), message_class(), ignore_unknown_fields=True)


def _times_as_text(content: dict[str, Any]) -> dict[str, Any]:
    """Convert times from Foxglove's {sec, nsec} to text, as in protobuf's JSON mapping."""
    changed = dict(content)
    for name, value in content.items():
        if name == "timestamp" and isinstance(value, dict):
            time = Timestamp(seconds=int(value.get("sec", 0)), nanos=int(value.get("nsec", 0)))
            changed[name] = time.ToJsonString()
        elif name == "transforms" and isinstance(value, list):
            changed[name] = [_times_as_text(v) if isinstance(v, dict) else v for v in value]
    return changed


def _no_stamp(head: bytes) -> int | None:
    return None


def _peek(head: bytes) -> int | None:
    """The stamp, if it is the first field of the message; else None."""
    if head[:1] != _FIRST_FIELD or len(head) < 2 or len(head) < 2 + head[1]:
        return None
    try:
        return _stamp_ns(Timestamp.FromString(bytes(head[2 : 2 + head[1]])))
    except DecodeError:
        return None


def _stamp_ns(time: Timestamp) -> int:
    return int(time.seconds) * _NS_PER_S + int(time.nanos)


def _image(record: Any) -> ImageMessage:
    return ImageMessage(
        stamp_ns=_stamp_ns(record.timestamp),
        frame=record.frame_id,
        width=record.width,
        height=record.height,
        pixel_format=record.encoding,
        data=record.data,
        step=record.step,
    )


def _encoded(kind: Callable[..., ReadMessage], record: Any) -> ReadMessage:
    return kind(_stamp_ns(record.timestamp), record.frame_id, record.format, record.data)


def _calibration(record: Any) -> CalibrationMessage:
    return calibration_message(
        RawCalibration(
            stamp_ns=_stamp_ns(record.timestamp),
            frame=record.frame_id,
            size=(record.width, record.height),
            model=record.distortion_model,
            d=record.D,
            k=record.K,
            r=record.R,
            p=record.P,
        )
    )


def _imu(record: Any) -> ImuMessage:
    gyro, accel = vector3(record.angular_velocity), vector3(record.linear_acceleration)
    return ImuMessage(_stamp_ns(record.timestamp), record.frame_id, gyro, accel)


def _pose(record: Any) -> PoseMessage:
    pose = rigid_transform(record.pose.position, record.pose.orientation)
    return PoseMessage(_stamp_ns(record.timestamp), record.frame_id, pose)


def _transforms(record: Any) -> TransformsMessage:
    stamps = [_stamp_ns(each.timestamp) for each in record.transforms]
    return TransformsMessage(min(stamps, default=0), tuple(map(_transform, record.transforms)))


def _one_transform(record: Any) -> TransformsMessage:
    return TransformsMessage(_stamp_ns(record.timestamp), (_transform(record),))


def _transform(record: Any) -> FrameTransform:
    return FrameTransform(
        record.parent_frame_id,
        record.child_frame_id,
        rigid_transform(record.translation, record.rotation),
        _stamp_ns(record.timestamp),
    )


_CONVERTERS: dict[str, tuple[type[ReadMessage], type[PbMessage], Callable[[Any], ReadMessage]]] = {
    "foxglove.RawImage": (ImageMessage, RawImage, _image),
    "foxglove.CompressedImage": (
        CompressedImageMessage,
        CompressedImage,
        partial(_encoded, encoded_message),
    ),
    "foxglove.CompressedVideo": (
        CompressedVideoMessage,
        CompressedVideo,
        partial(_encoded, CompressedVideoMessage),
    ),
    "foxglove.CameraCalibration": (CalibrationMessage, CameraCalibration, _calibration),
    "foxglove.FrameTransform": (TransformsMessage, PbTransform, _one_transform),
    "foxglove.FrameTransforms": (TransformsMessage, FrameTransforms, _transforms),
    "foxglove.PoseInFrame": (PoseMessage, PoseInFrame, _pose),
    "vo.Imu": (ImuMessage, imu_class(), _imu),
}
