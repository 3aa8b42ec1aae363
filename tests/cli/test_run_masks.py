"""`vo run --mask`, `--ignore`, `--roi`, and the same in a file of settings."""

from __future__ import annotations

import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from run_calls import HEIGHT, WIDTH, summary_in, vo_run

ALL = WIDTH * HEIGHT


@pytest.fixture
def mask(tmp_path: Path) -> Path:
    pixels = np.full((HEIGHT, WIDTH), 255, np.uint8)
    pixels[48:] = 0
    path = tmp_path / "robot's body.png"
    assert cv2.imwrite(str(path), pixels)
    return path


def test_a_mask_and_areas_are_in_the_summary_and_in_the_settings(
    images: Path, out: Path, mask: Path
) -> None:
    result = vo_run(images, out, "--mask", mask, "--ignore", "0,0,96,4", "--ignore", "0,0,6,64")
    hidden = (96 * 20 + 6 * 44) / ALL
    assert summary_in(out)["hidden"] == [round(hidden, 4)]
    assert f"{hidden:.1%} of the images not used" in result.stdout
    (again,) = [line for line in result.stdout.splitlines() if line.startswith("next: vo run")]
    assert f"--mask {shlex.quote(str(mask))} --ignore 0,0,96,4 --ignore 0,0,6,64" in again
    settings = yaml.safe_load((out / "config.yaml").read_text(encoding="utf-8"))
    assert settings["masks"] == {
        "files": [str(mask)],
        "ignore": ["0,0,96,4", "0,0,6,64"],
        "roi": [],
    }


def test_a_region_of_interest(images: Path, out: Path) -> None:
    vo_run(images, out, "--roi", "10,10,80,50", "--ignore", "10,10,80,10")
    assert summary_in(out)["hidden"] == [round(1 - 80 * 40 / ALL, 4)]


def test_without_masks_nothing_is_said(images: Path, out: Path) -> None:
    result = vo_run(images, out)
    assert summary_in(out)["hidden"] == [0.0]
    assert "not used" not in result.stdout


def test_files_of_settings_are_relative_to_them_and_options_win(
    images: Path, out: Path, mask: Path, tmp_path: Path
) -> None:
    (tmp_path / "robot").mkdir()
    mask.rename(tmp_path / "robot" / "body.png")
    settings = {"masks": {"files": ["body.png"], "ignore": [[0, 0, 96, 4]], "roi": []}}
    config = tmp_path / "robot" / "robot.yaml"
    config.write_text(yaml.safe_dump(settings), encoding="utf-8")
    vo_run(images, out, "--config", config)
    assert summary_in(out)["hidden"] == [round(96 * 20 / ALL, 4)]
    vo_run(images, out, "--config", out / "config.yaml", "--ignore", "0,0,96,8")
    assert summary_in(out)["hidden"] == [round(96 * 24 / ALL, 4)]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--mask", "none.png"), "none.png cannot be read"),
        (("--mask", "{images}/times.txt"), "times.txt is no image"),
        (("--mask", "{small}"), "small.png is 32x48, not the size of the left images (96x64)"),
        (("--mask", "{black}"), "black.png is 0 everywhere"),
        (("--ignore", "1,2,3"), "'1,2,3' has 3 numbers; give x,y,width,height"),
        (("--ignore", "0,0,96,64"), "leave nothing of the left images"),
        (("--ignore", "96,0,10,10"), "'96,0,10,10' is outside of the left images"),
        (("--roi", "top"), "'top' is no area"),
        (("--set", "masks.files=3"), "masks.files"),
        (("--set", "masks.file=a.png"), "did you mean 'masks.files'"),
    ],
)
def test_what_cannot_be_meant_is_one_line(
    arguments: tuple[str, ...], complaint: str, images: Path, out: Path, tmp_path: Path
) -> None:
    small, black = tmp_path / "small.png", tmp_path / "black.png"
    assert cv2.imwrite(str(small), np.full((48, 32), 255, np.uint8))
    assert cv2.imwrite(str(black), np.zeros((HEIGHT, WIDTH), np.uint8))
    names = {"images": images, "small": small, "black": black}
    result = vo_run(images, out, *(word.format(**names) for word in arguments))
    assert result.exit_code == 1, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ") and complaint in line
    assert not (out / "summary.json").exists()


def test_a_mask_is_not_overwritten(images: Path, out: Path, mask: Path) -> None:
    result = vo_run(images, out, "--mask", mask, "--ply", mask)
    assert result.exit_code == 1
    assert cv2.imread(str(mask)) is not None


def test_masks_that_hide_nothing_or_most_are_told(images: Path, out: Path, tmp_path: Path) -> None:
    pixels = np.full((HEIGHT, WIDTH), 255, np.uint8)
    assert cv2.imwrite(str(tmp_path / "m.png"), pixels)
    assert "hides nothing" in vo_run(images, out, "--mask", tmp_path / "m.png").stderr
    pixels[20:] = 0
    pixels[20, 0] = 1
    assert cv2.imwrite(str(tmp_path / "m.png"), pixels)
    assert (
        "hides 69 % of the left images" in vo_run(images, out, "--mask", tmp_path / "m.png").stderr
    )
