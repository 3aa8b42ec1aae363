"""Odometry with any number of cameras, as views of one kind of pinhole camera."""
