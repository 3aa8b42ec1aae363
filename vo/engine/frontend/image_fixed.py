"""Detection of what stands still in the image while the scene moves.

The robot's own body, a bonnet, burnt-in text, or dirt on the lens. Tracking would take its features
for landmarks, and a camera that does not move explains them perfectly.

Images are compared when the scene has moved clearly: where nearly all textured places have changed
and the others are exactly as before. Distant places, the focus of expansion, and vehicles ahead
move a little too: such images are passed over until they have moved, and so have no long runs of
comparisons without a change. What drifts more slowly than the mean of images forgets is told from
fixed content by its first image, which it matches best a fraction of a pixel away.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import percentiles
from vo.base.types import Bools, Bytes, Floats32
from vo.engine.frontend.dark_border import DarkBorder
from vo.engine.frontend.image_gradients import (
    Gradients,
    correlation,
    displacement,
    gradients_of,
    mean_product,
)
from vo.engine.frontend.image_overlay import OverlayDetector
from vo.engine.frontend.pair_matching import PairPoints, is_scene
from vo.engine.frontend.still_majority import StillMajority

_MARGIN_PX = 10  # of that image: lenses and rectification leave dark edges at the image's borders
# Mean squared gradient (grey levels per pixel) of texture; and relative to the flattest parts of
# the image, which show the noise.
_MIN_TEXTURE, _MIN_TEXTURE_TO_NOISE, _FLATTEST_PERCENT = 9.0, 4.0, 5
_MIN_TEXTURED = 0.02  # ratio of the image
# Normalised correlation of gradients: less has moved by a pixel or more, more has not moved.
_MOVED, _SAME, _SAME_AS_MEAN = 0.65, 0.9, 0.8
# Ratio of texture that must have moved, and the maximum of what is neither moved nor the same.
_MIN_MOVED, _MAX_BETWEEN = 0.4, 0.15
# A camera stands where this ratio is the same and at least the other one has moved.
_MIN_STANDING, _MIN_PASSING, _MIN_RELEASE = 0.55, 0.1, 0.6
_MIN_RUN = 6  # comparisons without a change
# Pixels of the image of half the size, since the run began. Most of a body lies within a tenth.
_MAX_DRIFT_PX = 0.3
# Ratio of texture: on recordings without such content, at most 0.031 has a run of 6, and at most
# 0.009 lies still as well.
_MIN_SHARE, _MAX_SHARE = 0.035, 0.5
# What covers more of the image than this, or of its upper third, or this much of its upper and its
# lower third, may as well be the background of something large that passes a camera at rest.
_MAX_AREA, _MAX_TOP, _MAX_OPPOSITE = 0.33, 0.35, 0.1
# The same for nearly all of what is the same while the rest changes: a slow scene drifts by more.
_MAX_KEPT_DRIFT_PX, _MIN_KEPT, _NEIGHBOURS = 0.15, 0.75, (31, 31)
# Ratio of texture that must move, in how many comparisons, while most of the image never has.
_MIN_LONG_PASSING, _LONG = 0.3, 15
_MEAN_OF = 8  # images that the mean gradient remembers
_MOST = 0.6  # of what is fixed, for the place where it lies
_GROWTH_PX = 8  # added round what is fixed, pixels of the image of half the size: half a feature
_SETTLED = 8  # comparisons after which a recording is taken to be free of such content
# Frames between comparisons: at first, after `_SETTLED`, and after twice as many without a find.
_STEPS = (3, 6, 12)


class ImageFixed(NamedTuple):
    """Content that stands still in the images of camera 0.

    Attributes:
        mask: (H, W) uint8, 0 where such content is; None without any.
        share: ratio of the image that it covers.
        is_ambiguous: whether it covers so much that the camera may as well stand still while
            something large passes; there is no mask then.
        finds: number of times that a mask was made where there was none.
        is_settled: whether nothing was found for so long that it can no longer be expected.
        place: where most of it lies, such as `bottom`; empty if it is all over the image.
    """

    mask: Bytes | None = None
    share: float = 0.0
    is_ambiguous: bool = False
    finds: int = 0
    is_settled: bool = False
    place: str = ""

    @property
    def is_present(self) -> bool:
        """Whether there is such content."""
        return self.mask is not None or self.is_ambiguous

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The content as a fault of the recording."""
        if not self.is_present:
            return ()
        is_handled = not self.is_ambiguous
        return (Fault(FaultKind.IMAGE_FIXED_FEATURES, is_handled, self.share, self.place),)


