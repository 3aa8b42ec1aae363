"""What happens before the lens, in it, and between the cameras, as changes of a clip."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from robustness_clips import Clip, Fault, Image
from robustness_faults import _grey, _noisy


def water_drop(begin: int, radius: int) -> Fault:
    """A drop on the lens from a frame on: it shows the image small, upside down and blurred."""

    def fault(clip: Clip) -> Clip:
        height, width = clip.size
        y, x = np.mgrid[:height, :width].astype(np.float32)
        left, top = 0.36 * width, 0.42 * height
        far = np.hypot(x - left, y - top)
        alpha = np.clip((radius - far) / 6.0, 0.0, 1.0)
        u = (width / 2 - 2.2 * (x - left)).astype(np.float32)
        v = (height / 2 - 2.2 * (y - top)).astype(np.float32)

        def put(image: Image, camera: int, index: int) -> Image:
            if index < begin or camera:
                return image
            soft = cv2.GaussianBlur(image, (0, 0), 3.0)
            small = cv2.remap(soft, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
            return _grey(image * (1.0 - alpha) + small * alpha)

        return clip.mapped(put)

    return fault


def wiper(clip: Clip) -> Clip:
    """A windscreen wiper that passes the images every 1.5 s."""
    height, width = clip.size

    def put(image: Image, camera: int, index: int) -> Image:
        angle = np.deg2rad(90.0 + 80.0 * np.cos(2.0 * np.pi * index / 30.0))
        foot = np.array([0.5 * width - 60.0 * camera, 1.2 * height])
        tip = foot + 1.3 * height * np.array([np.cos(angle), -np.sin(angle)])
        result = image.copy()
        ends = [tuple(int(v) for v in p) for p in (foot, tip)]
        cv2.line(result, *ends, 12, 46, cv2.LINE_AA)
        return np.asarray(cv2.line(result, *ends, 60, 8, cv2.LINE_AA))

    return clip.mapped(put)


def led_light(depth: float) -> Fault:
    """LED lamps that flicker: each image of each camera has a brightness of its own."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(31)
        return clip.mapped(lambda x, c, i: _noisy(x * (1.0 - depth * rng.random()), 1.5, rng))

    return fault


def lost_rows(rows: int) -> Fault:
    """Rows that the cable lost in every third image: those below move up."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(32)

        def lose(image: Image, camera: int, index: int) -> Image:
            if index % 3:
                return image
            top = int(rng.integers(20, len(image) - rows - 20))
            return np.vstack([image[:top], image[top + rows :], image[-1:].repeat(rows, axis=0)])

        return clip.mapped(lose)

    return fault


def flare(clip: Clip) -> Clip:
    """Ghosts of a lamp in the lens, that move against it while the camera turns."""
    height, width = clip.size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    rotations = clip.truth[:, :3, :3]

    def shine(image: Image, camera: int, index: int) -> Image:
        lamp = rotations[index].T @ (rotations[len(clip) // 2] @ np.array([0.3, -0.2, 1.0]))
        u, v = clip.rig.cam0.fx * lamp[:2] / max(lamp[2], 0.2)
        total = image.astype(np.float32)
        for ratio, radius, light in (
            (1.0, 40, 160),
            (-0.4, 22, 70),
            (-0.8, 60, 45),
            (-1.3, 14, 90),
        ):
            far = np.hypot(x - width / 2 - ratio * u, y - height / 2 - ratio * v)
            total += light * np.clip((radius - far) / 4.0, 0.0, 1.0)
        return _grey(total)

    return clip.mapped(shine)


def mirror_wall(opacity: float) -> Fault:
    """A glass wall over the right half, that reflects the left one."""

    def fault(clip: Clip) -> Clip:
        half = clip.size[1] // 2

        def reflect(image: Image, camera: int, index: int) -> Image:
            result = image.astype(np.float32)
            part = image[:, :half][:, ::-1]
            result[:, -half:] = (1.0 - opacity) * result[:, -half:] + opacity * part
            return _grey(result)

        return clip.mapped(reflect)

    return fault


def jitter(sigma_ms: float) -> Fault:
    """Stamps of a busy computer: late by chance, the same for a pair."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(33)
        late = np.abs(rng.normal(0.0, sigma_ms * 1e6, len(clip))).astype(np.int64)
        stamps = np.maximum.accumulate(clip.stamps_ns[0] + late) + np.arange(len(clip))
        return replace(clip, stamps_ns=(stamps,) * len(clip.images))

    return fault


