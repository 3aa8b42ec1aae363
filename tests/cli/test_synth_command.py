from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from vo.cli.app import app
from vo.recordings.sources.registry import open_source

SMALL = ("--seconds", "0.2", "--fps", "10", "--set", "scale=0.25")


def vo_synth(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["synth", *map(str, arguments)])


def test_renders_a_recording_and_describes_it(tmp_path: Path) -> None:
    out = tmp_path / "made"
    flags = ("--world", "corridor", "--motion", "robot", "--camera", "pinhole", "--mono")
    result = vo_synth(out, *SMALL, *flags, "--effects", "none,noise=2", "--seed", "3")
    assert result.exit_code == 0, result.output
    assert "2 mono frames" in result.output
    recipe = (out / "recipe.yaml").read_text()
    for line in ("world: corridor", "blur: 0.0", "noise: 2.0", "seed: 3"):
        assert line in recipe
    source = open_source(out)
    assert len(source) == 2 and not source.rig.is_stereo
    assert source.rig.cam0.width == 160


def test_options_override_a_preset(tmp_path: Path) -> None:
    result = vo_synth(
        tmp_path / "a.mcap", "--preset", "tum", *SMALL, "--to", "mcap", "--codec", "jpeg", "-q"
    )
    assert result.exit_code == 0, result.output
    assert result.output == ""
    assert (tmp_path / "a.mcap").read_bytes()[:5] == b"\x89MCAP"


def test_refuses_to_overwrite_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    result = vo_synth(tmp_path, *SMALL)
    assert result.exit_code == 1
    assert result.output.startswith("error: ") and "--force" in result.output
    assert result.output.count("\n") == 1


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--world", "moon"), "setting 'world'"),
        (("--preset", "kiti"), "did you mean 'kitti'"),
        (("--camera", "nowhere.yaml"), "nowhere.yaml does not exist"),
        (("--effects", "blur"), "NAME=STRENGTH"),
        (("--effects", "blurry=1"), "did you mean 'effects.blur'"),
        (("--seconds", "-3"), "setting 'seconds'"),
        (("--to", "kitti"), "euroc"),
        (("--to", "tum"), "--mono"),
    ],
)
def test_invalid_arguments_are_one_error_line(
    tmp_path: Path, flags: tuple[str, ...], message: str
) -> None:
    result = vo_synth(tmp_path / "out", *SMALL, *flags)
    assert result.exit_code == 1
    assert result.output.startswith("error: ") and message in result.output
    assert result.output.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_list_shows_presets_cameras_and_settings() -> None:
    result = vo_synth("--list")
    assert result.exit_code == 0
    for word in ("kitti", "aerial", "fisheye", "effects.rolling_shutter", "imu.gyro_noise"):
        assert word in result.output


def test_a_missing_output_is_a_usage_error() -> None:
    assert vo_synth().exit_code == 2
