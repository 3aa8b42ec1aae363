"""Depths that agree, clouds, meshes and grids: exact on exact depth of planes and spheres."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Floats, Floats32
from vo.tools.dense.agreement import confirmed
from vo.tools.dense.cloud import Cloud, CubeCloud
from vo.tools.dense.depth import _beside_holes, even_depth
from vo.tools.dense.files import write_cloud
from vo.tools.dense.ground import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, find_ground
from vo.tools.dense.posed_images import moving_mask, sharp, sharpness_of
from vo.tools.dense.surface import DistanceField
from vo.tools.dense.sweep import swept_depth

RIG = RectifiedRig(160, 120, 120.0, 120.0, 79.5, 59.5, 0.1, np.eye(4))
SIGMA = 0.002
SIGMAS = np.full((120, 160), SIGMA, np.float32)
GREY = np.full((120, 160, 3), 100, np.uint8)


def rays() -> Floats:
    """Rays (H, W, 3) with z = 1 of all pixels."""
    v, u = np.mgrid[:120, :160]
    return np.stack([(u - 79.5) / 120.0, (v - 59.5) / 120.0, np.ones(u.shape)], axis=-1)


def pose(rotation: tuple[float, ...], centre: tuple[float, ...]) -> Floats:
    return make_transform(so3_exp(np.array(rotation)), np.array(centre))


def plane_seen(world_from_cam: Floats, normal: Floats, distance: float) -> Floats32:
    """Inverse depth (H, W) of the plane normal . x = distance of the world."""
    direction = rays() @ world_from_cam[:3, :3].T
    inverse = direction @ normal / (distance - normal @ world_from_cam[:3, 3])
    return np.where(inverse > 0, inverse, 0).astype(np.float32)


POSES = [pose((0, 0.05 * k, 0.02 * k), (0.2 * k, 0.05 * k, 0.1 * k)) for k in range(-2, 3)]
NORMAL = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])


def test_depth_that_others_see_is_kept_and_what_they_look_through_is_not() -> None:
    maps = [even_depth(plane_seen(each, NORMAL, 3.0), SIGMA) for each in POSES]
    others = [(maps[k], POSES[k]) for k in (0, 1, 3, 4)]
    kept, _ = confirmed(maps[2], POSES[2], others, RIG.intrinsics, 1)
    assert np.count_nonzero(kept) > 0.95 * kept.size
    # The nearest pixel of another view is up to half a pixel away on the slanted plane.
    error = np.abs(kept - maps[2].inverse)[kept > 0]
    assert np.median(error) < 2e-4 and error.max() < SIGMA
    moved = maps[2].inverse.copy()
    moved[40:80, 60:100] = 1.0 / 1.8  # a thing that only this image shows
    kept, contradicted = confirmed(even_depth(moved, SIGMA), POSES[2], others, RIG.intrinsics, 1)
    assert not kept[40:80, 60:100].any() and np.mean(kept[:40] > 0) > 0.9
    hidden = moving_mask(contradicted) == 0
    assert hidden[42:78, 62:98].mean() > 0.9 and not hidden[:20].any()
    assert not confirmed(maps[2], POSES[2], [], RIG.intrinsics, 1)[0].any()
    assert not confirmed(maps[2], POSES[2], others[:1], RIG.intrinsics, 2)[0].any()


def test_points_and_normals_of_a_plane_are_exact() -> None:
    cubes = CubeCloud(0.05, RIG)
    for each in POSES:
        cubes.add(plane_seen(each, NORMAL, 3.0), SIGMAS, GREY, each)
    cloud = cubes.cloud()
    assert np.abs(cloud.xyz @ NORMAL - 3.0).max() < 1e-4
    assert (cloud.normal @ NORMAL).max() < -0.999  # towards the cameras
    assert (cloud.rgb == 100).all() and cloud.views.max() == 5
    cubes_seen = np.unique(np.floor(cloud.xyz / 0.05).astype(int), axis=0)
    assert len(cubes_seen) > 0.97 * len(cloud.xyz)  # one point for each cube


def test_no_depth_beside_a_wide_hole() -> None:
    known = np.ones((60, 80), bool)
    known[20:40, 30:50], known[5:9, 5:9] = (
        False,
        False,
    )  # one wider than a block and one that is not
    beside = _beside_holes(known)
    assert beside[18:42, 28:52].all() and beside.sum() == 24 * 24


def test_an_e57_file_has_the_bytes_of_its_points(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    xyz = np.random.default_rng(3).normal(size=(1000, 3))
    rgb, views = np.full((1000, 3), 80, np.uint8), np.ones(1000, np.int64)
    for name, shift in (("a", 0.0), ("b", 0.0), ("c", 1e-3)):
        write_cloud(tmp_path / f"{name}.e57", Cloud(xyz + shift, xyz, rgb, views), "in m")
    a, b, c = ((tmp_path / f"{name}.e57").read_bytes() for name in "abc")
    assert a == b and str(Path(pye57.__file__).parent).encode() not in a
    opened = [pye57.E57(str(tmp_path / f"{name}.e57")) for name in "abc"]
    assert len({str(each.root["guid"].value()) for each in opened}) == 2
    assert pye57.e57.uuid.uuid4() != pye57.e57.uuid.uuid4()  # as it was


def test_the_mesh_of_a_sphere_is_round_and_faces_the_cameras() -> None:
    centre, radius = np.array([0.0, 0.0, 3.0]), 0.8
    cubes, field = CubeCloud(0.04, RIG), DistanceField(0.04, RIG)
    for world_from_cam in POSES:
        direction = rays() @ world_from_cam[:3, :3].T
        to_centre = centre - world_from_cam[:3, 3]
        a, b = (direction**2).sum(-1), direction @ to_centre
        root = b**2 - a * (to_centre @ to_centre - radius**2)
        inverse = np.where(root > 0, a / (b - np.sqrt(np.maximum(root, 0))), 0).astype(np.float32)
        seen = cubes.add(inverse, SIGMAS, GREY, world_from_cam)
        field.add(inverse, GREY, world_from_cam, seen)
    mesh = field.mesh()
    error = np.abs(np.linalg.norm(mesh.vertices - centre, axis=1) - radius)
    assert len(mesh.triangles) > 1000 and np.median(error) < 0.004 and error.max() < 0.04
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = ((corners.mean(axis=1) - centre) * normal).sum(axis=1)
    assert (outward > 0).all()
    assert (mesh.rgb == 100).all()
    edges = np.concatenate([mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 1).all()  # neighbours go round in the same sense
    assert not len(DistanceField(0.04, RIG).mesh().triangles)


def texture() -> Floats32:
    random = np.random.default_rng(3)
    total = np.zeros((480, 640), np.float32)
    for cell in (3, 8, 20):
        coarse = random.uniform(0, 80, (480 // cell + 1, 640 // cell + 1)).astype(np.float32)
        total += cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    return total


def view_of_plane(world_from_cam: Floats, normal: Floats, distance: float) -> np.ndarray:
    """Image of a textured plane; its texture lies in the world's x and y."""
    inverse = plane_seen(world_from_cam, normal, distance)
    points = rays() / inverse[..., None] @ world_from_cam[:3, :3].T + world_from_cam[:3, 3]
    at = (points[..., :2] * 100.0 + (320, 240)).astype(np.float32)
    image = cv2.remap(texture(), at[..., 0], at[..., 1], cv2.INTER_CUBIC)
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("ahead", [False, True])
def test_a_plane_sweep_finds_the_depth_of_a_slanted_plane(ahead: bool) -> None:
    step = (0.03, 0.0, 0.3) if ahead else (0.2, 0.0, 0.0)
    poses = [pose((0, 0, 0), tuple(k * s for s in step)) for k in range(-2, 3)]
    seen = [(view_of_plane(each, NORMAL, 2.0), each) for each in poses]
    found = swept_depth(seen[2], seen[:2], seen[3:], RIG)
    known = found.inverse > 0
    assert known.mean() > (0.25 if ahead else 0.8)
    error = np.abs(found.inverse / plane_seen(poses[2], NORMAL, 2.0) - 1.0)[known]
    assert np.median(error) < 0.01 and np.percentile(error, 95) < 0.05
    if ahead:  # where the camera moves to, depth cannot be seen
        assert not known[55:65, 90:100].any()


