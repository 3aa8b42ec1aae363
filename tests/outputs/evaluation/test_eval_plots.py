from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.errors import OutputError
from vo.base.types import Trajectory
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.plots import draw, save_plot

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
    assert rotation.get_ylabel() == "rotation-alone error (deg)"
    assert rotation.get_xlabel().endswith("(s)")


@pytest.mark.parametrize(
    ("down", "labels"),
    [
        ((0, 1, 0), ("x (m)", "z (m)")),
        ((0, 0, -1), ("x (m)", "y (m)")),
        ((0, 0, 1), ("y (m)", "x (m)")),
        ((-1, 0, 0), ("y (m)", "z (m)")),
    ],
)
def test_path_is_seen_from_above_and_not_mirrored(
    down: tuple[int, int, int], labels: tuple[str, str]
) -> None:
    poses = np.tile(np.eye(4), (9, 1, 1))
    forward = np.roll(down, 1)
    poses[:, :3, :3] = np.column_stack([np.cross(down, forward), down, forward])
    poses[:, :3, 3] = np.random.default_rng(0).normal(size=(9, 3))
    walk = Trajectory(np.arange(9) * 10**8, poses)
    axes = draw(evaluate(walk, walk), walk).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == labels


def test_unsupported_suffix_and_missing_folder(tmp_path: Path, make_walk: MakeWalk) -> None:
    true = make_walk()
    with pytest.raises(OutputError, match=r"use \.png"):
        save_plot(tmp_path / "plot.gif", evaluate(true, true), true)
    with pytest.raises(OutputError, match="cannot be written"):
        save_plot(tmp_path / "none" / "plot.png", evaluate(true, true), true)


def test_no_line_is_drawn_where_poses_are_missing(make_walk: MakeWalk) -> None:
    true = make_walk()
    kept = np.r_[0 : len(true) // 3, len(true) // 2 : len(true)]
    part = Trajectory(true.stamps_ns[kept], true.world_from_cam[kept])
    path, position, _ = draw(evaluate(part, true), true).axes
    for axes in (path, position):
        drawn = next(line for line in axes.get_lines() if line.get_color() == "#0072B2")
        assert np.flatnonzero(np.isnan(drawn.get_ydata())).tolist() == [len(true) // 3]
        assert len(drawn.get_ydata()) == len(part) + 1
