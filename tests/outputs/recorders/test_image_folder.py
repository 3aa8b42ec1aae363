"""Images of keyframes as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from vo.outputs.recorders.colmap import ImageFolder


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    """It may lead to a file that is no part of the recording."""
    colour = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "secret.png"), colour)
    (tmp_path / "recording").mkdir()
    link, plain = (tmp_path / "recording" / name for name in ("link.png", "plain.png"))
    link.symlink_to(tmp_path / "secret.png")
    cv2.imwrite(str(plain), colour)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "link.png").symlink_to(plain)  # nor written to
    folder, grey = ImageFolder(tmp_path / "out"), np.zeros((48, 64), np.uint8)
    for number, path in enumerate((link, plain)):
        folder.add(number, path, grey, is_recorded=True)
    np.testing.assert_array_equal(cv2.imread(str(plain), cv2.IMREAD_UNCHANGED), colour)
    secret = (tmp_path / "secret.png").read_bytes()
    assert (tmp_path / "out" / "link.png").read_bytes() != secret
    assert (tmp_path / "out" / "plain.png").read_bytes() == secret  # the same picture
