"""Compiled alignment of patches by inverse compositional Gauss-Newton steps.

The patch T of the reference is aligned with the target I by minimising the squared difference of
both after subtracting their means and dividing by their standard deviations. Gradients are those
of T, so the Hessian is computed once (Baker and Matthews, "Lucas-Kanade 20 Years On", 2004). With
sums over the pixels of a patch:

    hxx = sum gx gx, ...    variance = sum T T,    bx = sum gx T,    cx = sum gx I,
    ex = gain cx - bx,    gain = sqrt(variance / variance of I),    step = H^-1 (ex, ey).

Layout: buffers are (rows, size) float32; each holds a patch row by row, with rows padded to whole
vector registers, where a padded row costs no more than a shorter one. `weight` is 1 on the patch
and 0 on the padding. Pixels lie at `row * stride + column`.
"""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled

LANES = 16  # numbers of a row of a patch, or half of them
# A patch with a lower correlation after this many steps is rejected, which saves a sixth of all
# steps; of 27,000 patches in a street and a hall, 15 would have converged later.
_REJECT_AFTER, _REJECT_SCORE = 3, 0.5
# Squared last step in pixels at convergence, and the maximum for patches that have not converged
# in time to be usable. Accepting slower ones raised the mono ATE on kitti07 by 8 % and lowered it
# on others (docs/accuracy.md).
_CONVERGED, _NEARLY_CONVERGED = 4e-6, 1e-4
_MIN_PART = 0.25  # of the depth at the centre of a patch, at its sides


@compiled
def align(  # type: ignore[no-untyped-def]
    references, reference, reference_xy, inverses, targets, target, start_xy, half, iterations
):
    """See `patch_alignment.align_between`; `inverses` may be empty, then patches are not warped.

    Those of 3 rows are homographies: their offsets are divided by 1 + the third row times them.
    """
    count, side = len(reference_xy), 2 * half + 1
    stride = LANES if side + 2 <= LANES else 2 * LANES
    work = workspace(half, stride)
    pixels = np.empty((3, (2 * half + 3) * stride), dtype=np.int32)
    xy = start_xy.copy()
    score = np.full(count, -1.0)
    converged, nearly = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    sigma = np.full(count, np.inf)
    patches = references, reference, reference_xy, inverses
    search = targets, target, start_xy
    found = xy, score, converged, nearly, sigma
    _align_each(patches, search, half, iterations, stride, work, pixels, found)
    return found


@compiled(**NO_REFCOUNT)
def _align_each(patches, search, half, iterations, stride, work, pixels, found):  # type: ignore[no-untyped-def]
    """Align each patch and fill `found`; `work` and `pixels` are buffers."""
    references, reference, reference_xy, inverses = patches
    targets, target, start_xy = search
    xy, score, converged, nearly, sigma = found
    count, side = len(reference_xy), 2 * half + 1
    for n in range(count):
        image = references[reference[n]]
        x, y = reference_xy[n, 0], reference_xy[n, 1]
        if len(inverses) == 0:
            inside = cut(image, x, y, half, stride, work)
        else:
            inside = _cut_stretched(image, x, y, inverses[n], half, stride, work, pixels)
        if not inside:
            continue
        sums = make_template(side, stride, work)
        hxx, hxy, hyy, variance = sums[1:5]
        determinant = hxx * hyy - hxy * hxy
        flat = determinant < np.float32(1e-3) * (hxx + hyy) * (hxx + hyy)
        if flat or variance < np.float32(4.0 * side * side):
            continue  # edges and blank walls do not determine the position
        image = targets[target[n]]
        x, y = start_xy[n, 0], start_xy[n, 1]
        x, y, score[n], length = _search(image, x, y, half, stride, sums, iterations, work)
        converged[n], nearly[n] = length < _CONVERGED, length < _NEARLY_CONVERGED
        xy[n, 0], xy[n, 1] = x, y
        # Squared residual of the normalised patches, 2 (1 - score) variance, per pixel.
        noise = 2.0 * variance * max(1.0 - score[n], 0.0) / (side * side)
        sigma[n] = np.sqrt(noise * 0.5 * (hxx + hyy) / determinant)


@compiled
def workspace(half, stride):  # type: ignore[no-untyped-def]
    """Buffers (8, size): wide, template, gx, gy, rows, weight, across, down.

    `wide` is the patch with a margin of one pixel for gradients, `rows` rows of pixels after
    horizontal interpolation, `across` and `down` the offsets of pixels from the centre.
    """
    size = (2 * half + 5) * stride
    work = np.zeros((8, size), dtype=np.float32)
    for k in range(size):
        i, j = k // stride, k % stride
        if i <= 2 * half and j <= 2 * half:
            work[5, k] = 1.0
        # Columns of the padding repeat the edge of the patch, which is inside of the image.
        work[6, k] = min(j, 2 * half + 2) - half - 1
        work[7, k] = i - half - 1
    return work


