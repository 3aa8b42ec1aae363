"""What is shown of the newest frame and the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from vo.base.frozen import frozen
from vo.base.types import Bytes, Camera, Floats, Floats32, Landmarks


class FeatureState:
    """Codes of `View.feature_state`."""

    NEW, TRACKED, REJECTED = 0, 1, 2


@frozen(eq=False)
class FurtherImage:
    """An image of another camera of a rig, of the same pinhole camera as that of `View.image0`.

    Attributes:
        name: such as `cam2`, and `cam2_1` of the second view of a wide lens.
        image: None where it is missing.
        cam0_from_image: (4, 4) from its camera to the recorded cam0.
    """

    name: str
    image: Bytes | None
    cam0_from_image: Floats


@frozen(eq=False)
class View:
    """A tracked frame for display.

    Attributes:
        image0: the tracked image: rectified in stereo, as recorded in mono.
        image1: its rectified partner, or None.
        xy: (N, 2) float32 pixels of the features in image0.
        feature_state: (N,) uint8, codes of `FeatureState`.
        previous_xy: (N, 2) float32 where the feature's landmark was in the previous frame, or NaN.
        camera_matrix: (3, 3) of image0 as an ideal pinhole camera.
        right_u: (N,) float32 where the feature is in image1, in the same row, or NaN.
        error_px: (N,) float32 reprojection error of the feature's landmark, NaN without one.
        lens: the distorted camera of image0, None for an ideal pinhole camera.
        baseline_m: distance from image0's camera to image1's, 0 in mono.
        cam0_from_image0: (4, 4) from the camera of image0 to the recorded cam0.
        path: the file with the image of cam0 as recorded, or None.
        masks: (H, W) uint8 of image0 and image1, 0 where they were not used, or None.
        further: of a rig, the images besides image0; the same ones in each frame.
    """

    image0: Bytes
    image1: Bytes | None
    xy: Floats32
    feature_state: Bytes
    previous_xy: Floats32
    camera_matrix: Floats
    right_u: Floats32 | None = None
    error_px: Floats32 | None = None
    lens: Camera | None = None
    baseline_m: float = 0.0
    cam0_from_image0: Floats | None = None
    path: Path | None = None
    masks: tuple[Bytes | None, Bytes | None] = (None, None)
    further: tuple[FurtherImage, ...] = ()


@frozen(eq=False)
class Snapshot:
    """The newest frame and the local map, for display.

    Attributes:
        view: the frame.
        landmarks: the map, None where no keyframe was added or moved.
        neighbours: numbers of landmarks shared with a new keyframe, by frame index of the others.
    """

    view: View
    landmarks: Landmarks | None
    neighbours: Mapping[int, int] = field(default_factory=dict)
