"""`vo features`: one image, two images of a plane, pairs of a recording, and inputs that fail."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from vo.cli.app import app
from vo.engine.features.detectors import DETECTORS, available_detectors
from vo.tools.laboratory.methods import missing_detectors

_LEARNED = {name for name, kind in DETECTORS.items() if kind.model}


def features(*words: object) -> Result:
    return CliRunner().invoke(app, ["features", *map(str, words)])


def results(*words: object) -> list[dict[str, Any]]:
    result = features(*words, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["results"]
    assert isinstance(found, list)
    return found


@pytest.fixture
def image(synthetic_stereo: Path, tmp_path: Path) -> Path:
    first = min((synthetic_stereo / "mav0" / "cam0" / "data").iterdir())
    path = tmp_path / "image.png"
    path.write_bytes(first.read_bytes())
    return path


def test_an_image_is_shown_with_a_picture(image: Path, tmp_path: Path) -> None:
    picture = tmp_path / "new" / "features.png"
    result = features(image, "--detector", "sift", "--picture", picture)
    assert result.exit_code == 0, result.output
    assert "128 x float32" in result.stdout
    drawn, plain = cv2.imread(str(picture)), cv2.imread(str(image))
    assert drawn is not None and plain is not None
    assert drawn.shape == plain.shape
    assert np.mean((drawn != plain).any(axis=2)) > 0.02


def test_a_frame_of_a_recording_is_the_same_as_its_image(
    synthetic_stereo: Path, image: Path
) -> None:
    (frame,) = results(synthetic_stereo, "--detector", "fast", "--set", "features.count=200")
    (alone,) = results(image, "--detector", "fast", "--set", "features.count=200")
    assert frame["count"] == alone["count"] == 200 == sum(frame["by_octave"])
    assert 0.3 < frame["spread"] <= 1
    assert frame["response"] == alone["response"]
    (other,) = results(synthetic_stereo, "--frame", 20)
    assert (other["method"], other["descriptor"]) == ("orb", "32 x uint8")
    assert other["ms"] > 0


def test_all_detectors_are_compared_in_an_image(image: Path) -> None:
    result = features(image, "--compare", "all", "--json")
    rows = json.loads(result.stdout)["results"]
    expected = {"orb", *available_detectors(), "klt", "fast/klt"}
    assert {row["method"] for row in rows} - _LEARNED == expected
    assert len(rows) == len({row["method"] for row in rows})
    warnings = [line for line in result.stderr.splitlines() if line.startswith("warning")]
    assert len(warnings) == (1 if missing_detectors() else 0)
    assert all(name in "".join(warnings) for name in missing_detectors())


def test_methods_are_scored_on_a_recording(synthetic_stereo: Path, tmp_path: Path) -> None:
    plot = tmp_path / "plot.svg"
    words = ("--compare", "orb,klt", "--gaps", "3,8,99", "--pairs", 2)
    result = features(synthetic_stereo, *words, "--json", "--picture", plot)
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["results"]
    assert [(row["method"], row["gap"], row["pairs"]) for row in rows] == [
        *(("orb", 3, 2), ("orb", 8, 2)),
        *(("klt", 3, 2), ("klt", 8, 2)),
    ]
    assert all(row["precision"] > 0.8 and row["rotation_deg"] < 1 for row in rows)
    assert all(row["repeatability"] is None for row in rows)
    assert "gap 99 is left out: of 30 frames" in result.stderr
    assert plot.read_text(encoding="utf-8").count("<svg") == 1
    table = features(synthetic_stereo, *words)
    assert "below 2°" in table.stdout


def test_methods_are_scored_by_a_homography(image: Path, tmp_path: Path) -> None:
    pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    second, homography = tmp_path / "second.png", tmp_path / "H_1_2"
    assert cv2.imwrite(str(second), pixels[:, 9:])
    homography.write_text("1 0 -9\n0 1 0\n0 0 1\n", encoding="utf-8")
    for row in results(image, second, "--homography", homography, "--compare", "orb,sift"):
        assert row["precision"] > 0.9
        assert row["repeatability"] > 0.6
        assert row["matching_score"] > 0.6
    result = features(image, second, "--homography", homography, "--compare", "klt")
    assert result.exit_code == 1
    assert "optical flow needs images of one size" in result.stderr
    everything = features(image, second, "--homography", homography, "--compare", "all", "--json")
    assert "klt" not in everything.stdout
    assert "left out: optical flow" in everything.stderr


def test_a_folder_of_hpatches_has_accuracies(image: Path, tmp_path: Path) -> None:
    pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    height, width = pixels.shape
    folder, picture = tmp_path / "v_wall", tmp_path / "accuracy.png"
    folder.mkdir()
    cv2.imwrite(str(folder / "1.ppm"), np.dstack([pixels] * 3))
    for number, slope in ((2, 1e-4), (3, -2e-4)):
        homography = np.array([[1.0, 0.05, -8], [-0.04, 1.1, 5], [slope, slope, 1]])
        seen = cv2.warpPerspective(pixels, homography, (width, height))
        cv2.imwrite(str(folder / f"{number}.ppm"), np.dstack([seen] * 3))
        np.savetxt(folder / f"H_1_{number}", homography)
    for row in results(folder, "--compare", "orb,sift", "--picture", picture):
        assert row["pairs"] == 2 and row["corner_px"] < 1.5
        assert row["within_3_px"] == row["within_5_px"] == 1.0
    assert cv2.imread(str(picture)) is not None
    (folder / "3.ppm").unlink()
    refused = features(folder, "--compare", "orb")
    assert refused.exit_code == 1 and "no image 3.ppm" in refused.stderr


def test_a_folder_of_images_needs_no_calibration(images: Path) -> None:
    (images / "calibration.yaml").unlink()
    assert results(images, "--frame", 2, "--detector", "fast")[0]["count"] > 0
    refused = features(images, "--compare", "fast")
    assert refused.exit_code == 1
    assert "calibration" in refused.stderr


@pytest.mark.parametrize("shape", [(1, 1), (240, 320)])
def test_black_and_tiny_images_have_no_features(shape: tuple[int, int], tmp_path: Path) -> None:
    black = tmp_path / "black.png"
    assert cv2.imwrite(str(black), np.zeros(shape, np.uint8))
    rows = results(black, "--compare", "orb,sift,fast,shi_tomasi,mser,klt")
    assert [(row["count"], row["spread"], row["response"]) for row in rows] == [(0, 0, None)] * 6


def test_images_of_16_bits_use_their_range(image: Path, tmp_path: Path) -> None:
    pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    deep = tmp_path / "deep.png"
    assert cv2.imwrite(str(deep), pixels.astype(np.uint16) * 256)
    assert results(deep)[0]["count"] == results(image)[0]["count"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["missing.png"], "image missing.png does not exist"),
        (["text.png"], "image text.png cannot be decoded"),
        (["missing"], "missing does not exist"),
        (["images", "--compare", "orb"], "with --frame N they are compared in one image"),
        (["images", "--frame", "5"], "images has no frame 5; frames are 0 to 4"),
        (["images", "--compare", "orb,none"], "there is no detector 'none'"),
        (["images", "--compare", ","], "--compare names no method"),
        (["images", "--compare", "orb", "--detector", "sift"], "without --compare"),
        (["images", "--set", "tracking.method=klt"], "has no effect on vo features"),
        (["images", "--set", "features.detectr=sift"], "detector"),
        (["images/0.png", "--frame", "0"], "--frame is of a recording"),
        (["images/0.png", "images/1.png"], "give both SECOND and --homography FILE"),
        (["images/0.png", "--homography", "text.png"], "give both SECOND and --homography FILE"),
        (["images/0.png", "images/1.png", "--homography", "text.png"], "is not nine numbers"),
        (["images/0.png", "images/1.png", "--homography", "zeros"], "has no inverse"),
        (["images/0.png", "--picture", "a.txt"], "pictures of features are PNG files"),
        (["images/0.png", "--picture", "images/0.png"], "is an input and would be replaced"),
        (["images/0.png", "--compare", "all", "--picture", "a.png"], "of one method"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    words: list[str], message: str, images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(images.parent)
    Path("text.png").write_text("no image", encoding="utf-8")
    Path("zeros").write_text("1 0 0 0 1 0 0 0 0", encoding="utf-8")
    result = features(*words)
    assert result.exit_code == 1, result.output
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert message in errors[0]
    assert result.stdout == ""


@pytest.mark.parametrize("gaps", ["0", "-1", "", "x", "1,x", ","])
def test_gaps_are_whole_numbers_from_1(gaps: str, synthetic_stereo: Path) -> None:
    result = features(synthetic_stereo, "--compare", "orb", f"--gaps={gaps}")
    assert result.exit_code == (1 if gaps else 2)
    assert "--gaps" in result.stderr


def test_gaps_longer_than_the_recording_are_an_error(synthetic_stereo: Path) -> None:
    result = features(synthetic_stereo, "--compare", "orb", "--gaps", "200,300")
    assert result.exit_code == 1
    assert "no frames with ground truth are 200, 300 frames apart" in result.stderr