class ImageFixedDetector:
    """Compares images with each other and with the mean of those before.

    Attributes:
        found: what is known after the newest image.

    Args:
        baseline_px: disparity at one metre, 0 without a pair of cameras.
    """

    def __init__(self, baseline_px: float = 0.0) -> None:
        self.found = ImageFixed()
        self._baseline_px = baseline_px
        self._points: PairPoints | None = None
        self._shape: tuple[int, ...] = (0, 0)
        self._frames = self._next = self._comparisons = self._finds = 0
        self._last: Gradients | None = None
        self._mean: tuple[Floats32, Floats32]
        self._first: tuple[Floats32, Floats32]  # gradients where each pixel's run began
        self._run: Bytes  # comparisons without a change, `_MEAN_OF` for more
        self._fixed: Bools
        self._background: Bools | None = None  # has stood still while something passed
        self._has_moved: Bools
        self._dark = DarkBorder()
        self._border: Bools | None = None  # a dark border that is fixed, with what is near it
        self._overlay = OverlayDetector()
        self._still_majority = StillMajority()
        self._standing = 0  # comparisons in which most of the image stood, since it has moved

    def update(
        self,
        pyramid: tuple[Bytes, ...],
        shape: tuple[int, ...],
        points: PairPoints | None = None,
        used: Bytes | None = None,
    ) -> ImageFixed:
        """Add an image.

        Args:
            pyramid: the rectified image at 1/2 of its size, first, and smaller.
            shape: (H, W).
            points: of the newest pair before it that was matched.
            used: (H, W) uint8, 0 where the image is not used anyway; None to use all of it.
        """
        self._points = points
        self._frames += 1
        if self._frames > self._next and pyramid:
            self._shape = shape
            self._next = self._frames - 1 + self._step()
            self._dark.update(pyramid[-1])
            self._compare(gradients_of(pyramid[0]), used)
        return self.found

    def _step(self) -> int:
        if self.found.mask is not None or self._comparisons < _SETTLED:
            return _STEPS[0]
        return _STEPS[1 if self._comparisons < 2 * _SETTLED else 2]

    def _compare(self, now: Gradients, used: Bytes | None) -> None:
        """Compare with the last image from which enough has moved."""
        if self._last is None:
            self._last = now
            self._mean = now.u.copy(), now.v.copy()
            self._first = now.u.copy(), now.v.copy()
            self._run = np.zeros(now.u.shape, np.uint8)
            self._fixed = np.zeros(now.u.shape, bool)
            self._has_moved = np.zeros(now.u.shape, bool)
            return
        textured = _textured(now) if used is None else _textured(now) & _of_half_size(used)
        count = int(np.count_nonzero(textured))
        if count < _MIN_TEXTURED * textured.size:
            return
        similar = correlation(now, self._last.u, self._last.v, self._last.energy)
        moved, same = textured & (similar < _MOVED), textured & (similar > _SAME)
        moved_ratio, same_ratio = np.count_nonzero(moved) / count, np.count_nonzero(same) / count
        between = 1.0 - moved_ratio - same_ratio
        if moved_ratio > _MIN_MOVED and self._overlay.update(
            now, textured & self._outside(), self._last, similar
        ):
            self.found = ImageFixed(share=1.0, is_ambiguous=True, finds=self._finds)
            return
        if same_ratio > _MIN_STANDING and moved_ratio > _MIN_PASSING > between:
            self._stand(same, moved_ratio, now)
        elif moved_ratio > _MIN_MOVED and between < _MAX_BETWEEN * moved_ratio:
            self._last = now
            self._has_moved |= moved
            self._standing = 0
            self._still_majority.restart()
            self._count_runs(now, textured, moved)
            self._judge(now, count)
            return
        if self._still_majority.update(now, self._last, similar, textured):
            self._doubt(same, now)

    def _outside(self) -> Bools:
        """Places outside of what is fixed, or may be."""
        outside = self._run < _MIN_RUN // 2
        mask = self.found.mask
        if mask is None:
            return outside
        height, width = outside.shape
        return np.asarray(outside & (mask[: 2 * height : 2, : 2 * width : 2] > 0))

    def _stand(self, same: Bools, moved_ratio: float, now: Gradients) -> None:
        """Most of the image is the same while something moves: the camera stands, probably."""
        self._background = same if self._background is None else self._background & same
        self._standing += moved_ratio > _MIN_LONG_PASSING
        if self._standing >= _LONG:
            self._doubt(same, now)

    def _doubt(self, same: Bools, now: Gradients) -> None:
        """Report what is the same, unless it has moved, or is the scene of a camera at rest."""
        if self.found.mask is not None:
            return
        never = same & ~self._has_moved
        if 2 * np.count_nonzero(never) <= np.count_nonzero(same):
            return
        if not self._has_kept_still(never, now):
            return
        if self._standing < _LONG and is_scene(never, self._points, self._baseline_px):
            return
        self.found = ImageFixed(None, _share(never), is_ambiguous=True, finds=self._finds)

    def _has_kept_still(self, places: Bools, now: Gradients) -> bool:
        """Whether places are exactly where they were, which those of a slow scene are not."""
        assert self._last is not None
        drift = displacement(now, self._last.u, self._last.v)
        at = places & drift.is_corner
        count = int(np.count_nonzero(at))
        # Neighbours drift together; the images' noise moves each another way.
        near = cv2.blur(at.astype(np.float32), _NEIGHBOURS) + np.float32(1e-6)
        u, v = (cv2.blur(at * s.clip(-1.0, 1.0), _NEIGHBOURS) / near for s in drift.shift_px)
        still = int(np.count_nonzero(at & (u * u + v * v < _MAX_KEPT_DRIFT_PX**2)))
        return count > _MIN_TEXTURED * at.size and still > _MIN_KEPT * count

    def _count_runs(self, now: Gradients, textured: Bools, moved: Bools) -> None:
        """Count comparisons without a change, each with the mean of those before."""
        mean_u, mean_v = self._mean
        energy = mean_product(mean_u, mean_v, mean_u, mean_v)
        similar = correlation(now, mean_u, mean_v, energy)
        _count(textured, similar, energy, self._run, self._fixed)
        for gradient, mean, first in zip((now.u, now.v), self._mean, self._first, strict=True):
            _renew(gradient, mean, first, self._run)
        if self._background is not None:
            stood = int(np.count_nonzero(self._background))
            if np.count_nonzero(self._background & moved) > _MIN_RELEASE * stood:
                self._background = None  # the camera has moved since

    def _judge(self, now: Gradients, count: int) -> None:
        """Mask what has not changed for long enough."""
        self._comparisons += 1
        fixed, unclear = self._run >= _MIN_RUN, False
        self._border = self._border_along(fixed, count)
        if self._background is not None:
            scene = self._background if self._border is None else self._background & ~self._border
            never = np.count_nonzero(fixed & scene & ~self._has_moved)
            unclear = bool(never > _MIN_SHARE * count)
            fixed &= ~scene
        self._fixed |= fixed
        share = float(np.count_nonzero(self._fixed)) / count
        is_new = self.found.mask is None
        if is_new and (share >= _MIN_SHARE or unclear) and not self._lies_still(now, count):
            share, unclear = 0.0, False
        is_border = self._border is not None and (share >= _MIN_SHARE or not is_new)
        others = self._fixed if self._border is None else self._fixed & ~self._border
        is_ambiguous = unclear or bool(np.count_nonzero(others) > _MAX_SHARE * count)
        is_ambiguous = is_ambiguous or _is_everywhere(others)
        if is_new and share >= _MIN_SHARE and not is_ambiguous:
            is_ambiguous = is_scene(others, self._points, self._baseline_px)
        few = share < (_MIN_SHARE if is_new else 0.5 * _MIN_SHARE)
        if few and not unclear and not is_border:
            is_settled = self._finds == 0 and self._comparisons >= _SETTLED
            self.found = ImageFixed(finds=self._finds, is_settled=is_settled)
        elif is_ambiguous and is_new:
            self.found = ImageFixed(
                None,
                _share(self._fixed),
                is_ambiguous=True,
                finds=self._finds,
                place=place_of(self._fixed),
            )
        else:
            self._finds += is_new
            self.found = ImageFixed(
                self._mask(), _share(self._fixed), finds=self._finds, place=place_of(self._fixed)
            )

    def _border_along(self, fixed: Bools, count: int) -> Bools | None:
        """A dark border, with what is near it, if most of what is fixed lies along it."""
        if self._border is None and np.count_nonzero(fixed) < _MIN_SHARE * count:
            return None
        near = self._dark.near(fixed.shape, _GROWTH_PX)
        is_known = self._border is not None and bool(near.any())
        is_along = 2 * np.count_nonzero(fixed & near) > np.count_nonzero(fixed)
        return near if is_known or is_along else None

    def _lies_still(self, now: Gradients, count: int) -> bool:
        """Whether enough of what has not changed is where it was when its run began."""
        drift = displacement(now, *self._first).squared_px
        still = (self._run >= _MIN_RUN) & (drift < _MAX_DRIFT_PX**2)
        return bool(np.count_nonzero(still) >= _MIN_SHARE * count)

    def _mask(self) -> Bytes:
        side = 2 * _GROWTH_PX + 1
        grown = cv2.dilate(self._fixed.astype(np.uint8), np.ones((side, side), np.uint8))
        if self._border is not None:
            grown |= self._border
        full = cv2.resize(grown, self._shape[::-1], interpolation=cv2.INTER_NEAREST)
        return np.asarray(1 - full, dtype=np.uint8)


