"""Small videos whose frames show their number, at a variable rate."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import layouts
import numpy as np

from vo.base.types import Bytes

COUNT = 40
# At 90 kHz: a camera that is now slower, now faster.
TICKS = np.cumsum([0] + [3003, 3003, 3750, 9000, 300] * 8)[:COUNT].tolist()


def picture(index: int) -> Bytes:
    """Grey levels that encode the number of the frame, even after lossy compression."""
    image = np.full((layouts.HEIGHT, layouts.WIDTH), 20 + 5 * index, np.uint8)
    image[:, :8] = 250  # a bright edge on the left, to see how it is turned
    return image


def number(image: Bytes) -> int:
    return round((float(np.median(image)) - 20) / 5)


def write(
    path: Path, codec: str, pixels: str = "yuv420p", ticks: list[int] = TICKS, **options: str
) -> Path:
    unit = Fraction(1, 90000)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options=options)
        stream.codec_context.thread_count = 1
        stream.width, stream.height, stream.pix_fmt = layouts.WIDTH, layouts.HEIGHT, pixels
        stream.time_base = stream.codec_context.time_base = unit
        for i, tick in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(picture(i), format="gray").reformat(format=pixels)
            frame.pts, frame.time_base = tick, unit
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    layouts.write_text(path.parent / "calibration.yaml", layouts.CALIBRATION)
    return path


def expected_ns(ticks: list[int] = TICKS) -> list[int]:
    return [round(Fraction(tick, 90000) * 10**9) for tick in ticks]
