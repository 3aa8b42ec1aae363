"""RGB-D recordings: association of depth images, and their unit."""

from __future__ import annotations

from pathlib import Path

import layouts
import numpy as np
import pytest

from vo.base.errors import CalibrationError, SourceError
from vo.recordings.sources.depth import associate_depth
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.registry import open_source

MS = 1_000_000


def raw_depth(index: int) -> np.ndarray:
    depth = np.full((layouts.HEIGHT, layouts.WIDTH), 5000 + 100 * index, np.uint16)
    depth[0] = 0
    return depth


@pytest.fixture
def rgbd(tum: Path) -> Path:
    """Depth images 7 ms after their images."""
    rows = ""
    for i, stamp in enumerate(layouts.STAMPS_NS):
        name = f"depth/{layouts.seconds(stamp + 7 * MS)}.png"
        layouts.write_image(tum / name, raw_depth(i))
        rows += f"{layouts.seconds(stamp + 7 * MS)} {name}\n"
    layouts.write_text(tum / "depth.txt", f"# depth maps\n{rows}")
    return tum


def test_depth_is_in_metres(rgbd: Path) -> None:
    source = open_source(rgbd)
    assert source.rig.has_depth
    assert source.rig.is_metric
    for i, frame in enumerate(source.frames()):
        assert frame.stamp_ns == layouts.STAMPS_NS[i]
        assert frame.depth is not None
        assert frame.depth.dtype == np.float32
        assert frame.depth.shape == frame.image0.shape
        assert (frame.depth[0] == 0).all()
        np.testing.assert_allclose(frame.depth[1:], 1.0 + 0.02 * i, rtol=1e-6)
    assert source.unpaired == 0


def test_unit_from_the_calibration(rgbd: Path, tmp_path: Path) -> None:
    text = layouts.CALIBRATION.replace("baseline_m: 0.12", "depth_per_metre: 1000")
    layouts.write_text(tmp_path / "millimetres.yaml", text)
    frame = next(iter(open_source(rgbd, calibration=tmp_path / "millimetres.yaml").frames()))
    assert frame.depth is not None
    assert frame.depth[5, 5] == pytest.approx(5.0)


def test_error_for_an_implausible_unit(rgbd: Path, tmp_path: Path) -> None:
    text = layouts.CALIBRATION.replace("baseline_m: 0.12", "depth_per_metre: 0")
    layouts.write_text(tmp_path / "c.yaml", text)
    with pytest.raises(CalibrationError, match="depth_per_metre is 0; it must be above 0"):
        open_source(rgbd, calibration=tmp_path / "c.yaml")


def test_mono_ignores_depth(rgbd: Path) -> None:
    source = open_source(rgbd, mode="mono")
    assert not source.rig.is_metric
    assert all(frame.depth is None for frame in source.frames())


def test_missing_or_damaged_depth_image_loses_only_itself(
    rgbd: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = sorted((rgbd / "depth").iterdir())
    files[1].unlink()
    files[2].write_bytes(files[2].read_bytes()[:-9])
    layouts.write_image(files[3], np.zeros((9, 9), np.uint16))
    source = open_source(rgbd)
    frames = list(source.frames())
    assert [f.depth is None for f in frames] == [False, True, True, True, False, False]
    assert source.unpaired == 3
    assert source.skipped == []
    assert "frame 1 used without its depth image" in caplog.text
    assert "is 9x9, but those of the camera are 64x48" in caplog.text


def test_error_without_any_depth_image_names_mono_mode(rgbd: Path) -> None:
    for path in (rgbd / "depth").iterdir():
        path.unlink()
    with pytest.raises(SourceError, match="to ignore depth, use `mode=mono`"):
        open_source(rgbd)
    assert len(list(open_source(rgbd, mode="mono").frames())) == layouts.COUNT


def test_depth_of_another_time_is_not_used(rgbd: Path, caplog: pytest.LogCaptureFixture) -> None:
    table = (rgbd / "depth.txt").read_text().splitlines()
    moved = [f"{float(line.split()[0]) + 100:.9f} {line.split()[1]}" for line in table[1:]]
    layouts.write_text(rgbd / "depth.txt", "\n".join(moved))
    assert not open_source(rgbd).rig.has_depth
    assert "no depth image is within 20 ms" in caplog.text


@pytest.mark.parametrize(
    ("left_ms", "depth_ms", "expected"),
    [
        ([0, 33, 66], [10, 43, 76], [0, 1, 2]),
        ([0, 33, 66], [25, 58], [None, 0, 1]),
        ([0, 15], [10], [None, 0]),  # the nearer gets it
        ([0], [20], [None]),
        ([0], [19.999], [0]),
        ([0, 10], [4, 5], [0, 1]),
        ([0, 10], [], [None, None]),
    ],
)
def test_closest_pairs_first(
    left_ms: list[float], depth_ms: list[float], expected: list[int | None]
) -> None:
    left = [Shot(round(t * MS), ImageFile(Path("left")), "here") for t in left_ms]
    depth = [
        Shot(round(t * MS), ImageFile(Path(f"{i}.png")), "here") for i, t in enumerate(depth_ms)
    ]
    found = associate_depth(left, depth)
    assert [None if d is None else int(Path(d.name).stem) for d in found] == expected