@compiled
def _count(textured, similar, energy, run, fixed):  # type: ignore[no-untyped-def]
    """Continue the runs of what is the same as the mean, of an energy; what has moved is free."""
    for y in range(len(run)):
        at, likeness, of_mean = textured[y], similar[y], energy[y]
        lengths, is_fixed = run[y], fixed[y]
        for x in range(len(at)):
            is_same = at[x] & (likeness[x] > np.float32(_SAME_AS_MEAN))
            is_same &= of_mean[x] > np.float32(0.5 * _MIN_TEXTURE)
            lengths[x] = (lengths[x] + (lengths[x] < _MEAN_OF)) * is_same
            is_fixed[x] &= not (at[x] & (likeness[x] < np.float32(_MOVED)))


@compiled(error_model="numpy")
def _renew(gradient, mean, first, run):  # type: ignore[no-untyped-def]
    """Add gradients to the mean, and to the first ones where a run may begin."""
    for y in range(len(run)):
        newest, before, at_first, lengths = gradient[y], mean[y], first[y], run[y]
        for x in range(len(newest)):
            weight = np.float32(1.0) / np.float32(lengths[x] + 1)
            before[x] += weight * (newest[x] - before[x])
        for x in range(len(newest)):
            now, kept = newest[x], at_first[x]
            at_first[x] = now if lengths[x] == 0 else kept


