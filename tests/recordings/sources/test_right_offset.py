"""Right images whose stamps have a constant offset against left ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.faults import Fault, FaultKind
from vo.base.types import Ints
from vo.cli.app import app
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.pairing import constant_offset_ns
from vo.recordings.sources.registry import open_source
from vo.tools.inspection.inspection import inspect
from vo.tools.inspection.opening import open_leniently

MS = 1_000_000
LEFT = np.arange(40) * 50 * MS + 1_700_000_000 * 10**9


def _shots(stamps_ns: Ints) -> list[Shot]:
    return [Shot(int(stamp), ImageFile(Path(f"{stamp}.png")), "") for stamp in stamps_ns]


def _found_ms(left: Ints, right: Ints) -> float:
    return constant_offset_ns(_shots(left), _shots(right)) / MS


@pytest.mark.parametrize("offset_ms", [-3_600_000, -50, -12, 12, 18, 50 * 40, 86_400_123])
def test_a_constant_offset_is_found(offset_ms: int) -> None:
    jitter = np.random.default_rng(0).integers(-MS // 2, MS // 2, len(LEFT))
    # 50 ms, a whole interval, pairs each image but one: stamps may be right.
    expected = 0.0 if abs(offset_ms) == 50 else -offset_ms
    assert _found_ms(LEFT, LEFT + offset_ms * MS + jitter) == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("offset_ms", [-18, 12])
def test_a_constant_offset_is_found_where_images_are_missing(offset_ms: int) -> None:
    right = np.delete(LEFT, [3, 17, 18]) + offset_ms * MS
    assert _found_ms(np.delete(LEFT, [7]), right) == pytest.approx(-offset_ms)


def test_stamps_that_pair_are_left_alone() -> None:
    jitter = np.random.default_rng(0).integers(-4 * MS, 4 * MS, len(LEFT))
    assert _found_ms(LEFT, LEFT + jitter) == 0.0
    assert _found_ms(LEFT, LEFT + 2 * MS) == 0.0  # within the tolerance
    assert _found_ms(LEFT, LEFT[5:]) == 0.0
    every_third_is_off = LEFT + np.where(np.arange(len(LEFT)) % 3 == 0, 12 * MS, 0)
    assert _found_ms(LEFT, every_third_is_off) == 0.0


def test_offsets_that_are_not_constant_or_not_evident_are_none() -> None:
    drift = np.arange(len(LEFT)) * MS  # free-running cameras of different rates
    assert _found_ms(LEFT, LEFT + 8 * MS + drift) == 0.0
    jitter = np.random.default_rng(0).integers(-20 * MS, 20 * MS, len(LEFT))
    assert _found_ms(LEFT, LEFT + 10 * MS + jitter) == 0.0
    assert _found_ms(LEFT, LEFT + 25 * MS) == 0.0
    assert _found_ms(LEFT[1:], LEFT[:-3] + 25 * MS) == 0.0  # half an interval: which one?
    assert _found_ms(LEFT[1:], LEFT[:-3] + 3_600_000 * MS) == 0.0  # which belong together?


def _with_right_stamps(source: Path, folder: Path, offset_ns: int) -> Path:
    copy = Path(shutil.copytree(source, folder))
    camera = copy / "mav0" / "cam1"
    lines = (camera / "data.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    moved = [f"{int(stamp) + offset_ns},{name}" for stamp, name in rows]
    (camera / "data.csv").write_text("\n".join([lines[0], *moved]) + "\n", encoding="utf-8")
    return copy


def test_images_are_paired_by_a_constant_offset_and_that_is_said(
    synthetic_stereo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copy = _with_right_stamps(synthetic_stereo, tmp_path / "late", 12_345_678)
    source = open_source(copy)
    assert source.faults == [Fault(FaultKind.RIGHT_TIME_OFFSET, is_handled=True, value=12.345678)]
    assert "right stamps are +12.346 ms from left ones in all pairs" in caplog.text
    usual = open_source(synthetic_stereo)
    for frame, other in zip(source.frames(), usual.frames(), strict=True):
        assert frame.stamp_ns == other.stamp_ns
        assert frame.image1 is not None and other.image1 is not None
        np.testing.assert_array_equal(frame.image1, other.image1)
    report = inspect(open_leniently(copy))
    assert report.pair is not None and report.pair.pairs == 30
    (finding,) = report.findings
    assert "right stamps are +12.346 ms from left ones" in finding.what


def test_a_given_offset_shifts_right_images(synthetic_stereo: Path) -> None:
    stamps = open_source(synthetic_stereo).stamps_ns
    interval = int(np.median(np.diff(stamps)))
    shifted = list(open_source(synthetic_stereo, right_offset_ns=-interval).frames())
    usual = list(open_source(synthetic_stereo).frames())
    assert shifted[-1].image1 is None
    for frame, after in zip(shifted[:-1], usual[1:], strict=True):
        assert frame.image1 is not None and after.image1 is not None
        np.testing.assert_array_equal(frame.image1, after.image1)
    assert open_source(synthetic_stereo, right_offset_ns=0).faults == []


def test_a_given_offset_replaces_the_one_that_is_found(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    copy = _with_right_stamps(synthetic_stereo, tmp_path / "late", 12_345_678)
    assert not open_source(copy, right_offset_ns=0).rig.is_stereo
    given = open_source(copy, right_offset_ns=-12_345_678)
    assert given.rig.is_stereo and given.faults == []


def test_a_converted_recording_has_the_shifted_stamps(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    copy = _with_right_stamps(synthetic_stereo, tmp_path / "late", 12_345_678)
    arguments = ["convert", str(copy), str(tmp_path / "out"), "--right-offset", "-12.345678"]
    result = CliRunner().invoke(app, [*arguments, "--to", "euroc"])
    assert result.exit_code == 0, result.output
    made = open_source(tmp_path / "out", right_offset_ns=0)
    assert made.rig.is_stereo
    assert all(frame.image1 is not None for frame in made.frames())


def test_an_offset_that_is_no_number_is_an_error(synthetic_stereo: Path, tmp_path: Path) -> None:
    arguments = ["run", str(synthetic_stereo), "-o", str(tmp_path / "out"), "--right-offset"]
    for value in ("nan", "inf", "1e300"):
        result = CliRunner().invoke(app, [*arguments, value])
        assert result.exit_code == 1
        assert "give milliseconds" in result.output
