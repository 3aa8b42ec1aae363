"""Maps of markers: their files, the place of a path in them, and runs."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.errors import SourceError
from vo.base.geometry.transforms import (
    inverse,
    make_transform,
    quat_xyzw_from_rotation,
    rotation_angle,
    so3_exp,
)
from vo.base.types import Floats
from vo.cli.app import app
from vo.engine.markers.marker_problem import square_points
from vo.recordings.formats.trajectory import read_tum
from vo.tools.markers.map_fit import fit_map, register_in_map
from vo.tools.markers.marker_map import KnownMarker, MarkerMap, read_marker_map
from vo.tools.markers.scale_fit import RegisteredMarker

TURN = so3_exp(np.array([0.4, -1.2, 0.7]))
POSE = make_transform(TURN, np.array([1.0, -2.0, 0.5]))


def _read(path: Path, text: str) -> MarkerMap:
    path.write_text(text, encoding="utf-8")
    return read_marker_map(path)


def test_a_pose_and_corners_say_the_same(tmp_path: Path) -> None:
    quat = quat_xyzw_from_rotation(TURN).tolist()
    corners = (square_points(0.2) @ TURN.T + POSE[:3, 3]).tolist()
    text = f"""
dictionary: tag36h11
length_m: 0.16
markers:
  - {{id: 0, position: [1.0, -2.0, 0.5], quat_xyzw: {quat}}}
  - {{id: 7, length_m: 0.2, corners: {corners}, sigma_m: 0.02}}
