"""What may cover a part of the images: the vehicle itself, text, reflections, dots, a train."""

from __future__ import annotations

import cv2
import numpy as np
from robustness_clips import Clip, Fault, Image

from vo.base.types import Floats

_MARGIN = 200  # columns of an overlay beyond the image, for its disparity
_BODY_M = 0.5  # distance of the vehicle's own body
_MAX_SHIFT_PX = _MARGIN - 20
_DOT_SIGMA_PX = 0.9
_PROJECTOR_RATIO = 0.58  # of the baseline, from the left camera, as in a D435


def own_body(share: float, textured: bool) -> Fault:
    """The vehicle's own body over the lower `share` of the images, as a bonnet or a bumper."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(11)
        height, width = clip.size
        shape = (height, width + 2 * _MARGIN)
        layer = _rough(shape, rng) if textured else _painted(shape, share, rng)
        columns = np.linspace(-1.0, 1.0, shape[1])
        edge = height * (1.0 - share * (1.1 - 0.35 * columns**2))  # higher in the middle
        alpha = np.clip(np.arange(height)[:, None] - edge[None] + 0.5, 0.0, 1.0)
        shift = min(clip.baseline_px / _BODY_M, _MAX_SHIFT_PX) if clip.rig.is_stereo else 0.0
        return _with_layer(clip, layer, alpha, shift, rng)

    return fault


def burnt_in_text(share: float) -> Fault:
    """Lines of text that a recorder writes into the images, over `share` of their height."""

    def fault(clip: Clip) -> Clip:
        height, width = clip.size
        rows = max(1, round(share * height / 22))
        tops = np.linspace(0, height - 22, rows + 2).astype(int)[1:-1] if rows > 2 else [4, 30]
        words = "CAM 1  REC  SPEED 043 KM/H  N 48.9843 E 8.3921  ALT 116 M  BAT 87 %  "

        def put(image: Image, camera: int, index: int) -> Image:
            result = image.copy()
            for row, top in enumerate(tops[:rows]):
                result[top : top + 22] //= 3
                text = (words[7 * row :] + words * 8)[: width // 7]
                text = f"{index:05d} {text}" if row == 0 else text
                at = (4, int(top) + 16)
                cv2.putText(result, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 1, cv2.LINE_AA)
            return result

        return clip.mapped(put)

    return fault


def reflection(opacity: float) -> Fault:
    """The dashboard, reflected by the windscreen: still, half transparent, over all but the top."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(12)
        height, width = clip.size
        layer = _painted((height, width + 2 * _MARGIN), 1.0, rng)
        fade = np.clip((np.arange(height) / height - 0.15) / 0.2, 0.0, 1.0)
        alpha = opacity * np.repeat(fade[:, None], layer.shape[1], axis=1)
        shift = min(clip.baseline_px / 1.2, _MAX_SHIFT_PX) if clip.rig.is_stereo else 0.0
        return _with_layer(clip, layer, alpha, shift, rng)

    return fault