def test_without_motion_or_texture_a_sweep_finds_nothing() -> None:
    image = view_of_plane(np.eye(4), NORMAL, 2.0)
    still = swept_depth((image, np.eye(4)), [(image, np.eye(4))], [(image, np.eye(4))], RIG)
    assert not still.inverse.any()
    plain = np.full((120, 160), 90, np.uint8)
    found = swept_depth((plain, POSES[2]), [(plain, POSES[1])], [(plain, POSES[3])], RIG)
    assert not found.inverse.any()
    assert not swept_depth((image, np.eye(4)), [], [], RIG).inverse.any()


def test_the_ground_is_the_floor_and_not_a_table() -> None:
    random = np.random.default_rng(5)
    tilt = so3_exp(np.array([0.05, 0.0, 0.03]))
    up = tilt @ (0.0, -1.0, 0.0)

    def flat(count: int, y: float, size: float) -> Floats:
        xz = random.uniform(-size, size, (count, 2))
        return np.column_stack([xz[:, 0], random.normal(y, 0.005, count), xz[:, 1]]) @ tilt.T

    xyz = np.concatenate([flat(4000, 1.2, 4.0), flat(1500, 0.5, 1.0), flat(60, 2.5, 4.0)])
    normal = np.tile(up, (len(xyz), 1))
    counts = np.ones(len(xyz), np.int64)
    cloud = Cloud(xyz, normal, np.zeros((len(xyz), 3), np.uint8), counts)
    poses = np.stack([pose((0, 0, 0), (0.1 * k, 0, 0)) for k in range(5)])
    ground = find_ground(cloud, np.array([0.0, -1.0, 0.0]), poses, 0.02)
    assert ground.is_found
    assert np.allclose(ground.ground_from_world[2, :3], up, atol=2e-3)
    first = ground.ground_from_world @ poses[0]
    assert np.allclose(first[:2, 3], 0.0, atol=1e-9) and abs(first[2, 3] - 1.2) < 0.01
    assert first[0, 2] > 0.99  # x is ahead
    few = Cloud(*(part[:20] for part in cloud))
    assert not find_ground(few, np.array([0.0, -1.0, 0.0]), poses, 0.02).is_found