@compiled(**NO_REFCOUNT)
def cut(image, x, y, half, stride, work):  # type: ignore[no-untyped-def]
    """Cut the wide patch by bilinear interpolation; False if it is not inside of the image."""
    height, width = image.shape
    flat = image.reshape(-1)
    left, top, side = x - half - 1, y - half - 1, 2 * half + 3
    if not (left >= 0 and left + side < width and top >= 0 and top + side < height):
        return False
    at = int(top) * width + int(left)
    if at + side * width + stride >= len(flat):
        return False
    ax, ay = np.float32(left - int(left)), np.float32(top - int(top))
    blend_rows(flat, width, at, ax, np.float32(0), side + 1, stride, work)
    _blend_columns(side * stride, stride, ay, work)
    return True


@compiled(**NO_REFCOUNT)
def _cut_stretched(image, x, y, inverse, half, stride, work, pixels):  # type: ignore[no-untyped-def]
    """The same for a warped patch; `inverse` maps its offsets to those of the image."""
    height, width = image.shape
    reach, left, top = half + 1, np.inf, np.inf
    for sy in (-reach, reach):
        for sx in (-reach, reach):
            part = 1.0
            if len(inverse) == 3:
                part = 1.0 / max(1.0 + inverse[2, 0] * sx + inverse[2, 1] * sy, _MIN_PART)
            px = x + part * (inverse[0, 0] * sx + inverse[0, 1] * sy)
            py = y + part * (inverse[1, 0] * sx + inverse[1, 1] * sy)
            if not (0 <= px < width - 1.0001 and 0 <= py < height - 1.0001):
                return False
            left, top = min(left, px), min(top, py)
    at = int(top) * width + int(left)
    x, y, size = x - int(left), y - int(top), (2 * half + 3) * stride
    # Rounding must not lead beyond the last pixel where a patch covers much of an image.
    farthest = width - 2 - int(left), height - 2 - int(top)
    _stretch(image.reshape(-1)[at:], width, x, y, inverse, farthest, size, work, pixels)
    return True


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def blend_rows(flat, width, at, ax, shift, count, stride, work):  # type: ignore[no-untyped-def]
    """Fill `rows` with an even number of rows of pixels, interpolated horizontally, less `shift`.

    Two rows per iteration: LLVM then processes 16 numbers at once, the length of a row. With one
    row it would choose 32, and most rows would not use vector instructions.
    """
    rows, one, row = work[4], np.uintp(1), np.uintp(stride)
    for i in range(0, count, 2):
        upper, to = np.uintp(at + i * width), np.uintp(i * stride)
        lower = upper + np.uintp(width)
        for j in range(row):
            a, b = np.float32(flat[upper + j]), np.float32(flat[upper + j + one])
            c, d = np.float32(flat[lower + j]), np.float32(flat[lower + j + one])
            rows[to + j] = (a - shift) + ax * (b - a)
            rows[to + row + j] = (c - shift) + ax * (d - c)


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _blend_columns(size, stride, ay, work):  # type: ignore[no-untyped-def]
    """Fill `wide` with `rows`, interpolated vertically."""
    wide, rows = work[0], work[4]
    for k in range(np.uintp(size)):
        wide[k] = rows[k] + ay * (rows[k + np.uintp(stride)] - rows[k])


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _stretch(flat, width, x, y, inverse, farthest, size, work, pixels):  # type: ignore[no-untyped-def]
    """Fill the wide patch by bilinear interpolation at warped positions.

    Three loops, of which the first and the last are vectorised. The centre (x, y) is relative to
    the top left corner of the required pixels: single precision then resolves 1e-5 px, and no
    position is negative except by rounding, which conversion to integers makes 0.
    """
    wide, part_x, part_y, across, down = work[0], work[2], work[3], work[6], work[7]
    place, above, below = pixels[0], pixels[1], pixels[2]
    count, row, one = np.uintp(size), np.int32(width), np.uintp(1)
    x, y = np.float32(x), np.float32(y)
    right, bottom = np.int32(farthest[0]), np.int32(farthest[1])
    xx, xy = np.float32(inverse[0, 0]), np.float32(inverse[0, 1])
    yx, yy = np.float32(inverse[1, 0]), np.float32(inverse[1, 1])
    if len(inverse) == 3:
        zx, zy, one_part = np.float32(inverse[2, 0]), np.float32(inverse[2, 1]), np.float32(1)
        for k in range(count):
            part = one_part / max(one_part + zx * across[k] + zy * down[k], np.float32(_MIN_PART))
            part_x[k] = x + part * (xx * across[k] + xy * down[k])
            part_y[k] = y + part * (yx * across[k] + yy * down[k])
    else:
        for k in range(count):
            part_x[k] = x + xx * across[k] + xy * down[k]
            part_y[k] = y + yx * across[k] + yy * down[k]
    for k in range(count):
        px, py = part_x[k], part_y[k]
        x0, y0 = min(np.int32(px), right), min(np.int32(py), bottom)
        part_x[k], part_y[k] = px - np.float32(x0), py - np.float32(y0)
        place[k] = y0 * row + x0
    byte, low_byte = np.int32(8), np.int32(255)
    for k in range(count):
        at = np.uintp(place[k])
        above[k] = np.int32(flat[at]) | np.int32(np.int32(flat[at + one]) << byte)
        at += np.uintp(width)
        below[k] = np.int32(flat[at]) | np.int32(np.int32(flat[at + one]) << byte)
    for k in range(count):
        a, b = np.float32(np.int32(above[k] & low_byte)), np.float32(np.int32(above[k] >> byte))
        c, d = np.float32(np.int32(below[k] & low_byte)), np.float32(np.int32(below[k] >> byte))
        top, low = a + part_x[k] * (b - a), c + part_x[k] * (d - c)
        wide[k] = top + part_y[k] * (low - top)


