"""Faults of cameras, drivers, calibrations and weather, as changes of a clip."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from robustness_clips import Clip, Fault, Image

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Camera, Floats, Rig


def chain(*faults: Fault) -> Fault:
    """One fault after the other."""

    def fault(clip: Clip) -> Clip:
        for one in faults:
            clip = one(clip)
        return clip

    return fault


def standing(clip: Clip) -> Clip:
    """The camera stands: the first images all the time, with fresh noise, and one true pose."""
    rng = np.random.default_rng(21)
    first = [camera[0] for camera in clip.images]
    still = clip.mapped(lambda image, camera, index: _noisy(first[camera], 1.5, rng))
    return replace(still, truth=np.repeat(clip.truth[:1], len(clip), axis=0))


def frozen(begin: int, frames: int, cameras: tuple[int, ...] = (0, 1), noise: float = 0.0) -> Fault:
    """The image of frame `begin` in the `frames` after it too, with fresh noise or without."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(22)

        def repeat(image: Image, camera: int, index: int) -> Image:
            if camera not in cameras or not begin < index <= begin + frames:
                return image
            held = clip.images[camera][begin]
            return _noisy(held, noise, rng) if noise else held

        return clip.mapped(repeat)

    return fault


def swapped(clip: Clip) -> Clip:
    """Left and right images exchanged."""
    return replace(clip, images=clip.images[::-1])


def inverted(clip: Clip) -> Clip:
    """All images turned by 180 degrees."""
    return clip.mapped(lambda image, camera, index: cv2.rotate(image, cv2.ROTATE_180))


def mirrored(clip: Clip) -> Clip:
    """All images mirrored."""
    return clip.mapped(lambda image, camera, index: cv2.flip(image, 1))


def same_camera(clip: Clip) -> Clip:
    """The left images as right ones too."""
    return replace(clip, images=(clip.images[0], clip.images[0]))


def late(frames: int, camera: int = 1) -> Fault:
    """Images of one camera handed out `frames` frames late, with the stamps of the others."""

    def fault(clip: Clip) -> Clip:
        images = list(clip.images)
        old = images[camera]
        images[camera] = [old[0]] * frames + old[:-frames]
        return replace(clip, images=tuple(images))

    return fault


def stamp_offset(offset_ms: float) -> Fault:
    """Stamps of the right camera that are too late by a constant; its images are simultaneous."""

    def fault(clip: Clip) -> Clip:
        stamps = (clip.stamps_ns[0], clip.stamps_ns[1] + round(offset_ms * 1e6))
        return replace(clip, stamps_ns=stamps)

    return fault


def rolled(degrees: float) -> Fault:
    """A right camera that is rolled, with an exact calibration; needs a rectified pair."""

    def fault(clip: Clip) -> Clip:
        return _mounted(clip, np.deg2rad([0.0, 0.0, degrees]))

    return fault


def _mounted(clip: Clip, rotation: Floats) -> Clip:
    """Both images on a square canvas, as if the right camera was turned by a rotation vector."""
    size, old = 700, clip.rig.cam0.matrix
    new = old.copy()
    new[:2, 2] = size / 2
    turns = (np.eye(3), so3_exp(rotation))
    assert clip.rig.cam1_from_cam0 is not None
    t = np.eye(4)
    t[:3, :3] = turns[1]
    cam1_from_cam0 = t @ clip.rig.cam1_from_cam0
    warps = [new @ turn @ np.linalg.inv(old) for turn in turns]
    focal = float(new[0, 0]), float(new[1, 1])
    camera = Camera(size, size, *focal, size / 2, size / 2)
    flags = cv2.INTER_CUBIC
    images = clip.mapped(
        lambda x, c, i: cv2.warpPerspective(x, warps[c], (size, size), flags=flags)
    )
    return replace(images, rig=Rig(camera, camera, cam1_from_cam0))


def vertical(clip: Clip) -> Clip:
    """A rectified pair turned by 90 degrees: one camera above the other."""
    old, rig = clip.rig.cam0, clip.rig
    assert rig.cam1_from_cam0 is not None
    camera = Camera(old.height, old.width, old.fy, old.fx, old.height - 1 - old.cy, old.cx)
    turn = np.eye(4)
    turn[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]  # new from old
    turned = clip.mapped(lambda image, c, i: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE))
    rig = Rig(camera, camera, turn @ rig.cam1_from_cam0 @ turn.T)
    return replace(turned, rig=rig, truth=clip.truth @ turn.T)


def miscalibrated(
    pitch: float = 0.0,
    yaw: float = 0.0,
    roll: float = 0.0,
    baseline: float = 1.0,
    down: float = 0.0,
) -> Fault:
    """A calibration of the right camera that is off.

    `pitch`: error of the angle about x in degrees. `yaw`: the same about y. `roll`: the same about
    z. `baseline`: factor of its length. `down`: error of the direction of the baseline in degrees.
    """

    def fault(clip: Clip) -> Clip:
        assert clip.rig.cam1_from_cam0 is not None
        turn = so3_exp(np.deg2rad([pitch, yaw, roll]))
        wrong = clip.rig.cam1_from_cam0.copy()
        wrong[:3, :3] = turn @ wrong[:3, :3]
        wrong[:3, 3] = baseline * (so3_exp(np.deg2rad([0.0, 0.0, down])) @ wrong[:3, 3])
        return replace(clip, rig=replace(clip.rig, cam1_from_cam0=wrong))

    return fault


