"""A ROS 2 node: images and camera_info in, odometry and tf out. README.md has its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from message_filters import ApproximateTimeSynchronizer, Subscriber
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from ros_conversions import (
    FRAME_VARIANCE,
    NS_PER_S,
    ROBOT_FROM_OPTICAL,
    body_twist,
    image_array,
    matrix_of_transform,
    odom_from_base,
    pose_covariance,
    rig_from_camera_info,
    stamp_ns,
)
from sensor_msgs.msg import CameraInfo, Image
from tf2_ros import Buffer, TransformBroadcaster, TransformException, TransformListener

import vo

_SIDES = ("left", "right")
_QUEUE_SIZE = 10
_REPEAT_S = 5.0  # between equal log lines


class VisualOdometryNode(Node):
    """Publishes the pose of the robot for each image or pair of images.

    Subscriptions: `left/image`, `left/camera_info`, and in stereo the same of `right`.
    Publications: `odom` (nav_msgs/Odometry) and the transform from the odom to the base frame.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("visual_odometry", **options)
        self._config = self.declare_parameter("config", "default").value
        self._calibration = self.declare_parameter("calibration", "").value
        self._is_stereo = self.declare_parameter("stereo", True).value
        self._is_rectified = self.declare_parameter("rectified", False).value
        self._odom_frame = self.declare_parameter("odom_frame", "odom").value
        self._base_frame = self.declare_parameter("base_frame", "base_link").value
        self._has_tf = self.declare_parameter("publish_tf", True).value
        slop_s = self.declare_parameter("max_stamp_difference_s", 0.005).value

        self._odometry: vo.Odometry | None = None
        self._base_from_cam0: np.ndarray | None = None
        self._infos: dict[str, CameraInfo] = {}
        self._keyframe: vo.KeyframePose | None = None  # the newest one with a covariance
        self._segment = 0
        self._before: tuple[int, np.ndarray] | None = None  # stamp and pose of the frame before

        self._publisher = self.create_publisher(Odometry, "odom", 10)
        self._broadcaster = TransformBroadcaster(self)
        self._transforms = Buffer()
        self._listener = TransformListener(self._transforms, self)
        sides = _SIDES if self._is_stereo else _SIDES[:1]
        self._images = [
            Subscriber(self, Image, f"{side}/image", qos_profile=qos_profile_sensor_data)
            for side in sides
        ]
        for side in sides:
            self._listen_to_camera_info(side)
        if self._is_stereo:
            self._pairs = ApproximateTimeSynchronizer(self._images, _QUEUE_SIZE, slop_s)
            self._pairs.registerCallback(self.on_images)
        else:
            self.get_logger().warning("one camera alone: lengths are not in metres")
            self._images[0].registerCallback(self.on_images)

    def _listen_to_camera_info(self, side: str) -> None:
        def keep(message: CameraInfo) -> None:
            self._infos[side] = message

        topic = f"{side}/camera_info"
        self.create_subscription(CameraInfo, topic, keep, qos_profile_sensor_data)

    def on_images(self, left: Image, right: Image | None = None) -> None:
        """Track an image or a pair, and publish its pose."""
        try:
            if not self._is_ready(left):
                return
            assert self._odometry is not None
            images = [None if each is None else image_array(each) for each in (left, right)]
            estimate = self._odometry.track(stamp_ns(left), *images)
        except vo.VoError as error:
            self.get_logger().error(str(error), throttle_duration_sec=_REPEAT_S)
            return
        self._keep_covariance(estimate)
        if estimate.world_from_cam0 is None:
            self._before = None
            self.get_logger().warning(
                f"no pose: {estimate.state.value}", throttle_duration_sec=_REPEAT_S
            )
            return
        self._publish(left, estimate)

    def _is_ready(self, left: Image) -> bool:
        """Whether cameras and mounting are known; else this is tried again with the next image."""
        if self._base_from_cam0 is None:
            self._base_from_cam0 = self._look_up_camera(left.header.frame_id)
        if self._base_from_cam0 is None:
            return False
        if self._odometry is None:
            rig = self._rig()
            if rig is None:
                return False
            self.get_logger().info("starting; this takes a minute unless `vo warmup` was run")
            self._odometry = vo.Odometry(rig, config=self._config)
        return True

    def _look_up_camera(self, frame: str) -> np.ndarray | None:
        """Pose of the camera on the robot; without a base frame the camera is the robot."""
        if not self._base_frame:
            return ROBOT_FROM_OPTICAL
        try:
            found = self._transforms.lookup_transform(self._base_frame, frame, Time())
        except TransformException as error:
            self.get_logger().warning(
                f"waiting for the transform from {self._base_frame} to {frame}: {error}",
                throttle_duration_sec=_REPEAT_S,
            )
            return None
        return matrix_of_transform(found.transform)

    def _rig(self) -> vo.Rig | None:
        if self._calibration:
            return vo.read_calibration(self._calibration)
        missing = [side for side in _SIDES[: len(self._images)] if side not in self._infos]
        if missing:
            self.get_logger().warning(
                f"waiting for {missing[0]}/camera_info", throttle_duration_sec=_REPEAT_S
            )
            return None
        left, right = self._infos["left"], self._infos.get("right")
        return rig_from_camera_info(left, right, rectified=self._is_rectified)

    def _keep_covariance(self, estimate: vo.Estimate) -> None:
        if estimate.segment != self._segment:
            self.get_logger().warning("tracking was lost; the motion in between is unknown")
            self._segment, self._keyframe = estimate.segment, None
        for keyframe in estimate.keyframes:
            if keyframe.segment == self._segment and keyframe.covariance is not None:
                self._keyframe = keyframe

    def _publish(self, left: Image, estimate: vo.Estimate) -> None:
        base_from_cam0, world_from_cam0 = self._base_from_cam0, estimate.world_from_cam0
        assert base_from_cam0 is not None and world_from_cam0 is not None
        if self._base_frame:
            child, pose = self._base_frame, odom_from_base(world_from_cam0, base_from_cam0)
        else:  # the axes of the camera stay those of its optical frame
            child, pose = left.header.frame_id, base_from_cam0 @ world_from_cam0
        message = Odometry()
        message.header.stamp = left.header.stamp
        message.header.frame_id = self._odom_frame
        message.child_frame_id = child
        x, y, z = pose[:3, 3].tolist()
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y, position.z = x, y, z
        qx, qy, qz, qw = vo.quat_xyzw_from_rotation(pose[:3, :3]).tolist()
        orientation.x, orientation.y, orientation.z, orientation.w = qx, qy, qz, qw
        covariance = pose_covariance(self._keyframe, world_from_cam0, base_from_cam0)
        message.pose.covariance = covariance.ravel()
        self._fill_twist(message, estimate.stamp_ns, pose)
        self._publisher.publish(message)
        if self._has_tf:
            self._send_transform(message)

    def _fill_twist(self, message: Odometry, now_ns: int, pose: np.ndarray) -> None:
        """Mean velocity since the frame before, zero and uncertain without one."""
        before, self._before = self._before, (now_ns, pose)
        if before is None:
            message.twist.covariance = np.eye(6).ravel()
            return
        seconds = (now_ns - before[0]) / NS_PER_S
        linear, angular = body_twist(before[1], pose, seconds)
        twist = message.twist.twist
        twist.linear.x, twist.linear.y, twist.linear.z = linear.tolist()
        twist.angular.x, twist.angular.y, twist.angular.z = angular.tolist()
        message.twist.covariance = np.diag(2.0 * FRAME_VARIANCE / seconds**2).ravel()

    def _send_transform(self, odometry: Odometry) -> None:
        message = TransformStamped()
        message.header = odometry.header
        message.child_frame_id = odometry.child_frame_id
        position = odometry.pose.pose.position
        translation = message.transform.translation
        translation.x, translation.y, translation.z = position.x, position.y, position.z
        message.transform.rotation = odometry.pose.pose.orientation
        self._broadcaster.sendTransform(message)

    def destroy_node(self) -> None:
        """End the odometry with the node."""
        if self._odometry is not None:
            self._odometry.close()
            self._odometry = None
        super().destroy_node()


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = VisualOdometryNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        return
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
