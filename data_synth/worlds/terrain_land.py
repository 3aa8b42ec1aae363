"""Heights of the ground, and the texture of its fields, tracks and road."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from data_synth.scene.builder import Rng
from data_synth.worlds.textures import clipped, noise
from vo.base.types import Bytes, Floats, Floats32, Ints

SIDE_M, CELL_M = 400.0, 1.25
RIM_M = -3.0  # height of the ground at its border, and beyond
TEXTURE_SIDE, TEXELS_PER_M = 4096, 16.0  # it repeats after 256 m, more than a view covers
ROAD_M = 5.6

_DRAFT = 512  # side of the draft that holds the fields
_BAND = 1024
_FIELDS = 46
_RISE_M = 5.5  # standard deviation of the heights


@dataclass(frozen=True, eq=False)
class Line:
    """A road or track: a route (K, 2) in metres, and how wide it is."""

    route: Floats
    width_m: float
    paved: bool
    closed: bool


def roll_hills(rng: Rng, lines: tuple[Line, ...], sites: Floats) -> Floats32:
    """Heights (R, C) of the whole ground, from its corner (-SIDE_M / 2, -SIDE_M / 2).

    `lines`: roads and tracks, where bumps are levelled. `sites`: (N, 2) flat sites of houses.
    """
    count = round(SIDE_M / CELL_M) + 1
    raw = _RISE_M * noise(rng, (512, 512), 2.0)[:count, :count]
    calm = np.clip(0.65 + 0.4 * noise(rng, (512, 512), 2.2)[:count, :count], 0.2, 1.0)
    heights = np.asarray(raw * calm, dtype=np.float32)
    near = np.full((count, count), 255, np.uint8)
    for line in lines:
        points = _cells(line.route)
        cv2.polylines(near, [points], line.closed, 0, 1)
    away = CELL_M * cv2.distanceTransform(near, cv2.DIST_L2, 5)
    level = _fading(away, 4.0, 16.0)
    heights = level * cv2.GaussianBlur(heights, (0, 0), 10.0) + (1.0 - level) * heights
    axis = np.arange(count) * CELL_M - SIDE_M / 2
    for x, y in sites:
        weight = _fading(np.hypot(axis[None, :] - x, axis[:, None] - y), 11.0, 22.0)
        here = heights[round((y + SIDE_M / 2) / CELL_M), round((x + SIDE_M / 2) / CELL_M)]
        heights = weight * here + (1.0 - weight) * heights
    out = np.maximum(np.abs(axis)[None, :], np.abs(axis)[:, None])
    inside = _fading(out, 130.0, 195.0)
    return np.asarray(inside * heights + (1.0 - inside) * RIM_M, dtype=np.float32)


def paint_land(rng: Rng, lines: tuple[Line, ...]) -> Floats32:
    """The ground from above, to be laid on with TEXELS_PER_M."""
    image = np.empty((TEXTURE_SIDE, TEXTURE_SIDE), np.float32)
    labels, border = _fields(rng)
    kinds = rng.permutation(_FIELDS) % 4
    tiles = [_tile(rng, kind) for kind in range(4)]
    shades = rng.normal(0, 0.035, _FIELDS).astype(np.float32)
    angles, lengths = rng.uniform(0, np.pi, _FIELDS), rng.uniform(0.6, 1.8, _FIELDS)
    waves = 2 * np.pi / TEXELS_PER_M / lengths * np.array([np.cos(angles), np.sin(angles)])
    depths = np.where(kinds == 1, 0.05, np.where(kinds == 2, 0.04, 0.01))
    broad = 0.055 * noise(rng, (_DRAFT, _DRAFT), 1.2)
    warp = 1.1 * noise(rng, (1024, 1024), 1.2)
    u = np.arange(TEXTURE_SIDE, dtype=np.float32)[None, :]
    for top in range(0, TEXTURE_SIDE, _BAND):
        v = np.arange(top, top + _BAND, dtype=np.float32)[:, None]
        shift = np.tile(warp, (1, TEXTURE_SIDE // 1024))
        row = ((v / 8 + 0.4 * shift).astype(np.int64)) % _DRAFT
        column = ((u / 8 + 0.4 * np.roll(shift, 300, axis=1)).astype(np.int64)) % _DRAFT
        field = labels[row, column]
        band = np.choose(kinds[field], [np.tile(t, (1, TEXTURE_SIDE // 1024)) for t in tiles])
        band += shades[field] + _stretched(broad, top)
        furrows = np.sin(waves[0][field] * u + waves[1][field] * v + 0.3 * shift)
        band += depths[field] * furrows * (1.0 + 3.0 * (furrows < -0.8))
        band[border[row, column]] -= 0.07
        image[top : top + _BAND] = band
    _draw_lines(rng, image, lines)
    _draw_litter(rng, image)
    # The middle of the picture is the middle of the world, where the texture has its corner.
    return clipped(np.roll(image, (TEXTURE_SIDE // 2,) * 2, axis=(0, 1)))


def _fading(distance: Floats, full_m: float, none_m: float) -> Floats:
    weight = np.clip((none_m - distance) / (none_m - full_m), 0.0, 1.0)
    return np.asarray(weight * weight * (3.0 - 2.0 * weight))


def _cells(route: Floats) -> Ints:
    return np.round((route + SIDE_M / 2) / CELL_M).astype(np.int32)


def _texels(route: Floats) -> Ints:
    flipped = np.column_stack([route[:, 0], -route[:, 1]])
    return np.round(flipped * TEXELS_PER_M + TEXTURE_SIDE / 2).astype(np.int32)


def _fields(rng: Rng) -> tuple[Ints, Bytes]:
    """Number of the field at each point (_DRAFT, _DRAFT), and whether it is on a border."""
    seeds = rng.uniform(0, _DRAFT, (_FIELDS, 2))
    axis = np.arange(_DRAFT) + 0.5
    nearest = np.full((2, _DRAFT, _DRAFT), np.inf)
    labels = np.zeros((_DRAFT, _DRAFT), np.int64)
    for k, (x, y) in enumerate(seeds):
        dx, dy = np.abs(axis - x), np.abs(axis - y)
        dx, dy = np.minimum(dx, _DRAFT - dx), np.minimum(dy, _DRAFT - dy)
        # A distance along the axes gives long straight borders.
        distance = np.maximum(dx[None, :], dy[:, None]) + 0.4 * np.minimum(dx[None, :], dy[:, None])
        closer = distance < nearest[0]
        nearest[1] = np.where(closer, nearest[0], np.minimum(nearest[1], distance))
        nearest[0] = np.where(closer, distance, nearest[0])
        labels[closer] = k
    return labels, nearest[1] - nearest[0] < 1.6


def _tile(rng: Rng, kind: int) -> Floats32:
    """Meadow, ploughed soil, stubble or scrub, without distinctive features."""
    shape = (1024, 1024)
    shade, coarse, fine = (
        (0.38, 0.05, 0.03),
        (0.34, 0.035, 0.032),
        (0.52, 0.03, 0.026),
        (0.3, 0.075, 0.034),
    )[kind]
    image = shade + coarse * noise(rng, shape, 1.15) + fine * noise(rng, shape, 0.4)
    return np.asarray(image, dtype=np.float32)


def _stretched(draft: Floats32, top: int) -> Floats32:
    """A band of a draft at full resolution, interpolated."""
    scale = TEXTURE_SIDE // _DRAFT
    first = top // scale
    rows = np.take(draft, range(first - 1, first + _BAND // scale + 1), axis=0, mode="wrap")
    whole = cv2.resize(rows, (TEXTURE_SIDE, len(rows) * scale), interpolation=cv2.INTER_CUBIC)
    return np.asarray(whole[scale:-scale], dtype=np.float32)


def _draw_lines(rng: Rng, image: Floats32, lines: tuple[Line, ...]) -> None:
    gravel = 0.04 * noise(rng, (1024, 1024), 0.5) + 0.03 * noise(rng, (1024, 1024), 1.2)
    gravel = np.tile(gravel, (TEXTURE_SIDE // 1024,) * 2)
    for line in lines:
        points, wide = [_texels(line.route)], round(line.width_m * TEXELS_PER_M)
        drawn = np.zeros(image.shape, np.uint8)
        cv2.polylines(drawn, points, line.closed, 90, wide + round(1.6 * TEXELS_PER_M), cv2.LINE_AA)
        cv2.polylines(drawn, points, line.closed, 255, wide, cv2.LINE_AA)
        top, bottom = (int(k) for k in np.flatnonzero(drawn.any(axis=1))[[0, -1]])
        part, weight = image[top : bottom + 1], drawn[top : bottom + 1] / np.float32(255)
        ground_shade = (0.36 if line.paved else 0.56) + gravel[top : bottom + 1]
        part += weight * (ground_shade - part)
        if line.paved:
            _draw_marks(image, line)
        else:
            _draw_ruts(image, line)


def _draw_ruts(image: Floats32, line: Line) -> None:
    """Grass between the ruts of a track."""
    middle = np.zeros(image.shape, np.uint8)
    wide = round(0.28 * line.width_m * TEXELS_PER_M)
    cv2.polylines(middle, [_texels(line.route)], line.closed, 255, wide, cv2.LINE_AA)
    image -= middle * np.float32(0.16 / 255)


def _draw_marks(image: Floats32, line: Line) -> None:
    """Dashes in the middle of a road, and lines along its edges."""
    ends = np.roll(line.route, -1, axis=0)
    ahead = (ends - line.route) / np.linalg.norm(ends - line.route, axis=1, keepdims=True)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    for side in (-1.0, 1.0):
        edge = line.route + side * (0.5 * line.width_m - 0.25) * left
        cv2.polylines(image, [_texels(edge)], line.closed, 0.72, 2, cv2.LINE_AA)
    for k in range(0, len(line.route) - 2, 4):
        cv2.polylines(image, [_texels(line.route[k : k + 3])], False, 0.72, 2, cv2.LINE_AA)


def _draw_litter(rng: Rng, image: Floats32) -> None:
    """Tussocks, weeds, bare spots and small stones."""
    stamps = [_tussock(rng, side) for side in (8, 8, 16, 16, 16, 32, 32, 64)]
    for _ in range(9000):
        stamp = stamps[int(rng.integers(len(stamps)))]
        stamp = np.rot90(stamp, int(rng.integers(4)))
        top, left = (int(k) for k in rng.integers(0, TEXTURE_SIDE - len(stamp), 2))
        image[top : top + len(stamp), left : left + len(stamp)] += rng.normal(0, 0.1) * stamp
    places = rng.integers(0, TEXTURE_SIDE - 2, (2, 40_000))
    shades = np.float32(0.02) + 0.12 * rng.standard_normal(places.shape[1], dtype=np.float32)
    for v, u in ((0, 0), (0, 1), (1, 0), (1, 1)):
        image[places[0] + v, places[1] + u] += np.multiply(shades, 1.0 - 0.3 * (v + u))


def _tussock(rng: Rng, side: int) -> Floats32:
    """A ragged spot that fades out towards its border; about 1 in its middle."""
    axis = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    round_off = np.clip(1.1 - np.hypot(axis[None, :], axis[:, None]), 0.0, 1.0)
    ragged = 1.2 * round_off + 0.45 * noise(rng, (side, side), 0.6)
    return np.asarray(
        np.where(round_off > 0, np.clip(ragged, -0.2, 1.3) * round_off, 0.0), np.float32
    )