def apart(degrees: float) -> Fault:
    """A calibration that says that the cameras look in different directions."""
    return miscalibrated(yaw=degrees)


def without_distortion(kept: float = 0.0) -> Fault:
    """A calibration that has only a part of the distortion of the lenses."""

    def fault(clip: Clip) -> Clip:
        cameras = [
            replace(c, distortion=tuple(kept * k for k in c.distortion) if kept else ())
            if kept
            else replace(c, distortion_model="none", distortion=())
            for c in clip.rig.cameras
        ]
        rig = Rig(cameras[0], *cameras[1:], cam1_from_cam0=clip.rig.cam1_from_cam0)
        return replace(clip, rig=rig)

    return fault


def flicker(depth: float, cycles_per_frame: float = 3.33) -> Fault:
    """Bands of a rolling shutter under lamps on 50 Hz mains: the light varies by `depth`."""

    def fault(clip: Clip) -> Clip:
        height = clip.size[0]
        rows = np.arange(height) / height * 1.6  # cycles of 10 ms while the rows are read

        def shade(image: Image, camera: int, index: int) -> Image:
            phase = 2.0 * np.pi * (rows + index * cycles_per_frame)
            return _grey(image * (1.0 - depth * (0.5 + 0.5 * np.sin(phase)))[:, None])

        return clip.mapped(shade)

    return fault


def thermal(counts: float) -> Fault:
    """A radiometric camera of 14 bits, whose scene fills only some `counts`."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(23)

        def raw(image: Image, camera: int, index: int) -> Image:
            noise = rng.normal(0.0, 3.0, image.shape)
            drift = 20.0 * np.sin(index / 20.0)
            return (7400.0 + image * (counts / 255.0) + noise + drift).astype(np.uint16)

        return clip.mapped(raw)

    return fault


def night(factor: float, sigma: float = 4.0) -> Fault:
    """Little light: grey levels times `factor`, with strong read noise."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(24)
        return clip.mapped(lambda x, c, i: _noisy(x * factor + 6.0, sigma, rng))

    return fault


def snow(flakes: int) -> Fault:
    """Flakes of some pixels at random places in each image."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(25)
        height, width = clip.size

        def fall(image: Image, camera: int, index: int) -> Image:
            result = image.copy()
            for _ in range(flakes):
                x, y = int(rng.integers(width)), int(rng.integers(height))
                radius, grey = int(rng.integers(1, 5)), int(rng.integers(190, 256))
                end = (x + int(rng.integers(-3, 4)), y + int(rng.integers(2, 14)))
                cv2.line(result, (x, y), end, grey, radius, cv2.LINE_AA)
            return result

        return clip.mapped(fall)

    return fault


def blur(length: int) -> Fault:
    """Motion blur along the rows."""
    kernel = np.full((1, length), 1.0 / length)
    return lambda clip: clip.mapped(lambda x, c, i: cv2.filter2D(x, -1, kernel))


def interlaced(clip: Clip) -> Clip:
    """Odd rows half a period later, as from an analogue camera: those of the next frame."""

    def weave(image: Image, camera: int, index: int) -> Image:
        later = clip.images[camera][min(index + 1, len(clip) - 1)]
        result = image.copy()
        if later is not None:
            result[1::2] = later[1::2]
        return result

    return clip.mapped(weave)


def resized(factor: float) -> Fault:
    """Tiny images, with the calibration for their size."""

    def fault(clip: Clip) -> Clip:
        small = [_scaled(camera, factor) for camera in clip.rig.cameras]
        size = (small[0].width, small[0].height)
        images = clip.mapped(lambda x, c, i: cv2.resize(x, size, interpolation=cv2.INTER_AREA))
        rig = Rig(small[0], *small[1:], cam1_from_cam0=clip.rig.cam1_from_cam0)
        return replace(images, rig=rig)

    return fault


def covered(begin: int, frames: int, camera: int = 1) -> Fault:
    """A camera that sees nothing for a while."""

    def fault(clip: Clip) -> Clip:
        rng = np.random.default_rng(26)

        def cover(image: Image, number: int, index: int) -> Image:
            hidden = number == camera and begin <= index < begin + frames
            return _noisy(np.full(image.shape, 6.0), 1.0, rng) if hidden else image

        return clip.mapped(cover)

    return fault


def failing(begin: int, frames: int, camera: int = 1) -> Fault:
    """A camera that gives no images for a while."""

    def fail(image: Image, number: int, index: int) -> Image | None:
        return None if number == camera and begin <= index < begin + frames else image

    return lambda clip: clip.mapped(fail)


def _scaled(camera: Camera, factor: float) -> Camera:
    width, height = round(camera.width * factor), round(camera.height * factor)
    x, y = width / camera.width, height / camera.height
    centre = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    return replace(
        camera,
        width=width, height=height,
        fx=camera.fx * x, fy=camera.fy * y, cx=centre[0], cy=centre[1],
    )  # fmt: skip


def _noisy(image: Image | Floats, sigma: float, rng: np.random.Generator) -> Image:
    return _grey(image + rng.normal(0.0, sigma, image.shape))


def _grey(values: Floats) -> Image:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
