"""What the terminal says of images with a defect."""

from __future__ import annotations

from vo.base.failures import ImageDefect
from vo.cli import advice


def test_every_defect_has_a_likely_cause() -> None:
    assert set(advice._CAUSES) == set(ImageDefect)