"""
    known = _read(tmp_path / "room.yaml", text)
    assert known.dictionary == "APRILTAG_36H11"
    for number, length_m, sigma_m in ((0, 0.16, 0.005), (7, 0.2, 0.02)):
        marker = known.markers[number]
        assert (marker.length_m, marker.sigma_m) == pytest.approx((length_m, sigma_m))
        np.testing.assert_allclose(marker.map_from_marker, POSE, atol=1e-12)
    document = {"markers": [{"id": 7, "corners": corners}]}
    again = _read(tmp_path / "room.json", json.dumps(document))
    assert again.dictionary == "auto"
    np.testing.assert_allclose(again.markers[7].map_from_marker, POSE, atol=1e-12)


MARKER = "{id: 3, position: [0, 0, 0], quat_xyzw: [0, 0, 0, 1], length_m: 0.16}"


@pytest.mark.parametrize(
    ("markers", "words"),
    [
        (f"[{MARKER}, {MARKER}]", "marker 3 is in it twice"),
        ("[]", "it has no markers"),
        ("[7]", "each of its markers needs an id"),
        (f"[{MARKER.replace('3', '-3')}]", "a marker has the id '-3'"),
        (f"[{MARKER.replace('id: 3', 'id: 70')}]", "marker 70 is not in 4X4_50, which has 50"),
        (f"[{MARKER.replace('0.16', '160')}]", "metres, not millimetres: 0.16"),
        (f"[{MARKER.replace(', length_m: 0.16', '')}]", "marker 3 has no length_m"),
        (f"[{MARKER.replace('0, 1]', '0, 2]')}]", "the quaternion of marker 3 has the length 2"),
        (f"[{MARKER.replace('[0, 0, 0]', '[0, .nan, 0]')}]", "position of marker 3 must be 3 num"),
        (f"[{MARKER.replace('quat_xyzw', 'quaternion')}]", "the unknown key 'quaternion'"),
        (
            "[{id: 1, corners: [[0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]]}]",
            "the corners of marker 1 are no square",
        ),
        (
            "[{id: 1, length_m: 0.1, corners: [[0, 1, 0], [1, 1, 0], [1, 0, 0], [0, 0, 0]]}]",
            "marker 1 has sides of 1 m by its corners, and a length_m of 0.1",
        ),
    ],
)
def test_a_wrong_map_is_refused_with_what_is_wrong(
    tmp_path: Path, markers: str, words: str
) -> None:
    with pytest.raises(SourceError, match="is no map of markers") as error:
        _read(tmp_path / "room.yaml", f"dictionary: 4X4_50\nmarkers: {markers}\n")
    assert words in str(error.value)


def test_a_table_of_two_worlds_or_without_sides_is_refused(tmp_path: Path) -> None:
    head = "segment,id,tx,ty,tz,qx,qy,qz,qw"
    rows = "0,1,0,0,0,0,0,0,1,0.16\n2,3,1,0,0,0,0,0,1,0.16\n"
    with pytest.raises(SourceError, match="frames of the segments 0, 2"):
        _read(tmp_path / "markers.csv", f"{head},length_m\n{rows}")
    with pytest.raises(SourceError, match="no column length_m"):
        _read(tmp_path / "markers.csv", f"{head}\n0,1,0,0,0,0,0,0,1\n")


def _room(
    rng: np.random.Generator, count: int, *, error_m: float = 0.0, metres: float = 1.0
) -> tuple[list[RegisteredMarker], dict[int, KnownMarker], Floats]:
    """Markers of a world whose metres are wrong by a factor, their map, and map_from_world."""
    map_from_world = make_transform(so3_exp(rng.normal(0, 1, 3)), rng.normal(0, 5, 3))
    placed, known = [], {}
    for number in range(count):
        pose = make_transform(so3_exp(rng.normal(0, 1, 3)), rng.uniform(-3, 3, 3))
        known[number] = KnownMarker(number, 0.16, map_from_world @ pose, 0.005)
        seen = pose.copy()
        seen[:3, :3] = so3_exp(rng.normal(0.0, error_m, 3)) @ pose[:3, :3]
        seen[:3, 3] = (pose[:3, 3] + rng.normal(0, error_m, 3)) / metres
        sigma = np.sqrt(3.0) * max(error_m, 1e-4)
        placed.append(RegisteredMarker(number, seen, sigma, 9, 0, 9, 1.0, sigma, 0.16))
    return placed, known, map_from_world


def test_an_exact_map_places_a_world_exactly() -> None:
    for count in (1, 2, 5):
        placed, known, expected = _room(np.random.default_rng(count), count)
        found = register_in_map(placed, known)
        np.testing.assert_allclose(found.map_from_world, expected, atol=1e-9)
        on_map = fit_map(placed, known, 0.01)
        assert not isinstance(on_map, str)
        assert on_map.scale == pytest.approx(1.0, abs=1e-9)
        assert on_map.used == tuple(range(count)) and not on_map.refused


def test_distances_in_the_map_say_more_than_the_sides_of_markers() -> None:
    errors, sigmas = [], []
    for seed in range(40):
        placed, known, _ = _room(np.random.default_rng(seed), 4, error_m=0.005, metres=1.015)
        found = fit_map(placed, known, 0.015)
        assert not isinstance(found, str)
        errors.append(np.log(found.scale / 1.015))
        sigmas.append(found.relative_sigma)
    assert np.sqrt(np.mean(np.square(errors))) < 0.003  # the sides were wrong by 1.5 %
    covered = np.abs(errors) < 1.96 * np.array(sigmas)
    assert covered.sum() >= 37 and np.mean(sigmas) < 0.006


def test_the_stated_sigma_of_the_place_covers_the_truth() -> None:
    inside = 0
    for seed in range(40):
        placed, known, expected = _room(np.random.default_rng(seed), 3, error_m=0.01)
        found = register_in_map(placed, known)
        turned = rotation_angle(found.map_from_world[:3, :3] @ expected[:3, :3].T)
        middle = np.append(np.mean([m.world_from_marker[:3, 3] for m in placed], axis=0), 1.0)
        off = np.linalg.norm(((found.map_from_world - expected) @ middle)[:3])
        inside += bool(off < 2.5 * found.sigma_m and turned < 2.5 * found.sigma_rad)
    assert inside >= 36


def test_a_moved_or_turned_marker_is_left_out_and_named() -> None:
    for seed in range(40):
        placed, known, _ = _room(np.random.default_rng(seed), 4, error_m=0.003)
        wrong = known[2].map_from_marker.copy()
        if seed % 2:
            wrong[:3, 3] += 0.3 * np.eye(3)[seed % 3]
        else:
            wrong[:3, :3] = wrong[:3, :3] @ so3_exp(np.array([0.0, 0.0, np.pi / 2]))
        known[2] = known[2]._replace(map_from_marker=wrong)
        found = fit_map(placed, known, 0.01)
        assert not isinstance(found, str), seed
        assert found.used == (0, 1, 3) and list(found.refused) == [2], seed


def test_no_marker_of_a_right_map_is_refused() -> None:
    """With errors of the path of 1 % of the distances, as drift makes them."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        placed, known, _ = _room(rng, 2 + seed % 5, error_m=0.01)
        bent = [
            marker._replace(
                world_from_marker=make_transform(
                    marker.world_from_marker[:3, :3],
                    marker.world_from_marker[:3, 3] * (1.0 + rng.normal(0, 0.007, 3)),
                )
            )
            for marker in placed
        ]
        found = fit_map(bent, known, 0.01)
        assert not isinstance(found, str) and not found.refused, seed


def test_contradictions_name_the_markers_or_the_unit() -> None:
    placed, known, _ = _room(np.random.default_rng(3), 2)
    wrong = known[1].map_from_marker.copy()
    wrong[:3, 3] += 1.0
    text = fit_map(placed, {**known, 1: known[1]._replace(map_from_marker=wrong)}, 0.01)
    assert isinstance(text, str) and "has markers 0 and 1 " in text and "was moved" in text
    turned = known[1].map_from_marker.copy()
    turned[:3, :3] = turned[:3, :3] @ so3_exp(np.array([0.0, 0.0, np.pi]))
    text = fit_map(placed, {**known, 1: known[1]._replace(map_from_marker=turned)}, 0.01)
    assert isinstance(text, str) and "turned to each other" in text
    placed, known, _ = _room(np.random.default_rng(4), 5, metres=0.001)
    text = fit_map(placed, known, 0.01)
    assert isinstance(text, str) and "are 0.001 times those by the sides" in text