def half_a_frame_apart(clip: Clip) -> Clip:
    """A pair without synchronisation at half the rate: the right image is half a period late."""
    left, right = clip.images[0][:-1:2], clip.images[1][1::2]
    stamps = (clip.stamps_ns[0][:-1:2],) * 2
    return replace(clip, images=(left, right), stamps_ns=stamps, truth=clip.truth[:-1:2])


def long_exposure(clip: Clip) -> Clip:
    """Each image is the mean of three: motion blur of a long exposure."""

    def mean(image: Image, camera: int, index: int) -> Image:
        around = clip.images[camera][max(index - 1, 0) : index + 2]
        return _grey(np.mean([each for each in around if each is not None], axis=0))

    return clip.mapped(mean)


def head_lamp(clip: Clip) -> Clip:
    """Night with a lamp on the head: a cone of light that the camera carries along."""
    height, width = clip.size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    far = np.hypot(x - 0.5 * width, y - 0.55 * height) / width
    cone = 0.04 + 0.9 * np.exp(-((far / 0.22) ** 2))
    rng = np.random.default_rng(34)
    return clip.mapped(lambda image, c, i: _noisy(image * cone + 2.0, 2.0, rng))


def rain(streaks: int) -> Fault:
    """Streaks that fall through the images."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(35)
        height, width = clip.size

        def fall(image: Image, camera: int, index: int) -> Image:
            layer = np.zeros_like(image)
            for _ in range(streaks):
                u, v, long = (int(n) for n in rng.integers((0, 0, 15), (width, height, 60)))
                cv2.line(layer, (u, v), (u + long // 8, v + long), int(rng.integers(30, 110)), 1)
            return np.asarray(cv2.add(image, cv2.GaussianBlur(layer, (0, 0), 0.7)))

        return clip.mapped(fall)

    return fault


def jpeg(quality: int) -> Fault:
    """Strong compression."""

    def squeeze(image: Image, camera: int, index: int) -> Image:
        _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality))
        return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)

    return lambda clip: clip.mapped(squeeze)


def own_shadow(clip: Clip) -> Clip:
    """The robot's shadow, always at one place of the image, over the floor of the scene."""
    height, width = clip.size
    mask = np.zeros((height, width), np.float32)
    hull = np.array([(0.3, 1.0), (0.38, 0.5), (0.62, 0.45), (0.72, 1.0)]) * (width, height)
    cv2.fillPoly(mask, [hull.astype(np.int32)], 1.0)
    gain = 1.0 - 0.65 * cv2.GaussianBlur(mask, (0, 0), 1.5)
    return clip.mapped(lambda image, camera, index: _grey(image * gain))


def window_of_a_train(clip: Clip) -> Clip:
    """Inside of a train: its walls round a window through which the scene is seen."""
    rng = np.random.default_rng(36)
    height, width = clip.size
    coarse = rng.normal(0.0, 1.0, (height // 6 + 2, width // 6 + 2))
    wall = 110.0 + 40.0 * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    hole = np.zeros((height, width))
    hole[int(0.2 * height) : int(0.75 * height), int(0.2 * width) : int(0.8 * width)] = 1.0

    def frame(image: Image, camera: int, index: int) -> Image:
        seen = np.roll(wall, -20 * camera, axis=1)
        return _noisy(image * hole + seen * (1.0 - hole), 1.5, rng)

    return clip.mapped(frame)
