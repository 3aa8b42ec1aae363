"""The same six frames written in each layout."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import av
import bag_logs
import cv2
import mcap_logs
import numpy as np

from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation, se3_exp
from vo.base.types import Bytes, Camera, Floats
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    FrameTransform,
    ImageMessage,
    Message,
    PoseMessage,
    TransformsMessage,
)

WIDTH, HEIGHT = 64, 48
COUNT = 6
BASELINE_M = 0.12
INTRINSICS = [50.0, 51.0, 31.5, 23.5]
STAMPS_NS = [1_600_000_000_123_456_789 + i * 100_000_001 for i in range(COUNT)]
RECTIFIED_FROM_CAM0 = se3_exp(np.array([0.01, -0.02, 0.015, 0, 0, 0]))[:3, :3]
BODY_FROM_CAM0 = se3_exp(np.array([0.3, -1.2, 0.4, 0.05, 0.06, 0.02]))
CALIBRATION = f"""\
cam0: {{model: pinhole, resolution: [{WIDTH}, {HEIGHT}], intrinsics: {INTRINSICS}}}
baseline_m: {BASELINE_M}
"""


def image(index: int, right: bool = False) -> Bytes:
    """Noise whose top-left pixel is the number of the image."""
    pixels = np.random.default_rng(index).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    pixels[0, 0] = index + (100 if right else 0)
    return pixels


def write_image(path: Path, pixels: Bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def truth() -> list[Floats]:
    """world_from_cam0 of each frame."""
    return [se3_exp(np.array([0, 0.02 * i, 0, 0.1 * i, 0, 0.5 * i])) for i in range(COUNT)]


def tum_text(poses: list[Floats]) -> str:
    rows = [
        f"{seconds(stamp)} {' '.join(f'{v:.12f}' for v in (*p[:3, 3], *quat))}\n"
        for stamp, p in zip(STAMPS_NS, poses, strict=True)
        for quat in [quat_xyzw_from_rotation(p[:3, :3])]
    ]
    return "".join(rows)


def write_kitti(folder: Path) -> None:
    for i in range(COUNT):
        write_image(folder / "image_0" / f"{i:06d}.png", image(i))
        write_image(folder / "image_1" / f"{i:06d}.png", image(i, right=True))
    fx, fy, cx, cy = INTRINSICS
    p0 = f"{fx} 0 {cx} 0 0 {fy} {cy} 0 0 0 1 0"
    p1 = f"{fx} 0 {cx} {-fx * BASELINE_M} 0 {fy} {cy} 0 0 0 1 0"
    write_text(folder / "calib.txt", f"P0: {p0}\nP1: {p1}\n")
    write_text(folder / "times.txt", "".join(f"{seconds(s)}\n" for s in STAMPS_NS))
    rows = [" ".join(f"{v:.12e}" for v in pose[:3].ravel()) for pose in truth()]
    write_text(folder / "poses.txt", "\n".join(rows) + "\n")


def date(stamp_ns: int) -> str:
    moment = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{stamp_ns % 10**9:09d}"


def numbers(values: Iterable[float]) -> str:
    return " ".join(f"{v:.17e}" for v in values)


def calib_cam_to_cam() -> str:
    """Two rectified grey cameras, in a frame rotated like the world."""
    fx, fy, cx, cy = INTRINSICS
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for i in range(2):
        lines += [
            f"S_0{i}: 1.392000e+03 5.120000e+02",
            f"K_0{i}: {numbers([900, 0, 690, 0, 900, 240, 0, 0, 1])}",
            f"D_0{i}: {numbers([-0.3, 0.1, 0.001, 0.0005, -0.02])}",
            f"R_0{i}: {numbers(np.eye(3).ravel())}",
            f"T_0{i}: {numbers([-i * BASELINE_M, 0, 0])}",
            f"S_rect_0{i}: {numbers([WIDTH, HEIGHT])}",
            f"R_rect_0{i}: {numbers(RECTIFIED_FROM_CAM0.ravel())}",
            f"P_rect_0{i}: {numbers([fx, 0, cx, -i * fx * BASELINE_M, 0, fy, cy, 0, 0, 0, 1, 0])}",
        ]
    return "\n".join(lines) + "\n"


def rigid_text(transform: Floats) -> str:
    rotation, shift = numbers(transform[:3, :3].ravel()), numbers(transform[:3, 3])
    return f"calib_time: 25-May-2012 16:47:16\nR: {rotation}\nT: {shift}\n"


def write_kitti_raw(folder: Path) -> None:
    """The inertial unit is at the rectified left camera, the laser scanner elsewhere."""
    dates = "".join(f"{date(s)}\n" for s in STAMPS_NS)
    for camera in ("image_00", "image_01"):
        write_text(folder / camera / "timestamps.txt", dates)
        for i in range(COUNT):
            path = folder / camera / "data" / f"{i:010d}.png"
            write_image(path, image(i, camera == "image_01"))
    write_text(folder / "oxts" / "timestamps.txt", dates)
    for i, pose in enumerate(truth()):
        write_text(folder / "oxts" / "data" / f"{i:010d}.txt", oxts_record(pose))
    turn = np.eye(4)
    turn[:3, :3] = RECTIFIED_FROM_CAM0
    write_text(folder / "calib_cam_to_cam.txt", calib_cam_to_cam())
    write_text(folder / "calib_imu_to_velo.txt", rigid_text(BODY_FROM_CAM0))
    write_text(folder / "calib_velo_to_cam.txt", rigid_text(inverse(BODY_FROM_CAM0 @ turn)))


def oxts_record(world_from_imu: Floats) -> str:
    """Near the equator at Greenwich, where Mercator's scale is 1."""
    rotation, (x, y, z) = world_from_imu[:3, :3], world_from_imu[:3, 3]
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = math.asin(-rotation[2, 0])
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    latitude = math.degrees(math.atan(math.sinh(y / 6378137.0)))
    longitude = math.degrees(x / 6378137.0)
    return numbers([latitude, longitude, z, roll, pitch, yaw, *[0.0] * 24]) + "\n"