def projected_dots(count: int, brightness: float = 160.0, every: int = 1) -> Fault:
    """Dots of an infrared projector between the cameras; needs true depth."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(13)
        height, width = clip.size
        u = rng.uniform(-0.1 * width, 1.1 * width, count)
        v = rng.uniform(0, height - 1, count)

        def put(image: Image, camera: int, index: int) -> Image:
            if index % every:
                return image
            x, z = _dot_columns(u, v, clip.depth[index], _PROJECTOR_RATIO * clip.baseline_px)
            shown = (x > 0) & (x < width)  # seen by the left camera
            power = brightness * np.clip((2.5 / z) ** 2, 0.02, 1.2)
            x = x - camera * clip.baseline_px / z
            return _with_dots(image, x[shown], v[shown], power[shown])

        return clip.mapped(put)

    return fault


def train(share: float, px_per_frame: float = 45.0, first: int = 5, depth_m: float = 12.0) -> Fault:
    """A train that fills `share` of the image height, passing at a constant depth.

    `px_per_frame`: its motion in the image, to the left. `first`: the frame in which it comes in
    from the right.
    """

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(14)
        height, width = clip.size
        low = round(0.95 * height)
        high = low - round(share * 0.95 * height)
        coach = _coaches((low - high, round(width + px_per_frame * len(clip) + 400)), rng)
        disparity = clip.baseline_px / depth_m if clip.rig.is_stereo else 0.0

        def put(image: Image, camera: int, index: int) -> Image:
            head = width - px_per_frame * (index - first) - camera * disparity
            if head >= width:
                return image
            result = image.copy()
            begin = max(0, int(np.ceil(head)))
            columns = np.arange(begin, width, dtype=np.float32) - np.float32(head)
            rows = np.arange(low - high, dtype=np.float32)
            part = cv2.remap(
                coach, *np.meshgrid(columns, rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
            )
            result[high:low, begin:] = _noisy(part, 1.5, rng)
            return result

        return clip.mapped(put)

    return fault


def _with_layer(
    clip: Clip, layer: Floats, alpha: Floats, shift: float, rng: np.random.Generator
) -> Clip:
    """Images under a still layer (H, W + 2 margins), shifted between the cameras."""
    width = clip.size[1]

    def put(image: Image, camera: int, index: int) -> Image:
        begin = _MARGIN + round(camera * shift)
        part, a = layer[:, begin : begin + width], alpha[:, begin : begin + width]
        noise = rng.normal(0.0, 1.5, image.shape)
        return _grey(image * (1.0 - a) + (part + noise) * a)

    return clip.mapped(put)


def _painted(shape: tuple[int, int], share: float, rng: np.random.Generator) -> Floats:
    """A smooth surface with edges, stickers and reflections."""
    height, width = shape
    layer = 100.0 + 50.0 * np.linspace(-1.0, 1.0, height)[:, None] + 25.0 * _smooth(shape, 30, rng)
    layer = _grey(layer)
    for number in range(round(140 * share * width / 1600)):
        x, y = int(rng.integers(0, width)), int(rng.integers(height * (1.0 - share), height))
        grey = float(rng.integers(15, 240))
        if number % 3 == 0:
            cv2.ellipse(layer, (x, y), (int(rng.integers(4, 30)), 5), 20.0, 0, 360, grey, -1)
        elif number % 3 == 1:
            cv2.rectangle(layer, (x, y), (x + int(rng.integers(8, 60)), y + 14), grey, -1)
            font = cv2.FONT_HERSHEY_PLAIN
            cv2.putText(layer, f"{number}", (x + 1, y + 12), font, 0.9, 255 - grey, 1)
        else:
            end = (x + int(rng.integers(-90, 90)), y + int(rng.integers(-25, 25)))
            cv2.line(layer, (x, y), end, grey, 3)
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), 0.8), dtype=np.float64)


def _rough(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """A strongly textured surface."""
    layer = 110.0 + 20.0 * _smooth(shape, 2, rng)
    layer += 45.0 * _smooth(shape, 6, rng) + 45.0 * _smooth(shape, 20, rng)
    return np.clip(layer, 5.0, 250.0)


def _coaches(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """The side of a train: windows, doors, letters, dirt."""
    height, width = shape
    side = _grey(120.0 + 20.0 * _smooth(shape, 3, rng) + 20.0 * _smooth(shape, 12, rng))
    for x in range(0, width, 90):
        top, bottom = int(0.2 * height), int(0.2 * height + 0.35 * height)
        grey = float(rng.integers(20, 80))
        cv2.rectangle(side, (x, top), (x + int(rng.integers(40, 75)), bottom), grey, -1)
        text = "".join(chr(c) for c in rng.integers(65, 91, 5))
        at, grey = (x, int(0.8 * height)), float(rng.integers(0, 256))
        cv2.putText(side, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.8, grey, 2, cv2.LINE_AA)
    return np.clip(side.astype(np.float32), 5.0, 250.0)


def _smooth(shape: tuple[int, int], scale: int, rng: np.random.Generator) -> Floats:
    """Noise of mean 0 and deviation of about 1 with structures of `scale` pixels."""
    height, width = shape
    coarse = rng.normal(0.0, 1.0, (height // scale + 2, width // scale + 2))
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))


def _dot_columns(u: Floats, v: Floats, depth: Floats, offset_px: float) -> tuple[Floats, Floats]:
    """Columns and depths at which the left camera sees dots of these projector pixels."""
    height, width = depth.shape
    rows = np.clip(np.round(v).astype(int), 0, height - 1)
    x, z = u.copy(), np.ones(len(u))
    for _ in range(12):  # the depth depends on the column and the column on the depth
        z = np.maximum(depth[rows, np.clip(np.round(x).astype(int), 0, width - 1)], 0.1)
        x = u + offset_px / z
    return x, z.astype(np.float64)


def _with_dots(image: Image, x: Floats, y: Floats, power: Floats) -> Image:
    """The image with Gaussian spots added."""
    height, width = image.shape
    total = image.astype(np.float64)
    offsets = np.arange(-2, 3)
    columns = np.round(x)[:, None, None] + offsets[None, None, :]
    rows = np.round(y)[:, None, None] + offsets[None, :, None]
    square = (columns - x[:, None, None]) ** 2 + (rows - y[:, None, None]) ** 2
    light = power[:, None, None] * np.exp(-square / (2 * _DOT_SIGMA_PX**2))
    columns, rows = np.broadcast_arrays(columns, rows)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    np.add.at(total, (rows[inside].astype(int), columns[inside].astype(int)), light[inside])
    return _grey(total)


def _noisy(image: Image, sigma: float, rng: np.random.Generator) -> Image:
    return _grey(image + rng.normal(0.0, sigma, image.shape))


def _grey(values: Floats) -> Image:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
