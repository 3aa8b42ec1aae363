"""Contracts of feature extraction and matching.

An extractor turns an image into features; a matcher pairs two sets of features. ORB
(`vo.engine.frontend.orb`) and Hamming matching (`vo.engine.frontend.matching`) are the built-in
ones; others are handed to `vo.engine.odometry.Odometry`.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import NamedTuple, Protocol

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Bytes, Descriptors, Floats, Floats32, Ints, Keypoints


class DescriptorFormat(NamedTuple):
    """Layout of the descriptors of an extractor."""

    width: int
    dtype: np.dtype[np.generic]

    @property
    def words(self) -> str:
        """The layout for error messages, e.g. `32 x uint8`."""
        return f"{self.width} x {self.dtype}"

    def check(self, descriptor: Descriptors) -> None:
        """Check an array of descriptors.

        Raises:
            ValueError: it is not (N, width) of this type.
        """
        if descriptor.ndim == 2 and (descriptor.shape[1], descriptor.dtype) == self:
            return
        shape = " x ".join(map(str, descriptor.shape))
        raise ValueError(
            f"descriptors are an array {shape} of {descriptor.dtype}, expected N x {self.words}"
        )


class FeatureExtractor(Protocol):
    """Detects features in an image and describes them."""

    @property
    def descriptor_format(self) -> DescriptorFormat:
        """Layout of the descriptors."""
        ...

    @property
    def scale_factor(self) -> float:
        """Size of a feature relative to one of an octave lower; 1 without octaves."""
        ...

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """Features of an image.

        Args:
            image: (H, W) uint8.
            mask: (H, W) uint8, 0 where no feature may lie; None for the whole image.
            helper: a thread that may do a part of the work; it must not change the result.

        Returns:
            Positions in pixels of `image`, octaves (0 without a pyramid), angles in radians (NaN
            without orientation), responses and descriptors.
        """
        ...


class PointDescriber(FeatureExtractor, Protocol):
    """An extractor that can also describe given pixels."""

    def extract_and_describe(
        self, image: Bytes, xy: Floats, mask: Bytes | None = None
    ) -> tuple[Keypoints, Keypoints]:
        """Features of an (H, W) image outside of where a mask is 0, and pixels (N, 2) as such."""
        ...


@frozen(eq=False)
class FeatureSet:
    """What a matcher needs to know of features; rows belong together.

    Attributes:
        xy: (N, 2) pixels; of a query the predicted positions, NaN where there is none, and None
            without any (the landmarks of several keyframes have no common image).
        octave: (N,) int32.
        angle: (N,) radians, NaN without orientation.
        descriptor: (N, width).
        size: (width, height) of the image, None where it is not known; it is known where there
            are positions and no search region.
        response: (N,) of the detector, None if it is not known.
    """

    xy: Floats | Floats32 | None
    octave: np.ndarray[tuple[int, ...], np.dtype[np.int32]]
    angle: Floats32
    descriptor: Descriptors
    size: tuple[int, int] | None = None
    response: Floats32 | None = None

    def __len__(self) -> int:
        return len(self.octave)

    def select(self, rows: Ints) -> FeatureSet:
        """Some of them."""
        xy = None if self.xy is None else self.xy[rows]
        response = None if self.response is None else self.response[rows]
        octave, angle, descriptor = self.octave[rows], self.angle[rows], self.descriptor[rows]
        return FeatureSet(xy, octave, angle, descriptor, self.size, response)


def feature_set(
    keypoints: Keypoints,
    rows: Ints | None = None,
    xy: Floats | Floats32 | None = None,
    size: tuple[int, int] | None = None,
) -> FeatureSet:
    """The features of an image, or some rows of them, perhaps at other positions `xy`."""
    k = keypoints if rows is None else keypoints.select(rows)
    at = k.xy if xy is None else xy
    return FeatureSet(at, k.octave, k.angle, k.descriptor, size, k.response)


@frozen(eq=False)
class Circles:
    """Search region: circles around the predicted positions of the query.

    Attributes:
        radius_px: (N,) pixels.
    """

    radius_px: Floats


@frozen(eq=False)
class EpipolarSegments:
    """Search region: neighbourhoods of epipolar segments.

    Attributes:
        start: (N, 2) pixel in the train image of the query's minimum depth.
        end: (N, 2) that of its maximum depth.
        tolerance_px: (M,) maximum distance from the segment for each train feature.
    """

    start: Floats
    end: Floats
    tolerance_px: Floats


SearchRegion = Circles | EpipolarSegments | None


class Matches(NamedTuple):
    """Pairs of features.

    Attributes:
        query: (n,) increasing rows of the query set.
        train: (n,) rows of the train set, each at most once.
        score: (n,) distance of the descriptors; lower is better.
    """

    query: Ints
    train: Ints
    score: Floats


class Matcher(Protocol):
    """Pairs two sets of features by their descriptors."""

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        """One-to-one matches.

        Args:
            query: features to find.
            train: features among which to find them.
            region: where each query feature may lie; None for everywhere.
            ratio: maximum ratio of best to second-best distance instead of the configured one.
            check_rotation: whether to keep only matches whose change of orientation is common.

        Raises:
            ValueError: descriptors of a layout that this matcher cannot compare.
        """
        ...
