"""Compiled alignment of patches, with rows of pixels padded to what vector registers hold.

A padded row costs no more than a shorter one. `weight` is 1 on the patch and 0 on the padding, so
that no sum sees it.
"""

from __future__ import annotations

import numpy as np

from vo.compiling.function import NO_REFCOUNT, compiled
from vo.geometry.projection import MIN_DEPTH, by_cam_from_world, pixel, to_camera

_LANES = 16
# A patch with so small a correlation after so many steps is given up: of 27,000 in a street and a
# hall 15 would have been found after all, and a sixth of all steps is saved.
_HOPELESS_AFTER, _HOPELESS_SCORE = 3, 0.5
# Squared last step in pixels that ends a search, and that is near enough when there are no more
# steps. Taking what settles slowly raised mono's ATE on kitti07 by 8 % and lowered it on others
# (docs/accuracy.md).
_SETTLED, _NEARLY = 4e-6, 1e-4


@compiled
def align(  # type: ignore[no-untyped-def]
    references, reference, reference_xy, inverses, targets, target, start_xy, half, iterations
):
    """See `patch_alignment.align_between`; `inverses` may be empty, then nothing is stretched."""
    count, side = len(reference_xy), 2 * half + 1
    stride = _LANES if side + 2 <= _LANES else 2 * _LANES
    work = _workspace(half, stride)
    pixels = np.empty((3, (2 * half + 3) * stride), dtype=np.int32)
    xy = start_xy.copy()
    score = np.full(count, -1.0)
    converged, nearly = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    sigma = np.full(count, np.inf)
    patches = references, reference, reference_xy, inverses
    looked_in = targets, target, start_xy
    found = xy, score, converged, nearly, sigma
    _align_each(patches, looked_in, half, iterations, stride, work, pixels, found)
    return found


@compiled(**NO_REFCOUNT)
def _align_each(patches, looked_in, half, iterations, stride, work, pixels, found):  # type: ignore[no-untyped-def]
    """Fill what was found; buffers are a workspace and whole numbers for a stretched patch."""
    references, reference, reference_xy, inverses = patches
    targets, target, start_xy = looked_in
    xy, score, converged, nearly, sigma = found
    count, side = len(reference_xy), 2 * half + 1
    for n in range(count):
        image = references[reference[n]]
        x, y = reference_xy[n, 0], reference_xy[n, 1]
        if len(inverses) == 0:
            inside = _cut(image, x, y, half, stride, work)
        else:
            inside = _cut_stretched(image, x, y, inverses[n], half, stride, work, pixels)
        if not inside:
            continue
        sums = _template(side, stride, work)
        hxx, hxy, hyy, variance = sums[1:5]
        determinant = hxx * hyy - hxy * hxy
        flat = determinant < np.float32(1e-3) * (hxx + hyy) * (hxx + hyy)
        if flat or variance < np.float32(4.0 * side * side):
            continue  # an edge or a blank wall: the position along it is not determined
        image = targets[target[n]]
        x, y = start_xy[n, 0], start_xy[n, 1]
        x, y, score[n], length = _search(image, x, y, half, stride, sums, iterations, work)
        converged[n], nearly[n] = length < _SETTLED, length < _NEARLY
        xy[n, 0], xy[n, 1] = x, y
        left_over = 2.0 * variance * max(1.0 - score[n], 0.0) / (side * side)
        sigma[n] = np.sqrt(left_over * 0.5 * (hxx + hyy) / determinant)


@compiled
def _workspace(half, stride):  # type: ignore[no-untyped-def]
    """Padded patches (8, size): wide, template, gx, gy, rows, weight, across, down."""
    size = (2 * half + 5) * stride
    work = np.zeros((8, size), dtype=np.float32)
    for k in range(size):
        i, j = k // stride, k % stride
        if i <= 2 * half and j <= 2 * half:
            work[5, k] = 1.0
        # Columns of the padding stay at the patch's edge, and with it inside of the image.
        work[6, k] = min(j, 2 * half + 2) - half - 1
        work[7, k] = i - half - 1
    return work


@compiled(**NO_REFCOUNT)
def _cut(image, x, y, half, stride, work):  # type: ignore[no-untyped-def]
    """The patch, one pixel wider on each side; False if that is outside of the image."""
    height, width = image.shape
    flat = image.reshape(-1)
    left, top, side = x - half - 1, y - half - 1, 2 * half + 3
    if not (left >= 0 and left + side < width and top >= 0 and top + side < height):
        return False
    at = int(top) * width + int(left)
    if at + side * width + stride >= len(flat):
        return False
    ax, ay = np.float32(left - int(left)), np.float32(top - int(top))
    _blend_rows(flat, width, at, ax, np.float32(0), side + 1, stride, work)
    _blend_columns(side * stride, stride, ay, work)
    return True