def sensor_yaml(body_from_camera: Floats) -> str:
    data = ", ".join(f"{v:.12f}" for v in body_from_camera.ravel())
    return (
        f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n"
        + f"resolution: [{WIDTH}, {HEIGHT}]\ncamera_model: pinhole\nintrinsics: {INTRINSICS}\n"
        + "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
    )


def write_euroc(folder: Path) -> None:
    root = folder / "mav0"
    cam0_from_cam1 = np.eye(4)
    cam0_from_cam1[0, 3] = BASELINE_M
    for camera, body_from_camera in (
        ("cam0", BODY_FROM_CAM0),
        ("cam1", BODY_FROM_CAM0 @ cam0_from_cam1),
    ):
        rows = "".join(f"{s},{s}.png\n" for s in STAMPS_NS)
        write_text(root / camera / "data.csv", f"#timestamp [ns],filename\n{rows}")
        write_text(root / camera / "sensor.yaml", sensor_yaml(body_from_camera))
        for i, stamp in enumerate(STAMPS_NS):
            write_image(root / camera / "data" / f"{stamp}.png", image(i, camera == "cam1"))
    header = "#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n"
    rows = ""
    for stamp, pose in zip(STAMPS_NS, truth(), strict=True):
        body = pose @ inverse(BODY_FROM_CAM0)
        x, y, z, w = quat_xyzw_from_rotation(body[:3, :3])
        rows += f"{stamp},{','.join(f'{v:.12f}' for v in (*body[:3, 3], w, x, y, z))}\n"
    write_text(root / "state_groundtruth_estimate0" / "data.csv", header + rows)


def write_four_seasons(folder: Path) -> None:
    fx, fy, cx, cy = INTRINSICS
    for n in range(2):
        for i, stamp in enumerate(STAMPS_NS):
            write_image(
                folder / "undistorted_images" / f"cam{n}" / f"{stamp}.png", image(i, n == 1)
            )
        text = f"Pinhole {fx} {fy} {cx} {cy} 0\n{WIDTH} {HEIGHT}\ncrop\n{WIDTH} {HEIGHT}\n"
        write_text(folder.parent / "calibration" / f"undistorted_calib_{n}.txt", text)
    stereo = f"1 0 0 {-BASELINE_M}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    write_text(folder.parent / "calibration" / "undistorted_calib_stereo.txt", stereo)
    write_text(folder / "times.txt", "".join(f"{s} {seconds(s)} 4.2\n" for s in STAMPS_NS))
    poses = [row.split()[1:] for row in tum_text(truth()).splitlines()]
    head = "# frame_id, t_x, t_y, t_z, q_x, q_y, q_z, q_w, scale, fusion_quality, v3\n"
    rows = [f"{s},{','.join(p)},1.01,0.9,0\n" for s, p in zip(STAMPS_NS, poses, strict=True)]
    write_text(folder / "GNSSPoses.txt", head + "".join(rows))


def write_tum(folder: Path) -> None:
    rows = "".join(f"{seconds(s)} rgb/{seconds(s)}.png\n" for s in STAMPS_NS)
    write_text(folder / "rgb.txt", f"# color images\n# timestamp filename\n{rows}")
    for i, stamp in enumerate(STAMPS_NS):
        write_image(folder / "rgb" / f"{seconds(stamp)}.png", image(i))
    write_text(folder / "groundtruth.txt", "# stamp tx ty tz qx qy qz qw\n" + tum_text(truth()))
    write_text(folder / "calibration.yaml", CALIBRATION)


def write_folder(folder: Path) -> None:
    for i in range(COUNT):
        write_image(folder / "left" / f"frame{i + 7}.png", image(i))
        write_image(folder / "right" / f"frame{i + 7}.png", image(i, right=True))
    write_text(folder / "times.txt", "".join(f"{seconds(s)}\n" for s in STAMPS_NS))
    write_text(folder / "groundtruth.tum", tum_text(truth()))
    write_text(folder / "calibration.yaml", CALIBRATION)


