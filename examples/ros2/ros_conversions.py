"""Conversions between ROS 2 messages and `vo`: images, cameras, poses and covariances.

`a_from_b` takes coordinates in frame b to frame a, as a (4, 4) array.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import vo

NS_PER_S = 1_000_000_000
UNKNOWN_VARIANCE = 1e4  # m² and rad²: filters such as robot_localization ignore the pose then
# Of the single frame against the map, which `vo` does not estimate: 1 mm and 0.03 degrees. Filters
# refuse covariances of zero, as the first keyframe has.
FRAME_VARIANCE = np.array([1e-6] * 3 + [2.5e-7] * 3)

# From a camera's axes (x right, y down, z forward) to those of a robot (x forward, y left, z up),
# as REP 103 has them.
ROBOT_FROM_OPTICAL = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
_CHANNELS = {"mono8": 1, "8uc1": 1, "bgr8": 3, "8uc3": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
_DISTORTION = {"": "radtan", "plumb_bob": "radtan", "rational_polynomial": "radtan"} | {
    "equidistant": "equidistant"
}


def stamp_ns(message: Any) -> int:
    """The stamp of a message's header in nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def image_array(message: Any) -> np.ndarray:
    """The (H, W) grey or (H, W, 3) blue-green-red image of a `sensor_msgs/Image`.

    Raises:
        vo.VoError: the encoding is not one of those with 8 bits per channel.
    """
    name = message.encoding.lower()
    channels = _CHANNELS.get(name)
    if channels is None:
        raise vo.VoError(
            f"images are encoded as {message.encoding}; convert them to mono8, for example with "
            "image_proc"
        )
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    if channels == 1:
        return pixels[:, :, 0]
    bgr = pixels[:, :, 2::-1] if name.startswith("rgb") else pixels[:, :, :3]
    return np.ascontiguousarray(bgr)


def rig_from_camera_info(left: Any, right: Any | None, *, rectified: bool) -> vo.Rig:
    """The cameras of `sensor_msgs/CameraInfo` messages.

    Args:
        left: of the left, or only, camera.
        right: of the right camera, or None.
        rectified: whether the images are rectified (`image_rect`), not as they were taken.

    Raises:
        vo.VoError: a camera is not calibrated, its images are cropped or binned, its lens model has
            no counterpart, or the baseline is missing.
    """
    cam0 = _camera(left, rectified=rectified)
    if right is None:
        return vo.Rig(cam0)
    # P = K' [I | t] of the rectified cameras, which R turns the real ones into.
    shift = np.eye(4)
    shift[0, 3] = right.p[3] / right.p[0] - left.p[3] / left.p[0]
    if shift[0, 3] >= 0.0:
        raise vo.VoError(
            f"the P of the right camera_info has {right.p[3]:g} in its last column, where minus "
            "the focal length times the baseline belongs; calibrate the pair, or give a "
            "calibration file"
        )
    turns = [np.eye(4), np.eye(4)]
    if not rectified:
        for turn, info in zip(turns, (left, right), strict=True):
            turn[:3, :3] = np.reshape(info.r, (3, 3))
    return vo.Rig(cam0, _camera(right, rectified=rectified), turns[1].T @ shift @ turns[0])


def _camera(info: Any, *, rectified: bool) -> vo.Camera:
    name = info.header.frame_id
    if not info.k[0]:
        raise vo.VoError(f"the camera_info of {name} is empty; calibrate the camera")
    roi = info.roi
    if info.binning_x > 1 or info.binning_y > 1 or roi.x_offset or roi.y_offset:
        raise vo.VoError(f"the images of {name} are binned or cropped; give a calibration file")
    model = _DISTORTION.get(info.distortion_model.lower())
    if model is None:
        raise vo.VoError(
            f"the lens model of {name} is {info.distortion_model}; give a calibration file"
        )
    matrix = np.reshape(info.p, (3, 4))[:, :3] if rectified else np.reshape(info.k, (3, 3))
    distortion = () if rectified or not any(info.d) else tuple(float(each) for each in info.d)
    return vo.Camera(
        width=int(info.width),
        height=int(info.height),
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion_model=model if distortion else "none",
        distortion=distortion,
    )


def odom_from_base(world_from_cam0: np.ndarray, base_from_cam0: np.ndarray) -> np.ndarray:
    """Pose of the robot in the odom frame, which is the robot's own frame at the start.

    The world of `vo` is cam0 at the start.
    """
    return base_from_cam0 @ world_from_cam0 @ inverse(base_from_cam0)


def pose_covariance(
    keyframe: vo.KeyframePose | None, world_from_cam0: np.ndarray, base_from_cam0: np.ndarray
) -> np.ndarray:
    """Covariance (6, 6) of `nav_msgs/Odometry`: x y z and rotations about x y z, odom's axes.

    `vo` gives that of xi = (rotation, translation) in the frame of the keyframe's camera, with true
    = estimated * exp(xi). The adjoint of a transform takes xi to another frame (Sola et al., "A
    micro Lie theory for state estimation in robotics", 2018, eq. 31 and 175).

    Args:
        keyframe: the newest keyframe with a known covariance, or None.
        world_from_cam0: pose of the frame, which moves rigidly with the keyframe.
        base_from_cam0: pose of the camera on the robot.
    """
    if keyframe is None or keyframe.covariance is None:
        return np.eye(6) * UNKNOWN_VARIANCE
    base_from_keyframe = base_from_cam0 @ inverse(world_from_cam0) @ keyframe.world_from_cam0
    turn = odom_from_base(world_from_cam0, base_from_cam0)[:3, :3]
    to_odom = np.kron(np.eye(2), turn) @ _adjoint(base_from_keyframe)
    rotation_first = to_odom @ keyframe.covariance @ to_odom.T
    order = [3, 4, 5, 0, 1, 2]
    return rotation_first[np.ix_(order, order)] + np.diag(FRAME_VARIANCE)


def body_twist(
    before: np.ndarray, now: np.ndarray, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean linear and angular velocity between two poses of the robot, in its own axes."""
    turn = now[:3, :3].T
    linear = turn @ (now[:3, 3] - before[:3, 3]) / seconds
    return linear, rotation_vector(before[:3, :3].T @ now[:3, :3]) / seconds


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle of a rotation (3, 3) below 180 degrees."""
    skew = rotation - rotation.T
    axis_sine = 0.5 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    sine = float(np.linalg.norm(axis_sine))
    angle = np.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0))
    return axis_sine * (angle / sine if sine > 1e-12 else 1.0)


def matrix_of_transform(transform: Any) -> np.ndarray:
    """The (4, 4) array of a `geometry_msgs/Transform`."""
    q, t = transform.rotation, transform.translation
    x, y, z, w = np.array([q.x, q.y, q.z, q.w]) / np.linalg.norm([q.x, q.y, q.z, q.w])
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = t.x, t.y, t.z
    return matrix


def inverse(a_from_b: np.ndarray) -> np.ndarray:
    """b_from_a."""
    result = np.eye(4)
    result[:3, :3] = a_from_b[:3, :3].T
    result[:3, 3] = -a_from_b[:3, :3].T @ a_from_b[:3, 3]
    return result


def _adjoint(a_from_b: np.ndarray) -> np.ndarray:
    """Takes a tangent (rotation, translation) in frame b to frame a."""
    turn, (x, y, z) = a_from_b[:3, :3], a_from_b[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = turn
    result[3:, :3] = cross @ turn
    return result
