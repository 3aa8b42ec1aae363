"""The files that README and the pages name, small: their commands run on them as they stand."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
from board_images import poses_around, render

import vo
from vo.base.geometry.geodesy import geodetic_from_enu
from vo.base.types import Camera
from vo.tools.calibrating.board import make_board
from vo.tools.markers.patterns import marker_cells

# Recordings in folders, of two cameras.
WALKS = ("SOURCE", "my_sequence", "drive", "around_the_block", "monday", "tuesday", "wednesday")
LOGS = (
    "walk.mcap",
    "survey.mcap",
    "log.mcap",
    "drive.mcap",
    "logs/2026-01/a.mcap",
    "logs/2026-02/b.mcap",
)
_BOARD_CAMERA = Camera(400, 250, 230.0, 229.0, 202.0, 123.0)  # of the size of the walk
_CUBE = "".join(
    f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)
) + "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\n"  # fmt: skip


def make_files(walk: Path, folder: Path) -> None:
    """All of them; `walk`: thirty stereo frames with ground truth and an inertial sensor."""
    for name in (*WALKS, "flight", "walk", "recordings/a", "recordings/b", "moved/recording"):
        shutil.copytree(walk, folder / name)
    for name in ("drives/a", "drives/b", "bucket/a", "new_drive"):
        shutil.copytree(walk, folder / name)
    recording = vo.open(walk)
    shutil.copy(walk / "groundtruth.tum", folder / "truth.tum")
    shutil.copy(walk / "groundtruth.tum", folder / "groundtruth.tum")
    vo.convert(walk, folder / "log.mcap")
    for name in LOGS:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if name != "log.mcap":
            shutil.copy(folder / "log.mcap", folder / name)
    vo.convert(walk, folder / "kitti" / "06", to="kitti")
    vo.convert(walk, folder / "dataset" / "sequences" / "06", to="kitti")
    desk = {"to": "tum", "depth": True, "mono": True, "seconds": 1.0}
    vo.synth(folder / "freiburg1_desk", "demo", overrides=["scale=0.25", "motion=handheld"], **desk)  # type: ignore[arg-type]
    shutil.copy(folder / "freiburg1_desk" / "calibration.yaml", folder / "fr1.yaml")
    shutil.copytree(walk, folder / "EuRoC" / "MH_01_easy")
    (folder / "drives.csv").write_text("source,name\ndrives/a,first\ndrives/b,second\n")
    for name in ("camera.yaml", "calibration.yaml", "my_calibration.yaml"):
        vo.write_calibration(folder / name, vo.Rig(recording.rig.cam0))
    vo.batch([folder / "drives" / "a"], folder / "results" / "v1", "fast", jobs=1)
    shutil.copytree(folder / "results" / "v1", folder / "results" / "v2")
    vo.run(folder / "SOURCE", folder / "mapped", "fast", save_map=folder / "A")
    shutil.copy(folder / "A", folder / "B")
    _photos(folder, [frame.image0 for frame in recording.frames(0, 13)])
    _boards(folder)
    _positions(walk, folder)
    (folder / "statue.obj").write_text(_CUBE)
    for name, mode in (("mono", "mono"), ("stereo", "stereo"), ("mine", "stereo"), ("", "auto")):
        vo.run(folder / "SOURCE", folder / "out" / name, "fast", mode=mode)  # type: ignore[arg-type]


def _photos(folder: Path, images: list[np.ndarray]) -> None:  # type: ignore[type-arg]
    height, width = images[0].shape
    names = ("photo.jpg", "a.png", "front.png", "tea.jpg")
    for name in names:
        cv2.imwrite(str(folder / name), images[0])
    seen = images[0].copy()
    cell = np.pad(marker_cells("APRILTAG_36H11", 7), 1, constant_values=255)
    seen[60:140, 60:140] = cv2.GaussianBlur(np.kron(cell, np.ones((8, 8), np.uint8)), (0, 0), 0.6)
    cv2.imwrite(str(folder / "photo.jpg"), seen)
    for name in ("b.png", "back.png"):
        cv2.imwrite(str(folder / name), images[4])
    cv2.imwrite(str(folder / "desk.jpg"), images[2])
    (folder / "photos").mkdir()
    for number in (0, 4, 8):
        cv2.imwrite(str(folder / "photos" / f"{number}.png"), images[number])
    plane = np.array([[0.98, 0.03, 5.0], [-0.02, 0.97, 4.0], [1e-5, 0.0, 1.0]])
    warped = cv2.warpPerspective(images[0], plane, (width, height))
    (folder / "v_boat").mkdir()
    for place, first, second in (("", "1.ppm", "2.ppm"), ("v_boat/", "1.ppm", "2.ppm")):
        for name, image in ((first, images[0]), (second, warped)):
            cv2.imwrite(str(folder / f"{place}{name}"), cv2.merge([image] * 3))
        np.savetxt(folder / f"{place}H_1_2", plane)
    for name in ("left.png", "right.png"):
        mask = np.full((height, width), 255, np.uint8)
        mask[-20:] = 0
        cv2.imwrite(str(folder / name), mask)


def _boards(folder: Path) -> None:
    kinds = {"board.mkv": ("chessboard", 0.025), "board": ("charuco", 0.025)}
    for name, (kind, side) in kinds.items():
        board = make_board(kind, 9, 6, side)
        images = [render(board, _BOARD_CAMERA, p) for p in poses_around(board, _BOARD_CAMERA, 12)]
        if name == "board":
            for number, image in enumerate(images):
                (folder / name).mkdir(exist_ok=True)
                cv2.imwrite(str(folder / name / f"{number:02}.png"), image)
            vo.write_calibration(folder / "placeholder.yaml", vo.Rig(_BOARD_CAMERA))
            vo.convert(
                folder / name, folder / "board.mcap", calibration=folder / "placeholder.yaml"
            )
            continue
        code = cv2.VideoWriter.fourcc(*"MJPG")
        with_video = cv2.VideoWriter(str(folder / name), code, 10.0, (400, 250), isColor=False)
        for image in images:
            with_video.write(image)
        with_video.release()


def _positions(walk: Path, folder: Path) -> None:
    """The way of the camera, as GPS and as wheel odometry would have it."""
    path = vo.read_trajectory(walk / "groundtruth.tum")
    east_north_up = path.positions[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    places = geodetic_from_enu(east_north_up, np.array([49.0, 8.4, 110.0]))
    lines = [
        f"{s},{a:.10f},{b:.10f},{c:.4f}"
        for s, (a, b, c) in zip(path.stamps_ns, places, strict=True)
    ]
    (folder / "gps.csv").write_text("\n".join(["stamp_ns,lat,lon,alt", *lines, ""]))
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    speeds = steps / np.diff(path.stamps_ns * 1e-9)
    rows = [f"{s},{v:.4f},0.0" for s, v in zip(path.stamps_ns[1:], speeds, strict=True)]
    (folder / "wheels.csv").write_text("\n".join(["stamp_ns,speed,yaw_rate", *rows, ""]))
