"""A focal length that changes during a recording is followed; a constant one is left alone."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.recipe import load_recipe
from data_synth.sequence import make_sequence
from tests.engine.backend.test_lens_adjustment import lens_of, views_of
from vo.base.records.focal_length import FocalLength
from vo.base.types import Camera
from vo.cli.app import app
from vo.outputs.report.run_folder import read_run
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.rescaling import at_constant_focal_length
from vo.recordings.sources.sequence import ImageSequence
from vo.runs.focal_adjustment import FocalPrior, adjust_focal_lengths
from vo.tools.reopening import recording_of

ZOOM = 1.1


@pytest.mark.parametrize("k1", [0.0, -0.2])
@pytest.mark.parametrize("zoom", [1.0, 1.1])
def test_focal_lengths_are_found_from_observations(zoom: float, k1: float) -> None:
    lens = lens_of(400.0, k1, 1.2 * k1 * k1)
    views = views_of(lens, noise_px=0.1)
    camera = Camera(640, 400, 400.0, 400.0, lens.cx, lens.cy, "radtan", (k1, lens.k2, 0.0, 0.0))
    true = np.log(np.interp(np.arange(12), [4.0, 7.0], [1.0, zoom]))
    centre = np.array([lens.cx, lens.cy])
    xy = centre + (views.xy - centre) * np.exp(true)[views.keyframe][:, None]
    sigma = np.r_[0.001, np.full(11, np.inf)]
    prior = FocalPrior(np.zeros(12), sigma, np.full(11, 0.03))
    found = adjust_focal_lengths(replace(views, xy=xy), camera, prior)
    np.testing.assert_allclose(found.log_focal, true, atol=0.003)
    assert (np.abs(found.log_focal - true) < 3.0 * found.sigma + 1e-4).all()
    assert found.residual_px < 0.2


@pytest.fixture(scope="module")
def zoomed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of one camera that zooms by a tenth within a second."""
    folder = tmp_path_factory.mktemp("zoomed") / "walk"
    settings = ["motion=handheld", "seconds=6", "speed=1.0", "scale=0.625", "effects.exposure=0"]
    make_sequence(folder, load_recipe("demo", settings))
    camera = read_calibration(folder / "calibration.yaml").rig.cam0
    files = sorted((folder / "mav0" / "cam0" / "data").iterdir())
    for number, file in enumerate(files):
        scale = np.interp(number / len(files), [0.4, 0.55], [1.0, ZOOM])
        matrix = np.array(
            [[scale, 0.0, (1 - scale) * camera.cx], [0.0, scale, (1 - scale) * camera.cy]]
        )
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), cv2.warpAffine(image, matrix, image.shape[1::-1]))
    shutil.rmtree(folder / "mav0" / "cam1")
    return folder


def run_on(folder: Path, output: Path, *options: str) -> dict[str, object]:
    chosen = ("--mode", "mono", "--no-imu", "--no-loops", *options)
    result = CliRunner().invoke(app, ["run", str(folder), "-o", str(output), *chosen])
    assert result.exit_code in (0, 3), result.stderr
    return dict(json.loads((output / "summary.json").read_text()))


def error_m(folder: Path, output: Path) -> float:
    options = ["eval", str(output), str(folder), "--align", "sim3", "--json"]
    return float(
        json.loads(CliRunner().invoke(app, options).stdout)["ate"]["translation_m"]["rmse"]
    )


def test_a_zoom_is_followed(zoomed: Path, tmp_path: Path) -> None:
    summary = run_on(zoomed, tmp_path / "out")
    assert any("was followed" in each for each in summary["warnings"])  # type: ignore[attr-defined]
    assert summary["trusted"] is True
    knots = summary["focal_lengths"]
    assert isinstance(knots, list)
    assert knots[-1]["focal_px"] / knots[0]["focal_px"] == pytest.approx(ZOOM, rel=0.02)
    # What opens the recording of the run again sees the same images.
    again = recording_of(read_run(tmp_path / "out"))
    assert again.rig.cam0.fx == pytest.approx(max(each["focal_px"] for each in knots))
    constant = run_on(zoomed, tmp_path / "constant", "--set", "camera.focal=constant")
    assert constant["trusted"] is False
    assert constant["focal_lengths"] == []
    errors = [error_m(zoomed, tmp_path / each) for each in ("out", "constant")]
    assert errors[0] < 0.5 * errors[1]


def test_images_are_enlarged_about_the_principal_point(zoomed: Path) -> None:
    stream = open_source(zoomed, mode="mono")
    assert isinstance(stream, ImageSequence)
    fx, first = stream.rig.cam0.fx, int(stream.stamps_ns[0])
    longer = at_constant_focal_length(
        stream, [FocalLength(first, fx, 0.1), FocalLength(int(stream.stamps_ns[-1]), 2 * fx, 0.1)]
    )
    before, after = next(stream.frames()), next(longer.frames())
    camera = longer.rig.cam0
    assert camera.fx == pytest.approx(2.0 * fx)
    x, y = round(camera.cx), round(camera.cy)
    at = 2.0 * (np.array([20.0, 10.0]) - (camera.cx - x, camera.cy - y))
    patch = cv2.getRectSubPix(
        after.image0, (1, 1), (x + at[0] + camera.cx - x, y + at[1] + camera.cy - y)
    )
    assert float(patch[0, 0]) == pytest.approx(float(before.image0[y + 10, x + 20]), abs=12)
    assert stream.rescale is None


def test_a_live_or_growing_source_cannot_be_followed(zoomed: Path, tmp_path: Path) -> None:
    options = ["run", str(zoomed), "-o", str(tmp_path / "out"), "--follow"]
    result = CliRunner().invoke(app, [*options, "--set", "camera.focal=slow"])
    assert result.exit_code != 0
    assert "Traceback" not in result.stderr
