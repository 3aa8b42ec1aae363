from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.errors import OutputError
from vo.evaluation.plots import draw, save_plot
from vo.evaluation.report import evaluate
from vo.types import Trajectory

MakeWalk = Callable[..., Trajectory]


def test_png_shows_both_paths_and_both_errors(
    tmp_path: Path, make_walk: MakeWalk, make_noisy: MakeWalk
) -> None:
    true = make_walk()
    save_plot(tmp_path / "plot.png", evaluate(make_noisy(true), true), true, "a walk")
    image = cv2.imread(str(tmp_path / "plot.png"))
    assert image is not None
    assert image.shape == (900, 1800, 3)
    for rgb in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00), (0x33, 0x33, 0x33)):
        assert np.count_nonzero((image[:, :, ::-1] == rgb).all(axis=2)) > 500


@pytest.mark.parametrize(("suffix", "start"), [(".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_vector_formats(tmp_path: Path, make_walk: MakeWalk, suffix: str, start: bytes) -> None:
    true = make_walk()
    save_plot(tmp_path / f"plot{suffix}", evaluate(true, true), true)
    assert (tmp_path / f"plot{suffix}").read_bytes().startswith(start)


def test_axes_have_units_and_equal_scale(make_walk: MakeWalk) -> None:
    true = make_walk()
    path, position, rotation = draw(evaluate(true, true), true).axes
    assert path.get_xlabel().endswith("(m)")
    assert path.get_aspect() == 1.0
    assert position.get_ylabel() == "position error (m)"
    assert rotation.get_ylabel() == "rotation error (deg)"
    assert rotation.get_xlabel().endswith("(s)")


def test_the_narrowest_axis_is_left_out(make_walk: MakeWalk) -> None:
    true = make_walk()
    flat = true.world_from_cam.copy()
    flat[:, 1, 3] *= 0.001
    flat_walk = Trajectory(true.stamps_ns, flat)
    axes = draw(evaluate(flat_walk, flat_walk), flat_walk).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "z (m)")


def test_other_suffix_and_folder_that_is_not_there(tmp_path: Path, make_walk: MakeWalk) -> None:
    true = make_walk()
    with pytest.raises(OutputError, match=r"ends in \.png"):
        save_plot(tmp_path / "plot.gif", evaluate(true, true), true)
    with pytest.raises(OutputError, match="cannot be written"):
        save_plot(tmp_path / "none" / "plot.png", evaluate(true, true), true)
