"""Positions of another sensor against a path: times, clocks, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.base.geometry.geodesy import enu_from_geodetic, geodetic_from_enu
from vo.base.geometry.transforms import so3_exp
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Floats, Trajectory
from vo.runs.scaling.georeference import write_georeference
from vo.runs.scaling.position_source import PositionSource
from vo.runs.scaling.positions import Positions

START_NS = 1_700_000_000_000_000_000
UNIT_M = 4.0  # length of a unit of the map
ROTATION = so3_exp(np.array([-1.2, 0.7, 0.2]))
ORIGIN = np.array([48.1, 11.5, 520.0])


def true_m(seconds: Floats) -> Floats:
    """A drive with changing speed and a turn."""
    along = 8.0 * seconds + 6.0 * np.sin(0.4 * seconds)
    heading = 0.03 * along
    return np.column_stack([along * np.cos(0.3 * heading), 0.0 * along, 20.0 * np.sin(heading)])


def drive(seconds: float = 20.0, worlds: int = 1) -> PosedFrames:
    """A path at 10 Hz in units of its map; each world begins anew."""
    times = np.arange(0.0, seconds, 0.1)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, 3] = true_m(times) / UNIT_M
    world = (np.arange(len(times)) * worlds) // len(times)
    stamps_ns = START_NS + (times * 1e9).astype(np.int64)
    nothing = np.zeros(len(times), bool)
    frames = np.arange(len(times))
    return PosedFrames(frames, world, world, nothing, nothing, Trajectory(stamps_ns, poses))


def gps(
    seconds: Floats, noise_m: float = 0.0, late_s: float = 0.0, *, start_ns: int = START_NS
) -> Positions:
    noise = np.random.default_rng(0).normal(0.0, 1.0, (len(seconds), 3))
    xyz = true_m(seconds) @ ROTATION.T + (5.0, 6.0, 7.0) + noise_m * noise
    stamps_ns = start_ns + ((seconds + late_s) * 1e9).astype(np.int64)
    return Positions("gps.nmea", "gps", stamps_ns, xyz, np.full(len(xyz), np.nan), ORIGIN)


SECONDS = np.arange(-1.0, 22.0, 0.25) + 0.017  # between the frames


def test_the_scale_of_each_world() -> None:
    findings = PositionSource(gps(SECONDS)).measure(drive(worlds=2))
    assert [scale.segment for scale in findings.scales] == [0, 1]
    for scale in findings.scales:
        assert scale.value == pytest.approx(UNIT_M, rel=2e-3)
        assert scale.source == "gps" and 0.0 < scale.sigma < 0.02 * UNIT_M
    assert findings.notes == ()


@pytest.mark.parametrize("late_s", [0.0, 0.7, -1.2])
def test_an_offset_of_the_clocks_is_corrected_and_reported(late_s: float) -> None:
    findings = PositionSource(gps(SECONDS, 0.5, late_s)).measure(drive())
    (scale,) = findings.scales
    assert abs(scale.value / UNIT_M - 1.0) < 0.01
    if not late_s:
        assert findings.notes == ()
        return
    (note,) = findings.notes
    word = "late" if late_s > 0 else "early"
    assert note.startswith("gps, segment 0: the positions are") and f"s {word}" in note
    assert float(note.split("are ")[1].split()[0]) == pytest.approx(abs(late_s), abs=0.06)


@pytest.mark.parametrize("late_s", [10.0, -14.0])
def test_a_clock_that_was_guessed_is_found(late_s: float) -> None:
    """As of a GPX file beside a video, whose times are said by hand."""
    seconds = np.arange(-30.0, 50.0, 0.5)
    findings = PositionSource(gps(seconds, 0.3, late_s)).measure(drive())
    (scale,) = findings.scales
    assert scale.value == pytest.approx(UNIT_M, rel=0.01)
    found = re.search(r"positions are (\S+) s (late|early), which is corrected", findings.notes[0])
    assert found is not None and (found[2] == "late") == (late_s > 0)
    assert float(found[1]) == pytest.approx(abs(late_s), abs=0.1)


def test_another_clock_is_refused_before_the_run() -> None:
    source = PositionSource(gps(SECONDS, start_ns=500_000_000_000))
    stamps_ns = drive().trajectory.stamps_ns
    with pytest.raises(SourceError, match=r"from 499\.017 s to .*2023-11-14 .*`offset_ns`"):
        source.check_times(stamps_ns)
    PositionSource(gps(SECONDS)).check_times(stamps_ns)


def test_times_of_day_get_the_day_of_the_recording() -> None:
    given = gps(SECONDS)
    day_ns = 86_400 * 10**9
    of_day = Positions(
        "a", "gps", given.stamps_ns % day_ns, given.xyz, given.sigma_m, ORIGIN, is_time_of_day=True
    )
    source = PositionSource(of_day)
    source.check_times(drive().trajectory.stamps_ns)
    (scale,) = source.measure(drive()).scales
    assert scale.value == pytest.approx(UNIT_M, rel=2e-3)


def test_a_short_path_has_no_scale() -> None:
    findings = PositionSource(gps(SECONDS, 5.0)).measure(drive(2.0))
    assert findings.scales == ()
    (note,) = findings.notes
    assert "the scale cannot be observed" in note and "position errors of" in note
    findings = PositionSource(gps(SECONDS[:5])).measure(drive())
    assert findings.scales == () and "positions at times of the path" in findings.notes[0]


def test_lengths_of_a_path_in_metres_are_compared() -> None:
    path = drive()
    poses = path.trajectory.world_from_cam.copy()
    poses[:, :3, 3] *= UNIT_M * 1.05
    metric = PosedFrames(
        path.frame_index,
        path.segment,
        path.world,
        path.is_keyframe,
        path.interpolated,
        Trajectory(path.trajectory.stamps_ns, poses),
    )
    findings = PositionSource(gps(SECONDS), is_metric=True).measure(metric)
    assert findings.scales == ()
    assert any("lengths differ by +5.0%" in note for note in findings.notes)


def test_the_path_on_the_globe(tmp_path: Path) -> None:
    source, path = PositionSource(gps(SECONDS)), drive()
    source.measure(path)
    path.trajectory.world_from_cam[:, :3, 3] *= UNIT_M
    assert write_georeference(tmp_path, path, source) == []
    geojson = json.loads((tmp_path / "path.geojson").read_text())
    (feature,) = geojson["features"]
    points = np.array(feature["geometry"]["coordinates"])
    assert points.shape == (len(path.trajectory), 3)
    assert feature["properties"]["stamps_ns"][0] == START_NS
    seconds = 1e-9 * (path.trajectory.stamps_ns - START_NS)
    expected = true_m(seconds) @ ROTATION.T + (5.0, 6.0, 7.0)
    enu = enu_from_geodetic(points[:, [1, 0, 2]], ORIGIN)
    np.testing.assert_allclose(enu, expected, atol=0.15)
    np.testing.assert_allclose(points[:, [1, 0, 2]], geodetic_from_enu(enu, ORIGIN), atol=1e-3)
    root = ElementTree.parse(tmp_path / "path.kml").getroot()
    (coordinates,) = root.iter("{http://www.opengis.net/kml/2.2}coordinates")
    assert coordinates.text is not None
    assert [float(v) for v in coordinates.text.split()[0].split(",")] == points[0].tolist()


@pytest.mark.parametrize("is_metric", [False, True])
def test_an_antenna_beside_the_camera_does_not_bend_the_path(is_metric: bool) -> None:
    """A car that turns in a small circle, with the antenna 1.5 m behind and 1 m above it."""
    angle = np.linspace(0.0, 3.0, 60)
    stamps_ns = (1e8 * np.arange(60)).astype(np.int64)
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = 4.0 * (1.0 - np.cos(angle)), 4.0 * np.sin(angle)
    for pose, turn in zip(poses, angle, strict=True):
        pose[:3, :3] = so3_exp(np.array([0.0, turn, 0.0]))
    arm = np.array([-0.5, -1.0, -1.5])
    xyz = poses[:, :3, 3] + poses[:, :3, :3] @ arm
    positions = Positions("gps", "gps", stamps_ns, xyz, np.full(60, np.nan))
    path = poses.copy()
    path[:, :3, 3] /= 1.0 if is_metric else UNIT_M
    zero, no = np.zeros(60, np.int64), np.zeros(60, bool)
    frames = PosedFrames(np.arange(60), zero, zero, no, no, Trajectory(stamps_ns, path))
    source = PositionSource(positions, is_metric=is_metric, lever_arm_m=arm.tolist())
    findings = source.measure(frames)
    (alignment,) = source.alignments
    np.testing.assert_allclose(alignment.transform(poses[:, :3, 3]), poses[:, :3, 3], atol=1e-3)
    if is_metric:
        assert findings.notes == ()
        return
    assert findings.scales[0].value == pytest.approx(UNIT_M, rel=1e-4)
    without = PositionSource(positions).measure(frames)
    assert without.scales[0].value > 1.02 * UNIT_M  # the antenna drives a larger circle


def winding_m(seconds: Floats) -> Floats:
    """A drive east, with bends, a hill and changing speed."""
    along = 8.0 * seconds + 6.0 * np.sin(0.4 * seconds)
    return np.column_stack(
        [along, 25.0 * np.sin(0.03 * along), 6.0 * np.sin(0.05 * along + 1.0) + 0.02 * along]
    )


def winding_path(seconds: float = 20.0) -> PosedFrames:
    path = drive(seconds)
    times = 1e-9 * (path.trajectory.stamps_ns - START_NS)
    path.trajectory.world_from_cam[:, :3, 3] = winding_m(times) @ ROTATION / UNIT_M
    return path


def receiver(fault: str, noise_m: float, rate_hz: float, seed: int = 0) -> Positions:
    """Positions of that drive as a receiver with a fault gives them."""
    seconds = np.arange(0.0, 20.0, 1.0 / rate_hz)
    noise = np.random.default_rng(seed).normal(0.0, noise_m, (len(seconds), 3))
    xyz = winding_m(seconds) + noise
    if fault.startswith("smooths"):
        tau = float(fault.split()[1])
        for row in range(1, len(xyz)):
            xyz[row] = xyz[row - 1] - np.expm1(-1.0 / rate_hz / tau) * (xyz[row] - xyz[row - 1])
    if fault == "mirrored":
        xyz = xyz[:, [1, 0, 2]]
    if fault == "stretched":
        xyz = xyz * (1.52, 1.0, 1.0)
    origin = np.array([49.0, 8.4, 110.0])
    geodetic = geodetic_from_enu(xyz, origin)
    if fault == "exchanged":
        geodetic = geodetic[:, [1, 0, 2]]
    if fault == "rounded":
        geodetic[:, :2] = np.round(geodetic[:, :2], 4)
    xyz, origin = enu_from_geodetic(geodetic, geodetic[0]), geodetic[0]
    stamps_ns = START_NS + np.round(seconds * 1e9).astype(np.int64)
    return Positions("gps.csv", "gps", stamps_ns, xyz, np.full(len(xyz), np.nan), origin)


@pytest.mark.parametrize("noise_m", [0.02, 0.3, 3.0])
@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_clean_positions_are_accepted(noise_m: float, rate_hz: float) -> None:
    for seed in range(2):
        findings = PositionSource(receiver("", noise_m, rate_hz, seed)).measure(winding_path())
        (scale,) = findings.scales
        assert abs(scale.value / UNIT_M - 1.0) < min(2.5 * scale.relative_sigma, 0.02)
        assert not any("fit" in note or "exchanged" in note for note in findings.notes)


@pytest.mark.parametrize("noise_m", [0.05, 0.5])
@pytest.mark.parametrize("rate_hz", [2.0, 10.0])
@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("smooths 1", "a receiver that smooths over about"),
        ("smooths 2", "a receiver that smooths over about"),
        ("smooths 3", "a receiver that smooths over about"),
        ("smooths 6", "a receiver that smooths over about"),
        ("mirrored", "two columns are exchanged, or an axis has the wrong sign"),
        ("stretched", "another shape than the path, 1.5 times as long in one direction"),
    ],
)
def test_positions_that_do_not_fit_the_path_are_refused(
    fault: str, cause: str, noise_m: float, rate_hz: float
) -> None:
    findings = PositionSource(receiver(fault, noise_m, rate_hz)).measure(winding_path())
    assert findings.scales == ()
    (note,) = findings.notes
    assert "the positions don't fit the path: they" in note and cause in note


def test_exchanged_columns_are_found_and_put_right(tmp_path: Path) -> None:
    for noise_m, rate_hz in ((0.02, 10.0), (1.0, 10.0), (0.3, 1.0)):
        source = PositionSource(receiver("exchanged", noise_m, rate_hz))
        findings = source.measure(winding_path())
        (scale,) = findings.scales
        assert abs(scale.value / UNIT_M - 1.0) < min(2.0 * scale.relative_sigma, 0.02)
        assert "latitude and longitude are exchanged, which is corrected" in findings.notes[0]
    path = winding_path()
    path.trajectory.world_from_cam[:, :3, 3] *= UNIT_M
    assert write_georeference(tmp_path, path, source) == []
    (feature,) = json.loads((tmp_path / "path.geojson").read_text())["features"]
    np.testing.assert_allclose(feature["geometry"]["coordinates"][0][:2], (8.4, 49.0), atol=1e-4)


@pytest.mark.parametrize(("metres", "time_s"), [(20.0, np.inf), (-20.0, np.inf), (20.0, 4.0)])
def test_heights_that_drift_are_put_right(metres: float, time_s: float) -> None:
    """A car that starts, on a straight road: a tilt of the path explains a part of the drift."""
    times = np.arange(0.0, 10.0, 0.1)
    way = np.column_stack([0.4 * times**2, 0.02 * times**2, 0.0 * times])
    path = drive(10.0)
    path.trajectory.world_from_cam[:, :3, 3] = way @ ROTATION / UNIT_M
    drift = metres * (times / 10.0 if np.isinf(time_s) else np.exp(-times / time_s))
    noise = np.random.default_rng(0).normal(0.0, 0.15, way.shape)
    xyz = way + noise + drift[:, None] * (0.0, 0.0, 1.0)
    unknown = np.full(len(xyz), np.nan)
    given = Positions("a.csv", "gps", path.trajectory.stamps_ns, xyz, unknown, ORIGIN)
    source = PositionSource(given)
    findings = source.measure(path)
    (scale,) = findings.scales
    assert scale.value == pytest.approx(UNIT_M, rel=0.01) and scale.relative_sigma < 0.04
    assert re.search(r"segment 0: heights drift by [+-]\d+ m in 9.9 s, which is", findings.notes[0])
    heights = source.alignments[0].transform(way @ ROTATION)[:, 2]
    assert np.ptp(heights) < 3.0


def test_a_hill_is_no_drift_of_heights() -> None:
    """A slope of 20 % from a stop on: heights follow the way, not the time."""
    times = np.arange(0.0, 10.0, 0.1)
    path = drive(10.0)
    way = np.outer(0.4 * times**2, (1.0, 0.05, 0.2))
    path.trajectory.world_from_cam[:, :3, 3] = way @ ROTATION / UNIT_M
    xyz = way + np.random.default_rng(0).normal(0.0, 0.15, way.shape)
    unknown = np.full(len(xyz), np.nan)
    given = Positions("a.csv", "gps", path.trajectory.stamps_ns, xyz, unknown, ORIGIN)
    findings = PositionSource(given).measure(path)
    assert findings.scales[0].value == pytest.approx(UNIT_M, rel=0.01)
    assert findings.notes == ()


def test_rounded_positions_have_the_uncertainty_of_their_digits() -> None:
    """Four decimals of a degree are 11 m; a drive of 160 m is 7 % uncertain by them."""
    for seed in range(5):
        (scale,) = (
            PositionSource(receiver("rounded", 0.1, 10.0, seed)).measure(winding_path()).scales
        )
        assert abs(scale.value / UNIT_M - 1.0) < 2.0 * scale.relative_sigma
        assert 0.02 < scale.relative_sigma < 0.1
    findings = PositionSource(receiver("rounded", 0.1, 10.0)).measure(winding_path(5.0))
    assert findings.scales == () and "rounded to 11 m" in findings.notes[-1]


def test_exact_positions_in_regular_steps_are_not_rounded() -> None:
    steps = np.column_stack([0.5 * np.arange(40), np.sin(np.arange(40)), np.zeros(40)])
    stamps_ns = np.arange(40, dtype=np.int64)
    assert Positions("a", "positions", stamps_ns, steps, np.full(40, np.nan)).resolution_m == 0.0
    assert receiver("rounded", 0.1, 10.0).resolution_m == pytest.approx(11.1, abs=0.1)
    assert receiver("", 0.1, 10.0).resolution_m < 0.01