@compiled(**NO_REFCOUNT)
def _cut_stretched(image, x, y, inverse, half, stride, work, pixels):  # type: ignore[no-untyped-def]
    """The same for the patch as it looks after the stretch."""
    height, width = image.shape
    reach, left, top = half + 1, np.inf, np.inf
    for sy in (-reach, reach):
        for sx in (-reach, reach):
            px = x + inverse[0, 0] * sx + inverse[0, 1] * sy
            py = y + inverse[1, 0] * sx + inverse[1, 1] * sy
            if not (0 <= px < width - 1.0001 and 0 <= py < height - 1.0001):
                return False
            left, top = min(left, px), min(top, py)
    at = int(top) * width + int(left)
    x, y, size = x - int(left), y - int(top), (2 * half + 3) * stride
    # Rounding must not lead beyond the last pixel where a patch is stretched over much of an image.
    farthest = width - 2 - int(left), height - 2 - int(top)
    _stretch(image.reshape(-1)[at:], width, x, y, inverse, farthest, size, work, pixels)
    return True


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _blend_rows(flat, width, at, ax, shift, count, stride, work):  # type: ignore[no-untyped-def]
    """Blend an even number of rows of pixels with their right neighbours, less `shift`.

    Two rows at a time: then LLVM handles 16 numbers at a time, which is the length of a row. One
    row at a time it would handle 32, and most rows would not be done in vector instructions.
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
    wide, rows = work[0], work[4]
    for k in range(np.uintp(size)):
        wide[k] = rows[k] + ay * (rows[k + np.uintp(stride)] - rows[k])


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _stretch(flat, width, x, y, inverse, farthest, size, work, pixels):  # type: ignore[no-untyped-def]
    """Fill the wide patch from pixels that lie askew; three loops, so that two are vectors.

    The centre (x, y) is told from the top left corner of what is needed, so that single precision
    holds places to 1e-5 px and none is negative but for rounding, which becomes 0.
    """
    wide, share_x, share_y, across, down = work[0], work[2], work[3], work[6], work[7]
    place, above, below = pixels[0], pixels[1], pixels[2]
    count, row, one = np.uintp(size), np.int32(width), np.uintp(1)
    x, y = np.float32(x), np.float32(y)
    right, bottom = np.int32(farthest[0]), np.int32(farthest[1])
    xx, xy = np.float32(inverse[0, 0]), np.float32(inverse[0, 1])
    yx, yy = np.float32(inverse[1, 0]), np.float32(inverse[1, 1])
    for k in range(count):
        px = x + xx * across[k] + xy * down[k]
        py = y + yx * across[k] + yy * down[k]
        x0, y0 = min(np.int32(px), right), min(np.int32(py), bottom)
        share_x[k], share_y[k] = px - np.float32(x0), py - np.float32(y0)
        place[k] = y0 * row + x0
    for k in range(count):
        at = np.uintp(place[k])
        above[k] = np.int32(flat[at]) | np.int32(np.int32(flat[at + one]) << np.int32(8))
        at += np.uintp(width)
        below[k] = np.int32(flat[at]) | np.int32(np.int32(flat[at + one]) << np.int32(8))
    for k in range(count):
        a, b = np.float32(above[k] & 255), np.float32(above[k] >> 8)
        c, d = np.float32(below[k] & 255), np.float32(below[k] >> 8)
        top, low = a + share_x[k] * (b - a), c + share_x[k] * (d - c)
        wide[k] = top + share_y[k] * (low - top)


@compiled(fastmath={"reassoc", "contract"}, **NO_REFCOUNT)
def _template(side, stride, work):  # type: ignore[no-untyped-def]
    """Template and gradients of the wide patch, their means taken off; their sums of products."""
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
    # Sums of single precision: they fill the vector registers twice as well.
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
    """Gauss-Newton steps from (x, y): where they end, correlation there, squared last step."""
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
        # Grey levels less the mean of the step before: small numbers lose no digits in squares.
        _blend_rows(flat, width, at, ax, mean, side + 1, stride, work)
        total, squares, cross, cx, cy = _compare(side * stride, stride, ay, work, work[1:4])
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
        if length < _SETTLED:
            break
        if step + 1 >= _HOPELESS_AFTER and score < _HOPELESS_SCORE:
            return x, y, score, np.inf
    return x, y, score, length


@compiled(fastmath={"reassoc", "contract"}, **NO_REFCOUNT)
def _compare(size, stride, ay, work, patch):  # type: ignore[no-untyped-def]
    """Sum and squares of the patch in the target, and its products with template and gradients.

    These are the rows of `patch` (3, size or more).
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


