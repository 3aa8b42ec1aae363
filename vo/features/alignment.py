"""Sub-pixel refinement: a patch of a reference image, warped as it should look now, is aligned.

An ORB corner is known to about a pixel of its pyramid level; the alignment brings that to a tenth
of a full-resolution pixel, which is what geometry needs.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.features import patch_kernels
from vo.types import Bools, Bytes, Floats, Ints

_MAX_HALF = 10


class Alignment(NamedTuple):
    """Where patches were found.

    Attributes:
        xy: (N, 2) float64 pixels in the target image.
        score: (N,) zero-mean normalised cross-correlation there, -1 where it failed.
        converged: (N,) whether the search settled inside the image.
    """

    xy: Floats
    score: Floats
    converged: Bools


def align_patches(
    references: Bytes,
    reference: Ints,
    reference_xy: Floats,
    target_from_reference: Floats,
    target: Bytes,
    start_xy: Floats,
    *,
    half_px: int = 5,
    iterations: int = 12,
) -> Alignment:
    """Find the position in `target` of patches around `reference_xy`, to sub-pixel.

    Args:
        references: (M, H, W) uint8 stack of reference images.
        reference: (N,) which of them each patch comes from.
        reference_xy: (N, 2) pixel at the patch's centre.
        target_from_reference: (N, 2, 2) how the patch is stretched on its way to the target.
        target: (H, W) uint8.
        start_xy: (N, 2) where to begin in the target.
        half_px: the patch has 2 * half_px + 1 pixels a side.
        iterations: most steps of the search.

    Source: Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 2004 (inverse compositional),
        on patches of equal mean and contrast, so that a change of exposure does not move them.
    """
    if len(reference_xy) == 0:
        return Alignment(np.empty((0, 2)), np.empty(0), np.zeros(0, dtype=bool))
    if half_px > _MAX_HALF:
        raise ValueError(f"half_px is {half_px}, at most {_MAX_HALF}")
    xy, score, converged = _align(
        references,
        np.ascontiguousarray(reference, dtype=np.int64),
        np.ascontiguousarray(reference_xy, dtype=np.float64),
        np.linalg.inv(target_from_reference),
        np.ascontiguousarray(target),
        np.ascontiguousarray(start_xy, dtype=np.float64),
        half_px,
        iterations,
    )
    return Alignment(xy, score, converged)


def align_between(
    references: Bytes,
    reference: Ints,
    reference_xy: Floats,
    reference_from_target: Floats | None,
    targets: Bytes,
    target: Ints,
    start_xy: Floats,
    *,
    half_px: int,
    iterations: int = 12,
) -> Alignment:
    """Find patches of several images in several others at once; otherwise as `align_patches`.

    Args:
        references: (M, H, W) uint8 stack of reference images.
        reference: (N,) which of them each patch comes from.
        reference_xy: (N, 2) pixel at the patch's centre.
        reference_from_target: (N, 2, 2) the inverse of how the patch is stretched on its way to
            the target; None if no patch is.
        targets: (T, H, W) uint8 stack of the images to look in.
        target: (N,) which of them each patch is looked for in.
        start_xy: (N, 2) where to begin in the target.
        half_px: the patch has 2 * half_px + 1 pixels a side.
        iterations: most steps of the search.
    """
    if half_px > _MAX_HALF:
        raise ValueError(f"half_px is {half_px}, at most {_MAX_HALF}")
    stretch = np.empty((0, 2, 2)) if reference_from_target is None else reference_from_target
    xy, score, converged = patch_kernels.align(
        np.ascontiguousarray(references),
        np.ascontiguousarray(reference, dtype=np.int64),
        np.ascontiguousarray(reference_xy, dtype=np.float64),
        np.ascontiguousarray(stretch, dtype=np.float64),
        np.ascontiguousarray(targets),
        np.ascontiguousarray(target, dtype=np.int64),
        np.ascontiguousarray(start_xy, dtype=np.float64),
        half_px,
        iterations,
    )
    return Alignment(xy, score, converged)


@numba.njit(cache=True, nogil=True, inline="always")
def _sample(image, x, y):  # type: ignore[no-untyped-def]
    x0, y0 = int(x), int(y)
    ax, ay = np.float32(x - x0), np.float32(y - y0)
    top = np.float32(image[y0, x0]) * (1 - ax) + np.float32(image[y0, x0 + 1]) * ax
    low = np.float32(image[y0 + 1, x0]) * (1 - ax) + np.float32(image[y0 + 1, x0 + 1]) * ax
    return top * (1 - ay) + low * ay


@numba.njit(cache=True, nogil=True)
def _cut(image, x, y, inverse, half, patch):  # type: ignore[no-untyped-def]
    """The patch as it looks after the stretch, one pixel wider on each side; False if outside."""
    height, width = image.shape
    reach = half + 1
    for sy in (-reach, reach):
        for sx in (-reach, reach):
            px = x + inverse[0, 0] * sx + inverse[0, 1] * sy
            py = y + inverse[1, 0] * sx + inverse[1, 1] * sy
            if not (0 <= px < width - 1 and 0 <= py < height - 1):
                return False
    for i in range(2 * reach + 1):
        for j in range(2 * reach + 1):
            dx, dy = j - reach, i - reach
            px = x + inverse[0, 0] * dx + inverse[0, 1] * dy
            py = y + inverse[1, 0] * dx + inverse[1, 1] * dy
            patch[i, j] = _sample(image, px, py)
    return True


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _align(  # type: ignore[no-untyped-def]
    references, reference, reference_xy, inverses, target, start_xy, half, iterations
):
    count = len(reference_xy)
    side = 2 * half + 1
    area = side * side
    height, width = target.shape
    xy = start_xy.copy()
    score = np.full(count, -1.0)
    converged = np.zeros(count, dtype=np.bool_)
    wide = np.empty((side + 2, side + 2), dtype=np.float32)
    template = np.empty(area, dtype=np.float32)
    gx = np.empty(area, dtype=np.float32)
    gy = np.empty(area, dtype=np.float32)
    current = np.empty(area, dtype=np.float32)
    for n in range(count):
        if not _cut(
            references[reference[n]],
            reference_xy[n, 0],
            reference_xy[n, 1],
            inverses[n],
            half,
            wide,
        ):
            continue
        mean_t = np.float32(0)
        mean_gx = np.float32(0)
        mean_gy = np.float32(0)
        k = 0
        for i in range(1, side + 1):
            for j in range(1, side + 1):
                template[k] = wide[i, j]
                gx[k] = np.float32(0.5) * (wide[i, j + 1] - wide[i, j - 1])
                gy[k] = np.float32(0.5) * (wide[i + 1, j] - wide[i - 1, j])
                mean_t += template[k]
                mean_gx += gx[k]
                mean_gy += gy[k]
                k += 1
        mean_t /= area
        mean_gx /= area
        mean_gy /= area
        # Sums of single precision: they fill the vector registers twice as well.
        hxx, hxy, hyy = np.float32(1e-6), np.float32(0), np.float32(1e-6)
        var_t, bx, by = np.float32(1e-6), np.float32(0), np.float32(0)
        for k in range(area):
            template[k] -= mean_t
            gx[k] -= mean_gx
            gy[k] -= mean_gy
            hxx += gx[k] * gx[k]
            hxy += gx[k] * gy[k]
            hyy += gy[k] * gy[k]
            var_t += template[k] * template[k]
            bx += gx[k] * template[k]
            by += gy[k] * template[k]
        determinant = hxx * hyy - hxy * hxy
        if determinant < 1e-3 * (hxx + hyy) * (hxx + hyy) or var_t < 4.0 * area:
            continue  # an edge or a blank wall: the position along it is not determined
        x, y = start_xy[n, 0], start_xy[n, 1]
        inside = True
        for _ in range(iterations):
            left, top = x - half, y - half
            if not (left >= 0 and left + side < width - 1 and top >= 0 and top + side < height - 1):
                inside = False
                break
            x0, y0 = int(left), int(top)
            ax, ay = np.float32(left - x0), np.float32(top - y0)
            w00 = (1 - ax) * (1 - ay)
            w01 = ax * (1 - ay)
            w10 = (1 - ax) * ay
            w11 = ax * ay
            mean_c = np.float32(0)
            k = 0
            for i in range(side):
                upper, lower = target[y0 + i], target[y0 + i + 1]
                for j in range(side):
                    value = (
                        w00 * np.float32(upper[x0 + j])
                        + w01 * np.float32(upper[x0 + j + 1])
                        + w10 * np.float32(lower[x0 + j])
                        + w11 * np.float32(lower[x0 + j + 1])
                    )
                    current[k] = value
                    mean_c += value
                    k += 1
            mean_c /= area
            var_c, cross = np.float32(1e-6), np.float32(0)
            cx, cy = np.float32(0), np.float32(0)
            for k in range(area):
                c = current[k] - mean_c
                var_c += c * c
                cross += c * template[k]
                cx += gx[k] * c
                cy += gy[k] * c
            gain = np.sqrt(var_t / var_c)
            ex, ey = cx * gain - bx, cy * gain - by
            step_x = (hyy * ex - hxy * ey) / determinant
            step_y = (hxx * ey - hxy * ex) / determinant
            x -= step_x
            y -= step_y
            score[n] = cross / np.sqrt(var_t * var_c)
            if step_x * step_x + step_y * step_y < 1e-4:
                converged[n] = True
                break
        if not inside:
            converged[n] = False
            score[n] = -1.0
        xy[n, 0] = x
        xy[n, 1] = y
    return xy, score, converged