@compiled(fastmath={"reassoc", "contract"}, **NO_REFCOUNT)
def make_template(side, stride, work):  # type: ignore[no-untyped-def]
    """Fill template, gx and gy of the wide patch, without their means; gives the sums.

    Returns:
        Mean of the template, hxx, hxy, hyy, variance, bx, by.
    """
    wide, template, gx, gy, weight = work[0], work[1], work[2], work[3], work[5]
    size, row, one = np.uintp(side * stride), np.uintp(stride), np.uintp(1)
    mean_t, mean_gx, mean_gy = np.float32(0), np.float32(0), np.float32(0)
    for k in range(size):
        centre = k + row + one
        template[k] = wide[centre]
        gx[k] = np.float32(0.5) * (wide[centre + one] - wide[centre - one])
        gy[k] = np.float32(0.5) * (wide[centre + row] - wide[centre - row])
        mean_t += weight[k] * template[k]
        mean_gx += weight[k] * gx[k]
        mean_gy += weight[k] * gy[k]
    area = np.float32(side * side)
    mean_t, mean_gx, mean_gy = mean_t / area, mean_gx / area, mean_gy / area
    # Single precision, of which a vector register holds twice as many numbers.
    hxx, hxy, hyy = np.float32(1e-6), np.float32(0), np.float32(1e-6)
    variance, bx, by = np.float32(1e-6), np.float32(0), np.float32(0)
    for k in range(size):
        t = weight[k] * (template[k] - mean_t)
        x = weight[k] * (gx[k] - mean_gx)
        y = weight[k] * (gy[k] - mean_gy)
        template[k], gx[k], gy[k] = t, x, y
        hxx += x * x
        hxy += x * y
        hyy += y * y
        variance += t * t
        bx += x * t
        by += y * t
    return mean_t, hxx, hxy, hyy, variance, bx, by


@compiled(**NO_REFCOUNT)
def _search(image, x, y, half, stride, sums, iterations, work):  # type: ignore[no-untyped-def]
    """Gauss-Newton steps from (x, y); gives the final x, y, correlation and squared last step."""
    height, width = image.shape
    flat = image.reshape(-1)
    mean, hxx, hxy, hyy, variance, bx, by = sums
    side, score, length = 2 * half + 1, -1.0, np.inf
    area, determinant = np.float32(side * side), hxx * hyy - hxy * hxy
    for step in range(iterations):
        left, top = x - half, y - half
        if not (left >= 0 and left + side < width - 1 and top >= 0 and top + side < height - 1):
            return x, y, -1.0, np.inf
        at = int(top) * width + int(left)
        if at + side * width + stride >= len(flat):
            return x, y, -1.0, np.inf
        ax, ay = np.float32(left - int(left)), np.float32(top - int(top))
        # Grey levels less the mean of the previous step: sums of squares of large numbers would
        # lose digits in single precision.
        blend_rows(flat, width, at, ax, mean, side + 1, stride, work)
        total, squares, cross, cx, cy = compare(side * stride, stride, ay, work, work[1:4])
        change = total / area
        mean += change
        variance_now = max(squares - total * change, np.float32(1e-6))
        gain = np.sqrt(variance / variance_now)
        ex, ey = cx * gain - bx, cy * gain - by
        step_x = (hyy * ex - hxy * ey) / determinant
        step_y = (hxx * ey - hxy * ex) / determinant
        x -= step_x
        y -= step_y
        score = cross / np.sqrt(variance * variance_now)
        length = step_x * step_x + step_y * step_y
        if length < _CONVERGED:
            break
        if step + 1 >= _REJECT_AFTER and score < _REJECT_SCORE:
            return x, y, score, np.inf
    return x, y, score, length


@compiled(fastmath={"reassoc", "contract"}, **NO_REFCOUNT)
def compare(size, stride, ay, work, patch):  # type: ignore[no-untyped-def]
    """Sums of I, I I, T I, gx I and gy I; the rows of `patch` (3, size or more) are T, gx, gy.

    I is interpolated vertically on the fly, so that it is never stored.
    """
    template, gx, gy, rows, weight = patch[0], patch[1], patch[2], work[4], work[5]
    total, squares = np.float32(0), np.float32(0)
    cross, cx, cy = np.float32(0), np.float32(0), np.float32(0)
    for k in range(np.uintp(size)):
        value = rows[k] + ay * (rows[k + np.uintp(stride)] - rows[k])
        weighted = weight[k] * value
        total += weighted
        squares += weighted * value
        cross += template[k] * value
        cx += gx[k] * value
        cy += gy[k] * value
    return total, squares, cross, cx, cy