def place_of(fixed: Bools) -> str:
    """Words for the part of the image (H, W) in which most of it lies, empty for no such part.

    A third of the height (top, bottom), of the width (left, right), or a corner of both.
    """
    total = max(int(np.count_nonzero(fixed)), 1)
    words = []
    for axis, (low, high) in ((1, ("top", "bottom")), (0, ("left", "right"))):
        counts = np.count_nonzero(fixed, axis=axis)
        third = len(counts) // 3
        for part, word in ((counts[:third], low), (counts[-third:], high)):
            if int(part.sum()) > _MOST * total:
                words.append(word)
    return " ".join(words)


def _is_everywhere(fixed: Bools) -> bool:
    """Whether it covers a large part of the image (H, W) or its top, or parts above and below."""
    third = len(fixed) // 3
    whole, top, bottom = map(_share, (fixed, fixed[:third], fixed[-third:]))
    return whole > _MAX_AREA or top > _MAX_TOP or min(top, bottom) > _MAX_OPPOSITE


def _share(places: Bools) -> float:
    return float(np.count_nonzero(places)) / places.size


def _of_half_size(used: Bytes) -> Bools:
    """(H / 2, W / 2) where a mask (H, W) hides nothing."""
    height, width = used.shape
    half = cv2.resize(used, (width // 2, height // 2), interpolation=cv2.INTER_NEAREST)
    return np.asarray(half > 0)


def _textured(gradients: Gradients) -> Bools:
    """(H, W) where there is texture, without the margin."""
    energy = gradients.energy
    noise = float(percentiles(energy[::8, ::8], (_FLATTEST_PERCENT,))[0])
    textured = energy > max(_MIN_TEXTURE, _MIN_TEXTURE_TO_NOISE * noise)
    textured[:_MARGIN_PX] = textured[-_MARGIN_PX:] = False
    textured[:, :_MARGIN_PX] = textured[:, -_MARGIN_PX:] = False
    return np.asarray(textured)
