"""The same stereo images as messages, as image files, and as a video."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import layouts
import numpy as np

from vo.base.geometry.transforms import inverse
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    FrameTransform,
    ImageMessage,
    Message,
    TransformsMessage,
)
from vo.recordings.sources.source import Recording

Messages = Iterator[tuple[str, Message]]


def messages(source: Recording, codec: str = "mono8") -> Messages:
    """A stereo recording as messages; `codec` is mono8 or png."""
    rig = source.rig
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    first = int(source.stamps_ns[0])
    beside = FrameTransform("cam0", "cam1", inverse(rig.cam1_from_cam0))
    yield "/tf_static", TransformsMessage(first, (beside,))
    for frame in source.frames():
        assert frame.image1 is not None
        for name, camera, pixels in (
            ("cam0", rig.cam0, frame.image0),
            ("cam1", rig.cam1, frame.image1),
        ):
            projection = np.column_stack([camera.matrix, np.zeros(3)])
            yield (
                f"/{name}/camera_info",
                CalibrationMessage(frame.stamp_ns, name, camera, np.eye(3), projection),
            )
            height, width = pixels.shape
            if codec == "mono8":
                raw = ImageMessage(frame.stamp_ns, name, width, height, codec, pixels.tobytes())
                yield f"/{name}/image_raw", raw
            else:
                data = cv2.imencode(".png", pixels)[1].tobytes()
                packed = CompressedImageMessage(frame.stamp_ns, name, "png", data)
                yield f"/{name}/image_raw/compressed", packed


def write_glob(path: Path, source: Recording) -> Path:
    for frame in source.frames():
        assert frame.image1 is not None
        layouts.write_image(path / f"left_{frame.stamp_ns}.png", frame.image0)
        layouts.write_image(path / f"right_{frame.stamp_ns}.tif", frame.image1)
    write_calibration(path / "calibration.yaml", source.rig)
    return path / "left_*.png"


def write_video(path: Path, source: Recording) -> Path:
    """The left camera as lossless video; time begins at 0."""
    unit = Fraction(1, 10**9)
    with av.open(str(path), "w", options={"video_track_timescale": "1000000000"}) as container:
        stream = container.add_stream("png", rate=20)
        stream.width, stream.height = source.rig.cam0.width, source.rig.cam0.height
        stream.pix_fmt, stream.time_base = "gray", unit
        stream.codec_context.time_base = unit
        for frame in source.frames():
            image = av.VideoFrame.from_ndarray(frame.image0, format="gray")
            image.pts, image.time_base = frame.stamp_ns - int(source.stamps_ns[0]), unit
            container.mux(stream.encode(image))
        container.mux(stream.encode())
    write_calibration(path.with_suffix(".yaml"), source.rig)
    return path