def test_cells_are_free_as_far_as_a_wall_and_unknown_behind() -> None:
    grid = OccupancyGrid(np.array([0.0, -2.0]), np.array([4.0, 2.0]), 0.1, (0.2, 1.5))
    ground_from_cam = pose((0, 0, 0), (0.05, 0.05, 1.0))
    y = np.linspace(-1.0, 1.0, 400)
    wall = np.column_stack([np.full(400, 3.02), y, np.full(400, 1.0)])
    floor = np.column_stack([np.full(400, 2.0), y * 2.0 / 3.0, np.zeros(400)])
    lamp = np.column_stack([np.full(400, 1.0), y / 3.0, np.full(400, 2.0)])  # above the band
    columns = np.tile(np.arange(400), 3)
    for _ in range(3):
        grid.add(np.concatenate([wall, floor, lamp]), columns, ground_from_cam)
    cells, edge, origin = grid.grid()

    def at(x: float, y: float) -> int:
        row = cells.shape[0] - 1 - int(np.floor((y - origin[1]) / edge))
        return int(cells[row, int(np.floor((x - origin[0]) / edge))])

    assert (at(1.0, 0.05), at(2.5, 0.5), at(3.05, 0.0)) == (FREE, FREE, OCCUPIED)
    assert (at(3.5, 0.0), at(1.0, 1.5)) == (UNKNOWN, UNKNOWN)
    assert all(at(3.05, y) == OCCUPIED for y in np.arange(-0.95, 0.95, 0.05))


def test_images_blurred_beside_their_neighbours_are_left_out() -> None:
    assert sharp([100, 90, 30, 95, 110, 40, 38, 36, 35]) == [True, True, False, *6 * [True]]
    assert sharp([]) == []
    image = view_of_plane(np.eye(4), NORMAL, 2.0)
    weak = (0.5 * image).astype(np.uint8)
    values = [sharpness_of(each) for each in (image, weak, cv2.GaussianBlur(image, (0, 0), 2))]
    assert sharp(values) == [True, True, False]