def _run(folder: Path, output: Path, *words: str) -> dict[str, Any]:
    start = ["run", str(folder), "-o", str(output), "--config", "fast", "--json"]
    result = CliRunner().invoke(app, [*start, *words])
    assert result.exit_code == 0, result.output
    found = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def test_the_markers_of_one_run_are_the_map_of_the_next(with_marker: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    _run(with_marker, first, "--markers", "0.16", "--end", "20")
    (row,) = csv.DictReader((first / "markers.csv").read_text().splitlines())
    assert (row["dictionary"], row["length_m"]) == ("4X4_50", "0.16")
    words = ["--mode", "mono", "--start", "4", "--markers", str(first / "markers.csv")]
    summary = _run(with_marker, second, *words)
    assert summary["length_unit"] == "m" and summary["scales"][0]["source"] == "markers 7"
    (frame,) = summary["world_frames"]
    assert frame["name"] == str(first / "markers.csv") and frame["markers"] == [7]
    assert 0.0 < frame["sigma_m"] < 0.05 and 0.0 < frame["sigma_deg"] < 2.0
    earlier, later = (read_tum(each / "trajectory.tum") for each in (first, second))
    _, mine, theirs = np.intersect1d(
        later.stamps_ns, earlier.stamps_ns, return_indices=True, assume_unique=True
    )
    assert len(mine) >= 10
    off = np.linalg.norm(later.positions[mine] - earlier.positions[theirs], axis=1)
    assert off.max() < 0.03  # both are in the frame of the first run
    refused = CliRunner().invoke(
        app, ["run", str(with_marker), "-o", str(first), "--markers", str(first / "markers.csv")]
    )
    assert refused.exit_code == 1 and "is an input and would be replaced" in refused.stderr
    assert (first / "markers.csv").exists()


def test_a_run_without_the_markers_of_a_map_keeps_its_frame(
    with_marker: Path, tmp_path: Path
) -> None:
    known = tmp_path / "room.yaml"
    known.write_text(
        "dictionary: 4X4_50\nlength_m: 0.16\nmarkers:\n"
        "  - {id: 9, position: [5, 0, 0], quat_xyzw: [0, 0, 0, 1]}\n",
        encoding="utf-8",
    )
    output = tmp_path / "out"
    summary = _run(with_marker, output, "--markers", str(known), "--end", "15")
    warnings = " ".join(summary["warnings"])
    assert f"no marker of {known} was seen" in warnings
    assert f"markers that are not in {known} are left out: 7" in warnings
    assert f"segment 0 cannot be placed in {known}" in warnings
    assert "world_frames" not in summary
    first = read_tum(output / "trajectory.tum").world_from_cam[0]
    np.testing.assert_allclose(first, np.eye(4), atol=1e-9)
    wrong = CliRunner().invoke(
        app,
        ["run", str(with_marker), "-o", str(output), "--markers", str(known)]
        + ["--marker-dictionary", "5X5_50"],
    )
    assert "--marker-dictionary is 5X5_50, and" in wrong.stderr
    wrong = CliRunner().invoke(
        app,
        ["run", str(with_marker), "-o", str(output), "--markers", str(known)]
        + ["--world", "marker:9"],
    )
    assert "--world is the frame of the map of --markers" in wrong.stderr


def test_a_stereo_path_is_placed_in_the_map(
    with_marker: Path, hanging: Floats, tmp_path: Path
) -> None:
    position = ", ".join(f"{value:.9f}" for value in POSE[:3, 3])
    quat = ", ".join(f"{value:.9f}" for value in quat_xyzw_from_rotation(TURN))
    known = tmp_path / "room.yaml"
    known.write_text(
        "dictionary: 4X4_50\nlength_m: 0.16\nmarkers:\n"
        f"  - {{id: 7, position: [{position}], quat_xyzw: [{quat}]}}\n",
        encoding="utf-8",
    )
    output = tmp_path / "out"
    summary = _run(with_marker, output, "--markers", str(known), "--end", "15")
    assert summary["scales"] == [] and summary["world_frames"][0]["markers"] == [7]
    truth = read_tum(with_marker / "groundtruth.tum")
    map_from_truth = POSE @ inverse(truth.world_from_cam[len(truth) // 2] @ hanging)
    estimate = read_tum(output / "trajectory.tum")
    number = int(np.flatnonzero(truth.stamps_ns == estimate.stamps_ns[5])[0])
    expected = map_from_truth @ truth.world_from_cam[number]
    np.testing.assert_allclose(estimate.positions[5], expected[:3, 3], atol=0.02)
