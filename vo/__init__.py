"""Visual odometry: a camera's path, with its uncertainty, from images."""

__version__ = "0.1.0"
