"""Rigs in the public interface, and what is shown of them."""

from __future__ import annotations

import numpy as np
import pytest
from rig_walks import Walk

import vo


def test_a_program_gives_the_images_of_all_cameras(walk: Walk) -> None:
    first = walk.frames[0]
    with vo.Odometry(walk.rig) as odometry:
        for frame in walk.frames[:8]:
            left, right, *further = frame.images
            found = odometry.track(frame.stamp_ns, left, right, further=further)
            assert found.state.has_pose
        images = odometry.snapshot().view.further
        assert [each.name for each in images] == ["cam1", "cam2", "cam3"]
        for each, pose in zip(images, walk.rig.cam0_from_cams[1:], strict=True):
            np.testing.assert_allclose(each.cam0_from_image, pose, atol=1e-9)
            assert each.image is not None and each.image.shape == (240, 320)
        stamp = walk.frames[8].stamp_ns
        with pytest.raises(vo.InputError, match="further has 1 images, but .* 2 cameras besides"):
            odometry.track(stamp, first.images[0], first.images[1], further=[first.images[2]])
        with pytest.raises(vo.InputError, match="stamps_ns has 2 times for 4 cameras"):
            odometry.track(stamp, first.images[0], stamps_ns=[stamp, stamp])
        with pytest.raises(vo.InputError, match=r"further\[1\] has 64x48"):
            small = np.zeros((48, 64), np.uint8)
            odometry.track(stamp, first.images[0], further=[first.images[2], small])
        odometry.track(stamp, first.images[0])  # all others are missing
    with vo.Odometry(walk.rig, mode="stereo") as pair:
        assert len(pair.rig.cameras) == 2
