"""Two copies of the same room: odometry or ambiguity must tell that they are two."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from room_course import run_rounds

from vo.base.config import load_config
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Descriptors
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.loop_verification.loop_verifier import LoopVerifier
from vo.engine.loop_verification.screening import Screening
from vo.engine.maps.map_file import MapFile
from vo.engine.memory.recognition import Recogniser
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Loop, Place, PlaceKey, RegisteredKeyframes
from vo.engine.places.vocabulary_file import built_in_vocabulary

FIRST_ROUND, SECOND_ROUND = 115, 135  # its last frame, and the first one of the next round
CORRIDOR = 8  # keyframes
DOUBTED = 5  # keyframe of the second round before which the motion is doubted
APART = 30.0  # of the two rooms, in units of the map: some ten times the size of a room


@pytest.fixture(scope="module")
def places(
    rounds: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[Place], list[Place], Camera]:
    """All keyframes of the first round through a room and of the second one, and their camera."""
    folder = tmp_path_factory.mktemp("places")
    with pytest.MonkeyPatch.context() as patch:
        # Places are made also of keyframes that show nothing new.
        patch.setattr("vo.engine.memory.place_maker._MAX_KNOWN", 2.0)
        run_rounds(rounds, folder / "out", save_map=folder / "room.map")
    with closing(MapFile(folder / "room.map")) as file:
        stored = sorted((file.place(key) for key in file.keys), key=lambda place: place.key)
        first = [place for place in stored if place.frame.index <= FIRST_ROUND]
        second = [place for place in stored if place.frame.index >= SECOND_ROUND]
        return first, second, file.header.camera


def _elsewhere(places: Sequence[Place], visit: int, segment: int, apart: float) -> list[Place]:
    """The keyframes as of a later visit to a copy of the room."""
    motion = make_transform(np.eye(3), np.array([apart, 0.0, 0.0]))
    return [
        replace(
            place,
            key=PlaceKey(0, place.key.keyframe + 1000 * visit),
            frame=replace(
                place.frame,
                index=place.frame.index + 1000 * visit,
                stamp_ns=place.frame.stamp_ns + visit * 100_000_000_000,
                segment=segment,
            ),
            odom_from_cam=motion @ place.odom_from_cam,
            landmarks=replace(place.landmarks, id=place.landmarks.id + 100_000 * visit),
        )
        for place in places
    ]


def _corridor(places: Sequence[Place], visit: int) -> list[Place]:
    """Keyframes on the way to the copy, which look like nothing else."""
    random = np.random.default_rng(visit)

    def other(descriptor: Descriptors) -> Descriptors:
        return random.integers(0, 256, descriptor.shape, dtype=np.uint8)

    return [
        replace(
            place,
            descriptor=other(place.descriptor),
            landmarks=replace(place.landmarks, descriptor=other(place.landmarks.descriptor)),
        )
        for step in range(CORRIDOR)
        for place in _elsewhere(places[step : step + 1], visit, 0, APART * step / CORRIDOR)
    ]


def _placed(
    places: Sequence[Place], camera: Camera, *, by_images: bool = True
) -> tuple[RegisteredKeyframes, int]:
    """Where the pose graph has the keyframes, and the number of its loops."""
    scale_factor = load_config("default").features.scale_factor
    graph, loops = PoseGraph(), list[Loop]()
    with KeyframeDatabase(built_in_vocabulary()) as database:
        screening = Screening(database.vocabulary, scale_factor)
        verifier = LoopVerifier(scale_factor)
        recogniser = Recogniser(database, lambda: (screening, verifier), camera, threads=1)
        for place in places:
            recognised = recogniser.add(place).result()
            graph.add_keyframe(place)
            loops += recognised.loops
            graph.remove_keyframes(recognised.removed, loops)
        graph.submit(loops)
        registered = graph.result(recogniser.unconfirmed) if by_images else graph.result()
        return registered, len(loops)


def test_a_walk_between_two_copies_of_a_room_closes_no_loop(
    places: tuple[list[Place], list[Place], Camera],
) -> None:
    first, second, camera = places
    same, count = _placed([*first, *_elsewhere(second, 1, 0, 0.0)], camera)
    assert count >= 3 and not same.rejected
    way = _corridor(first, 1)
    copy, count = _placed([*first, *way, *_elsewhere(second, 2, 0, APART)], camera)
    assert len(copy.rejected) == count >= 3  # the images are the same, only odometry differs


def _with_wrong_motion(places: Sequence[Place], *, is_doubted: bool) -> list[Place]:
    """The keyframes with odometry that was wrong by 20 degrees before the first of them."""
    angle = np.radians(20.0)
    turn = np.array(
        [[np.cos(angle), 0.0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    at = places[0].odom_from_cam
    wrong = at @ make_transform(turn, np.zeros(3)) @ inverse(at)
    return [
        replace(place, odom_from_cam=wrong @ place.odom_from_cam, is_doubted=is_doubted and n == 0)
        for n, place in enumerate(places)
    ]


def _is_first_left(
    wrong: Sequence[PlaceKey], places: Sequence[Place], registered: RegisteredKeyframes
) -> bool:
    """Whether the motion to the first keyframe that was not removed as redundant is wrong."""
    left = [place.key for place in places if place.key in registered.keys]
    return tuple(wrong) == (left[0],)


def test_loops_mend_a_wrong_motion_only_where_it_is_doubted(
    places: tuple[list[Place], list[Place], Camera],
) -> None:
    first, second, camera = places
    second = _elsewhere(second, 1, 0, 0.0)
    before, after = [*first, *second[:DOUBTED]], second[DOUBTED:]
    right, count = _placed([*first, *second], camera)
    stays, _ = _placed([*before, *_with_wrong_motion(after, is_doubted=False)], camera)
    assert len(stays.rejected) >= 3 and not stays.wrong
    mended, _ = _placed([*before, *_with_wrong_motion(after, is_doubted=True)], camera)
    assert _is_first_left(mended.wrong, after, mended) and not mended.rejected
    size = np.ptp(right.world_from_cam[:, :3, 3], axis=0).max()
    both = [key for key in mended.keys if key in right.keys]
    positions = (
        registered.world_from_cam[[registered.keys.index(key) for key in both], :3, 3]
        for registered in (mended, right)
    )
    apart = np.subtract(*positions)
    assert len(both) > 20
    assert np.linalg.norm(apart, axis=1).max() < 0.02 * size


def test_a_copy_behind_a_doubted_motion_is_refused_by_the_images_beside_it(
    places: tuple[list[Place], list[Place], Camera],
) -> None:
    first, second, camera = places
    copy = _with_wrong_motion(_elsewhere(second, 1, 0, 0.0), is_doubted=False)
    trusted, count = _placed([*first, *copy], camera)
    assert len(trusted.rejected) == count  # odometry is right, and this is another place
    copy[DOUBTED] = replace(copy[DOUBTED], is_doubted=True)
    free, _ = _placed([*first, *copy], camera, by_images=False)
    assert _is_first_left(free.wrong, copy[DOUBTED:], free)
    checked, _ = _placed([*first, *copy], camera)
    assert not checked.wrong and len(checked.rejected) == count
    np.testing.assert_array_equal(checked.world_from_cam, trusted.world_from_cam)


def test_a_doubted_motion_between_two_copies_that_were_seen_closes_no_loop(
    places: tuple[list[Place], list[Place], Camera],
) -> None:
    first, second, camera = places
    copy = [*_corridor(first, 1), *_elsewhere(first, 2, 0, APART)]
    again = _elsewhere(second, 3, 0, APART / 2)  # by odometry in neither of them
    again[0] = replace(again[0], is_doubted=True)
    registered, count = _placed([*first, *copy, *again], camera)
    assert len(registered.rejected) == count >= 6 and not registered.wrong


def test_a_lost_camera_in_one_of_two_copies_is_not_merged_with_either(
    places: tuple[list[Place], list[Place], Camera],
) -> None:
    first, second, camera = places
    lost = _elsewhere(second, 3, 1, 0.0)
    alone, _ = _placed([*first, *lost], camera)
    assert set(alone.world.tolist()) == {0}
    copy = [*_corridor(first, 1), *_elsewhere(first, 2, 0, APART)]
    both, _ = _placed([*first, *copy, *lost], camera)
    assert set(both.world.tolist()) == {0, 1}
