"""Visual odometry: a camera's path, with its uncertainty, from images."""

__version__ = "0.2.0"