def write_nerf(folder: Path) -> None:
    """The camera's axes are y up and z back, and (0, 0) is a corner of the image."""
    fx, fy, cx, cy = INTRINSICS
    frames = []
    for i, pose in enumerate(truth()):
        name = f"images/frame_{i + 7}.png"
        write_image(folder / name, image(i))
        matrix = (pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()
        frames.append({"file_path": f"./{name}", "transform_matrix": matrix})
    values = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": WIDTH, "h": HEIGHT}
    write_text(folder / "transforms.json", json.dumps(values | {"frames": frames[::-1]}))
    write_text(folder / "times.txt", "".join(f"{seconds(s)}\n" for s in STAMPS_NS))


def write_glob(pattern: Path) -> None:
    for i, stamp in enumerate(STAMPS_NS):
        write_image(pattern.parent / f"left_{stamp}.png", image(i))
        write_image(pattern.parent / f"right_{stamp}.png", image(i, right=True))
    write_text(pattern.parent / "calibration.yaml", CALIBRATION)


def write_video(path: Path) -> None:
    """Lossless, with a time base that is fine enough for the stamps."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unit = Fraction(1, 10**9)
    with av.open(str(path), "w", options={"video_track_timescale": "1000000000"}) as container:
        stream = container.add_stream("png", rate=10)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "gray"
        stream.time_base = stream.codec_context.time_base = unit
        for i, stamp in enumerate(stamps("video")):
            frame = av.VideoFrame.from_ndarray(image(i), format="gray")
            frame.pts, frame.time_base = stamp, unit
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    write_text(path.with_suffix(".yaml"), CALIBRATION)


def write_stray(folder: Path) -> None:
    write_video(folder / "rgb.mp4")
    fx, fy, cx, cy = INTRINSICS
    write_text(folder / "camera_matrix.csv", f"{fx}, 0.0, {cx}\n0.0, {fy}, {cy}\n0.0, 0.0, 1.0")
    rows = [line.split() for line in tum_text(truth()).splitlines()]
    text = "".join(f"{', '.join([row[0], f'{n:06d}', *row[1:]])}\n" for n, row in enumerate(rows))
    head = "timestamp, frame, x, y, z, qx, qy, qz, qw\n"
    write_text(folder / "odometry.csv", head + text)


def log_messages(codec: str = "mono8") -> Iterator[tuple[str, Message]]:
    """The same frames as messages; `codec` is mono8 or png."""
    cam0_from_cam1 = np.eye(4)
    cam0_from_cam1[0, 3] = BASELINE_M
    body_from_cam0 = FrameTransform("body", "cam0", BODY_FROM_CAM0)
    fixed = (body_from_cam0, FrameTransform("cam0", "cam1", cam0_from_cam1))
    yield "/tf_static", TransformsMessage(STAMPS_NS[0], fixed)
    camera = Camera(WIDTH, HEIGHT, *INTRINSICS)
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    for i, (stamp, pose) in enumerate(zip(STAMPS_NS, truth(), strict=True)):
        yield "/truth", PoseMessage(stamp, "world", pose @ inverse(BODY_FROM_CAM0))
        for name in ("cam0", "cam1"):
            calibration = CalibrationMessage(stamp, name, camera, np.eye(3), projection)
            yield f"/{name}/camera_info", calibration
            pixels = image(i, right=name == "cam1")
            if codec == "mono8":
                message: Message = ImageMessage(stamp, name, WIDTH, HEIGHT, codec, pixels.tobytes())
                yield f"/{name}/image_raw", message
            else:
                data = cv2.imencode(f".{codec}", pixels)[1].tobytes()
                message = CompressedImageMessage(stamp, name, codec, data)
                yield f"/{name}/image_raw/compressed", message


def write_mcap(path: Path) -> None:
    mcap_logs.write_log(path, log_messages())


def stamps(kind: str) -> list[int]:
    """`STAMPS_NS` as read from a format: those of a video begin at 0."""
    return [stamp - STAMPS_NS[0] for stamp in STAMPS_NS] if kind == "video" else STAMPS_NS


def write_rosbag1(path: Path) -> None:
    bag_logs.write_bag1(path, log_messages())


def write_rosbag2(path: Path) -> None:
    bag_logs.write_bag2(path, log_messages())


PATHS = {
    "rosbag1": "rosbag1.bag",
    "rosbag2": "rosbag2",
    "glob": "glob/left_*.png",
    "video": "video.mov",
    "mcap": "mcap.mcap",
}
"""Paths of recordings other than a folder with the name of the format."""

WRITERS: dict[str, Callable[[Path], None]] = {
    "kitti": write_kitti,
    "kitti_raw": write_kitti_raw,
    "euroc": write_euroc,
    "4seasons": write_four_seasons,
    "tum": write_tum,
    "folder": write_folder,
    "nerf": write_nerf,
    "glob": write_glob,
    "video": write_video,
    "stray": write_stray,
    "mcap": write_mcap,
    "rosbag1": write_rosbag1,
    "rosbag2": write_rosbag2,
}
