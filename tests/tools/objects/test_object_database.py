"""Objects are found where they are, and nothing else is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from object_samples import CAMERA, SHAPE, WIDTH_M, corners, homography, pose, scene, stored

from data_synth.worlds import prints
from vo.base.errors import InputError
from vo.base.geometry.cameras import distort
from vo.base.geometry.transforms import rotation_angle
from vo.tools.objects.database import ObjectDatabase
from vo.tools.objects.tracks import overlap


@pytest.fixture(scope="module")
def database() -> ObjectDatabase:
    """Three objects of known width."""
    made = ObjectDatabase()
    for number in range(3):
        made.add(f"print{number}", [stored(number)], width_m=WIDTH_M)
    return made


@pytest.fixture(scope="module")
def large() -> ObjectDatabase:
    """More sides than are compared one by one."""
    made = ObjectDatabase()
    for number in range(16):
        made.add(f"print{number}", [stored(number)])
    return made


def test_an_object_has_its_outline_and_its_pose(database: ObjectDatabase) -> None:
    truth = pose(0.05, -0.02, 0.7, turn_deg=130.0, tilt_deg=30.0)
    (found,) = database.find(scene((0, truth)), CAMERA)
    assert found.name == "print0"
    assert found.confidence > 0.95
    assert np.abs(found.outline - corners(truth)).max() < 1.5
    estimate = found.cam_from_object
    assert estimate is not None
    assert np.linalg.norm(estimate[:3, 3] - truth[:3, 3]) < 0.01 * 0.7
    assert np.rad2deg(rotation_angle(estimate[:3, :3].T @ truth[:3, :3])) < 1.5


def test_instances_of_one_object_and_others_are_reported_once_each(
    database: ObjectDatabase,
) -> None:
    placed = [
        (0, pose(-0.2, -0.12, 0.9, 20.0)),
        (0, pose(0.2, -0.12, 0.9, 200.0, 20.0)),
        (1, pose(-0.18, 0.14, 0.9, -15.0)),
        (2, pose(0.2, 0.13, 0.9, 90.0)),
    ]
    found = database.find(scene(*placed))
    assert sorted(each.name for each in found) == ["print0", "print0", "print1", "print2"]
    for number, truth in placed:
        same = [each for each in found if each.name == f"print{number}"]
        assert max(overlap(each.outline, corners(truth)) for each in same) > 0.95


def test_a_part_of_an_object_is_enough(database: ObjectDatabase) -> None:
    truth = pose(0.0, 0.0, 0.5, 10.0)
    image = scene((1, truth))
    middle = int(corners(truth)[:, 0].mean()) - 20
    image[:, middle:] = scene(seed=3)[:, middle:]
    (found,) = database.find(image)
    assert found.name == "print1"
    assert overlap(found.outline, corners(truth)) > 0.9


def test_the_light_may_change(database: ObjectDatabase) -> None:
    truth = pose(0.0, 0.0, 0.7, 40.0)
    ramp = np.linspace(0.15, 0.9, CAMERA.width)[None, :]
    image = np.rint(scene((2, truth)) * ramp + 10.0).astype(np.uint8)
    (found,) = database.find(image)
    assert found.name == "print2"
    assert overlap(found.outline, corners(truth)) > 0.95


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_found_where_there_is_nothing(database: ObjectDatabase, seed: int) -> None:
    assert database.find(scene((10 + seed, pose(0, 0, 0.6, 20.0)), seed=seed)) == []


def test_a_blank_image_has_no_object(database: ObjectDatabase) -> None:
    assert database.find(np.full((480, 640), 128, np.uint8)) == []


def test_a_mirrored_object_is_another_one(database: ObjectDatabase) -> None:
    image = np.ascontiguousarray(scene((0, pose(0, 0, 0.6)))[:, ::-1])
    assert database.find(image) == []


def test_a_lens_with_distortion(database: ObjectDatabase) -> None:
    lens = replace(CAMERA, distortion_model="radtan", distortion=(-0.3, 0.08, 0.0, 0.0))
    truth = pose(0.12, -0.06, 0.6, 25.0)
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float32)
    pixels = np.stack([u, v], axis=2).reshape(-1, 1, 2)
    coefficients = np.array(lens.distortion)
    ideal = cv2.undistortPoints(pixels, CAMERA.matrix, coefficients, P=CAMERA.matrix)
    ideal = ideal.reshape(CAMERA.height, CAMERA.width, 2).astype(np.float32)
    image = cv2.remap(scene((0, truth)), ideal, None, cv2.INTER_LINEAR)
    (found,) = database.find(np.asarray(image, dtype=np.uint8), lens)
    assert found.cam_from_object is not None
    assert np.linalg.norm(found.cam_from_object[:3, 3] - truth[:3, 3]) < 0.01 * 0.6
    rays = (corners(truth) - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy)
    assert np.abs(found.outline - distort(lens, rays)).max() < 2.0


def test_the_same_image_gives_the_same_bits(database: ObjectDatabase) -> None:
    image = scene((0, pose(0, 0, 0.9, 70.0)), (1, pose(0.25, 0.1, 0.9)))
    first, second = database.find(image, CAMERA), database.find(image, CAMERA)
    assert [each.outline.tobytes() for each in first] == [e.outline.tobytes() for e in second]
    assert [each.confidence for each in first] == [each.confidence for each in second]


def test_further_images_show_the_same_side_or_another_one() -> None:
    truth = pose(0.0, 0.0, 0.45, 0.0, 35.0)
    seen = scene((0, truth))
    left, top = np.floor(corners(truth).min(axis=0)).astype(int)
    right, bottom = np.ceil(corners(truth).max(axis=0)).astype(int)
    database = ObjectDatabase()
    slanted = np.ascontiguousarray(seen[top:bottom, left:right])
    added = database.add("box", [stored(0), slanted, stored(1)], width_m=WIDTH_M)
    assert added.images == 3
    assert len(added.parts) == 2
    assert len(added.parts[0].xy) > len(added.parts[1].xy)
    (found,) = database.find(scene((1, pose(0, 0, 0.7, 30.0))), CAMERA)
    assert (found.name, found.part) == ("box", 1)
    assert found.cam_from_object is None  # the width of this side is not known


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.full((200, 200), 128, np.uint8), "too little texture"),
        (np.kron(np.indices((12, 12)).sum(axis=0) % 2, np.full((20, 20), 200)), "repeats"),
        (stored(0)[:40], "240x40 pixels; an object needs at least 48"),
    ],
    ids=["blank", "chessboard", "small"],
)
def test_what_cannot_be_recognised_is_refused(image: np.ndarray, reason: str) -> None:
    database = ObjectDatabase()
    with pytest.raises(InputError, match=reason):
        database.add("thing", [image.astype(np.uint8)], image_names=["thing.png"])
    assert len(database) == 0


@pytest.mark.parametrize(
    ("name", "width_m", "reason"),
    [
        ("print0", None, "there is an object 'print0' already"),
        ("", None, "is empty"),
        ("a\nb", None, "control characters"),
        ("new", 210.0, "the width is 210 m; give metres"),
        ("new", float("nan"), "the width is nan m"),
    ],
)
def test_unusable_names_and_widths_are_refused(
    database: ObjectDatabase, name: str, width_m: float | None, reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        database.add(name, [stored(5)], width_m=width_m)
    assert len(database) == 3


def test_a_removed_object_is_not_found() -> None:
    database = ObjectDatabase()
    database.add("print0", [stored(0)])
    database.add("print1", [stored(1)])
    database.remove("print0")
    assert database.find(scene((0, pose(0, 0, 0.6)))) == []
    with pytest.raises(InputError, match="no object 'print0' in the database; there are: print1"):
        database.remove("print0")
    database.remove("print1")
    with pytest.raises(InputError, match="has no objects"):
        database.find(scene())


def test_a_large_database_is_searched_by_its_index(large: ObjectDatabase) -> None:
    for number in (3, 13):
        (found,) = large.find(scene((number, pose(0, 0, 0.8, 50.0, 25.0))))
        assert found.name == f"print{number}"


def test_any_number_of_threads_gives_the_same_bits(large: ObjectDatabase) -> None:
    image = scene((3, pose(-0.15, 0, 0.9, 70.0)), (3, pose(0.2, -0.1, 1.0)), (8, pose(0.2, 0.1, 1)))
    before = large.threads, cv2.getNumThreads()
    results = []
    try:
        for threads in (1, 2, 5):
            large.threads = threads
            cv2.setNumThreads(threads)
            results.append(
                [(e.name, e.confidence, e.homography.tobytes()) for e, _ in large.evidence(image)]
            )
    finally:
        large.threads = before[0]
        cv2.setNumThreads(before[1])
    assert {name for name, *_ in results[0]} >= {"print3", "print8"}
    assert results[0] == results[1] == results[2]


def test_binary_features_recognise_too(tmp_path: Path) -> None:
    database = ObjectDatabase("orb")
    database.add("print0", [stored(0)])
    database.save(tmp_path / "orb.vodb")
    truth = pose(0, 0, 0.6, 30.0)
    (found,) = ObjectDatabase.load(tmp_path / "orb.vodb").find(scene((0, truth)))
    assert overlap(found.outline, corners(truth)) > 0.95
    assert stored(0).shape == SHAPE


def test_a_small_and_pale_object_among_much_print(database: ObjectDatabase) -> None:
    """Thousands of stronger features of other things do not use up those of the object."""
    rng = np.random.default_rng(0)
    notices = [[prints.notices(rng, (160, 160)) for _ in range(8)] for _ in range(6)]
    canvas = 255.0 * np.block(notices)
    matrix = homography(pose(0.3, 0.2, 1.0, 40.0, 20.0))
    size = canvas.shape[1::-1]
    image = 0.4 * cv2.warpPerspective(stored(0).astype(np.float32), matrix, size) + 60.0
    mask = cv2.warpPerspective(np.ones(SHAPE, np.float32), matrix, size)
    canvas = mask * image + (1.0 - mask) * canvas + rng.normal(0.0, 2.0, canvas.shape)
    (found,) = database.find(np.clip(np.rint(canvas), 0, 255).astype(np.uint8))
    assert found.name == "print0"
    assert overlap(found.outline, corners(pose(0.3, 0.2, 1.0, 40.0, 20.0))) > 0.9
