"""Checks of layouts before rendering."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folder_layouts import (
    BESIDE,
    IDEAL,
    IN_FOLDERS,
    NO_DROPS,
    PAIR,
    write_layout,
)
from recordings import FISHEYE, RADTAN, make_recording

from data_synth.recipe import Recipe
from data_synth.writers.registry import FORMATS, check, load_writer
from vo.base.errors import CalibrationError, ConfigError
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Rig


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_a_writer(name: str) -> None:
    assert callable(load_writer(name))
    assert set(FORMATS) == set(Recipe.model_fields["format"].annotation.__args__)
    assert (FORMATS[name].suffix == ".mcap") == name.startswith("mcap")


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_raw_images_are_for_mcap_only(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} does not support codec raw; choose png or"):
        check(Recipe(format=name, codec="raw"), Rig(IDEAL))
    check(Recipe(format="mcap", codec="raw"), PAIR)


@pytest.mark.parametrize(
    ("name", "rig"),
    [("euroc", make_recording().rig), ("kitti", PAIR), ("tum", Rig(FISHEYE)), ("folder", PAIR)],
)
def test_recordings_that_fit_are_accepted(name: str, rig: Rig) -> None:
    check(Recipe(format=name, codec="jpeg"), rig)


ROTATED = make_transform(so3_exp(np.array([0.0, 1e-5, 0.0])), BESIDE[:3, 3])
RAISED = make_transform(np.eye(3), np.array([-0.11, 1e-5, 0.0]))
LEFT = make_transform(np.eye(3), np.array([0.11, 0.0, 0.0]))
IN_FRONT = make_transform(np.eye(3), np.array([0.0, 0.0, -0.11]))


@pytest.mark.parametrize(
    ("rig", "reason"),
    [
        (Rig(RADTAN), "cam0 is distorted (radtan)"),
        (Rig(FISHEYE), "cam0 is distorted (equidistant)"),
        (Rig(IDEAL, RADTAN, BESIDE), "cam1 is distorted (radtan)"),
        (Rig(IDEAL, replace(IDEAL, fx=40.1), BESIDE), "cam1 is not equal to cam0"),
        (Rig(IDEAL, IDEAL, ROTATED), "cam1 is rotated or not exactly to the right"),
        (Rig(IDEAL, IDEAL, RAISED), "shifts by -0.11, 1e-05, 0 m"),
        (Rig(IDEAL, IDEAL, LEFT), "shifts by 0.11, 0, 0 m"),
    ],
)
def test_kitti_refuses_what_is_not_rectified(rig: Rig, reason: str, tmp_path: Path) -> None:
    recording = replace(make_recording(stereo=rig.is_stereo, drops=NO_DROPS), rig=rig)
    with pytest.raises(ConfigError) as raised:
        write_layout("kitti", tmp_path / "a", recording)
    with pytest.raises(ConfigError) as checked:
        check(Recipe(format="kitti"), rig)
    assert str(raised.value) == str(checked.value)
    assert reason in str(raised.value)
    assert "or format euroc" in str(raised.value)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("drops", [((2,), ()), ((), (6,))])
def test_kitti_refuses_missing_frames(drops: tuple[tuple[int, ...], ...], tmp_path: Path) -> None:
    recording = replace(make_recording(drops=drops), rig=PAIR)
    with pytest.raises(ConfigError, match="cannot represent missing frames; set effects.drops"):
        write_layout("kitti", tmp_path / "a", recording)
    recipe = Recipe.model_validate({"format": "kitti", "effects": {"drops": 0.5}})
    with pytest.raises(ConfigError, match="or choose format euroc"):
        check(recipe, PAIR)


def test_tum_refuses_a_pair_and_no_depth(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="use one camera .`mono`., or choose format euroc"):
        write_layout("tum", tmp_path / "a", make_recording())
    with pytest.raises(ConfigError, match="has one camera with depth, but there are 2"):
        check(Recipe(format="tum"), PAIR)
    with pytest.raises(ConfigError, match="requires depth, but the recording has none; set depth"):
        write_layout("tum", tmp_path / "a", make_recording(stereo=False, depth=False))
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["mcap", "mcap-ros2"])
def test_mcap_refuses_a_pair_that_cannot_be_rectified(name: str) -> None:
    with pytest.raises(CalibrationError, match="cam1"):
        check(Recipe(format=name), Rig(IDEAL, IDEAL, IN_FRONT))
