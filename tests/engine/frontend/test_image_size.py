"""Images of few pixels are a fault of the whole recording."""

from __future__ import annotations

import pytest

from vo.base.faults import FaultKind
from vo.engine.frontend.image_size import size_faults


@pytest.mark.parametrize("size", [(160, 100), (224, 140), (306, 92), (429, 130)])
def test_small_images_are_not_to_be_trusted(size: tuple[int, int]) -> None:
    (fault,) = size_faults(size[0] * size[1])
    assert fault.kind is FaultKind.SMALL_IMAGES and not fault.is_handled
    assert fault.value == pytest.approx(1e-3 * size[0] * size[1])


@pytest.mark.parametrize("size", [(320, 200), (320, 240), (640, 400)])
def test_usual_images_are_no_fault(size: tuple[int, int]) -> None:
    assert size_faults(size[0] * size[1]) == ()