@compiled
def cut_all(image, xy, half):  # type: ignore[no-untyped-def]
    """Templates with their gradients (N, 3, size), and sums (N, 7), all 0 where there is none."""
    side = 2 * half + 1
    stride = _LANES if side + 2 <= _LANES else 2 * _LANES
    work, size = _workspace(half, stride), side * stride
    templates = np.empty((len(xy), 3, size), dtype=np.float32)
    sums = np.zeros((len(xy), 7), dtype=np.float32)
    for n in range(len(xy)):
        if _cut(image, xy[n, 0], xy[n, 1], half, stride, work):
            found = _template(side, stride, work)
            if found[4] >= np.float32(4.0 * side * side):  # else a blank wall
                for k in range(7):
                    sums[n, k] = found[k]
                for m in range(3):
                    for k in range(size):
                        templates[n, m, k] = work[1 + m, k]
    return templates, sums


@compiled
def step_together(  # type: ignore[no-untyped-def]
    templates, sums, image, points, pixel_from_ideal, intrinsics, t, half, noise
):
    """Normal equations of one step of the camera that all patches take part in.

    Returns H (6, 6), b (6,), what H is of a step of one pixel of every patch, and scores (N,).
    """
    side = 2 * half + 1
    stride = _LANES if side + 2 <= _LANES else 2 * _LANES
    work, area = _workspace(half, stride), np.float32(side * side)
    flat = image.reshape(-1)
    h, b, per_pixel, j = np.zeros((6, 6)), np.zeros(6), 1e-12, np.empty((2, 6))
    score = np.full(len(points), -1.0)
    for n in range(len(points)):
        p, a = points[n], pixel_from_ideal[n]
        x, y, z = to_camera(t, p[0], p[1], p[2])
        if sums[n, 4] == 0.0 or z < MIN_DEPTH:
            continue
        iz = 1.0 / z
        x, y = x * iz, y * iz
        u, v = pixel(intrinsics, x, y, 1.0)
        left = a[0, 0] * u + a[0, 1] * v + a[0, 2] - half
        top = a[1, 0] * u + a[1, 1] * v + a[1, 2] - half
        height, width = image.shape
        if not (left >= 0 and left + side < width - 1 and top >= 0 and top + side < height - 1):
            continue
        at = int(top) * width + int(left)
        if at + side * width + stride >= len(flat):
            continue
        mean, hxx, hxy, hyy, variance, bx, by = sums[n]
        ax, ay = np.float32(left - int(left)), np.float32(top - int(top))
        _blend_rows(flat, width, at, ax, mean, side + 1, stride, work)
        total, squares, cross, gx, gy = _compare(side * stride, stride, ay, work, templates[n])
        variance_now = max(squares - total * total / area, np.float32(1e-6))
        gain = np.sqrt(variance / variance_now)
        ex, ey = gx * gain - bx, gy * gain - by
        score[n] = cross / np.sqrt(variance * variance_now)
        # Cauchy: what is left of the patch, per pixel, against the noise.
        weight = 1.0 / (noise * noise + 2.0 * variance * (1.0 - score[n]) / area)
        by_u, by_v = by_cam_from_world(intrinsics.fx, intrinsics.fy, x, y, iz)
        for m in range(6):
            j[0, m] = a[0, 0] * by_u[m] + a[0, 1] * by_v[m]
            j[1, m] = a[1, 0] * by_u[m] + a[1, 1] * by_v[m]
        for m in range(6):
            gu = weight * (j[0, m] * hxx + j[1, m] * hxy)
            gv = weight * (j[0, m] * hxy + j[1, m] * hyy)
            b[m] -= weight * (j[0, m] * ex + j[1, m] * ey)
            for k in range(6):
                h[m, k] += gu * j[0, k] + gv * j[1, k]
        per_pixel += weight * 0.5 * (hxx + hyy)
    return h, b, per_pixel, score
