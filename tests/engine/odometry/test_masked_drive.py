"""A drive behind a bonnet and under burnt-in text: with masks the path is that without either."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from robustness_clips import Clip, Clips
from robustness_overlays import burnt_in_text, own_body

from vo.base.config import Config, load_config
from vo.base.geometry.similarity import umeyama
from vo.base.types import Frame
from vo.engine.frontend.camera_alignment import half_size_pyramid
from vo.engine.frontend.image_fixed import ImageFixedDetector
from vo.engine.odometry import Odometry


def _ate(clip: Clip, config: Config) -> float:
    """Root mean square of position errors in metres; every frame must have a pose."""
    odometry = Odometry(clip.rig, config)
    frames = (
        Frame(i, int(clip.stamps_ns[0][i]), tuple(camera[i] for camera in clip.images))
        for i in range(len(clip))
    )
    estimates = list(odometry.track_all(frames))
    odometry.finish()
    odometry.close()
    assert not any(estimate.faults for estimate in estimates)
    path = odometry.trajectory.trajectory()
    assert len(path) == len(clip)
    truth = clip.truth[:, :3, 3]
    fit = umeyama(path.positions, truth, with_scale=not clip.rig.is_stereo)
    return float(np.sqrt(np.mean(np.sum((fit.transform_points(path.positions) - truth) ** 2, 1))))


def _masks(clean: Clip, covered: Clip, folder: Path) -> list[str]:
    """Files that are black wherever some image of a camera was changed."""
    files = []
    for number, (before, after) in enumerate(zip(clean.images, covered.images, strict=True)):
        pairs = list(zip(before, after, strict=True))[::5]
        changed = np.any([a != b for a, b in pairs], axis=0).astype(np.uint8)
        changed = cv2.morphologyEx(changed, cv2.MORPH_CLOSE, np.ones((15, 15), np.uint8))
        files.append(str(folder / f"{number}.png"))
        assert cv2.imwrite(files[-1], np.where(changed > 0, 0, 255).astype(np.uint8))
    return files


@pytest.mark.parametrize("is_textured", [False, True], ids=["painted", "rough"])
@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_the_path_of_a_real_drive(
    mode: str, is_textured: bool, shared_data: Path, tmp_path: Path
) -> None:
    clean = Clips(shared_data, tmp_path).get(f"kitti06 {mode}")
    assert clean is not None
    covered = burnt_in_text(0.12)(own_body(0.2, is_textured)(clean))
    files = _masks(clean, covered, tmp_path)
    config, masked = (load_config("default", [f"masks.files={each}"]) for each in ([], files))
    # Starts of this drive differ by 1 cm, in stereo from 8 to 25 mm.
    assert _ate(covered, masked) <= 1.1 * _ate(clean, config) + 0.005


def test_a_bonnet_over_most_of_noisy_images_is_doubted(shared_data: Path, tmp_path: Path) -> None:
    clean = Clips(shared_data, tmp_path).get("kitti06 stereo")
    assert clean is not None
    detector = ImageFixedDetector(clean.baseline_px)
    for image in own_body(0.6, textured=False)(clean).images[0]:
        found = detector.update(half_size_pyramid(image), image.shape)
    assert found.is_ambiguous and found.share > 0.3
