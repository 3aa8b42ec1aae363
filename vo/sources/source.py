"""What every kind of recording offers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from vo.sources.images import ImageKind
from vo.sources.imu import Imu
from vo.types import Frame, Ints, Rig, Skipped, Trajectory


class Source(Protocol):
    """A recording: a rig of cameras and its frames in time order.

    Attributes:
        name: short name for titles and file names.
        format: name of the format in the registry.
        rig: the cameras, cam1 only if the frames have an image1.
        ground_truth: true poses of cam0, or None where the recording has none.
        skipped: frames that `frames` could not hand out so far, and why.
        unpaired: frames that `frames` handed out without their image1 so far, in stereo.
        imus: inertial sensors, the one to use first; they are read when they are asked for.
    """

    name: str
    format: str
    rig: Rig
    ground_truth: Trajectory | None
    skipped: list[Skipped]
    unpaired: int
    imus: tuple[Imu, ...]

    def __len__(self) -> int:
        """Number of frames before slicing."""
        ...

    @property
    def stamps_ns(self) -> Ints:
        """(N,) the time of every frame before slicing, without reading an image."""
        ...

    def frames(
        self,
        start: int = 0,
        end: int | None = None,
        stride: int = 1,
        images: ImageKind = "grey",
    ) -> Iterator[Frame]:
        """Read frames start, start + stride, … below end, their images as some kind.

        Those that cannot be read are warned of, noted in `skipped` and left out.
        """
        ...
