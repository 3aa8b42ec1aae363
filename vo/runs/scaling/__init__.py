"""Sources of the metric scale of a mono path: positions of other sensors, height of the camera."""
