"""Bags of ROS 1 and ROS 2 as logs, without an installation of ROS."""
