"""Entities and colours of a recording; the entity tree is the frame tree.

The colours are those of Okabe and Ito (2008), which are distinct for all kinds of colour vision.
`cam0` is the recorded left camera; `left` and `right` below it are the rectified cameras.
"""

from __future__ import annotations

FRAME_TIMELINE = "frame"
SENSOR_TIMELINE = "sensor_time"

WORLD = "world"
CAM0 = "world/cam0"
LEFT = "world/cam0/left"
LEFT_IMAGE = "world/cam0/left/image"
FEATURES = "world/cam0/left/features"
MATCHES = "world/cam0/left/matches"
EPIPOLAR = "world/cam0/left/epipolar"
MARKERS = "world/cam0/left/markers"
RIGHT = "world/cam0/right"
RIGHT_IMAGE = "world/cam0/right/image"
STEREO_MATCHES = "world/cam0/right/matches"
CAUSAL_PATH = "world/path/causal"
SMOOTHED_PATH = "world/path/smoothed"
WINDOW_PATH = "world/path/window"
TRUE_PATH = "world/path/ground_truth"
LOOPS = "world/path/loops"
ODOMETRY_PATH = "world/path/before_loops"
MARKER_SQUARES = "world/markers"
GRAPH = "world/keyframes/graph"
COVARIANCE = "world/keyframes/covariance_10_sigma"
LOCAL_LANDMARKS = "world/landmarks/local"
SETTLED_LANDMARKS = "world/landmarks/settled"
TRACKING_PLOT = "plot/tracking"
REPROJECTION_PLOT = "plot/reprojection"
ERROR_PLOT = "plot/error"
TIME_PLOT = "plot/ms"
EVENTS = "events"
SUMMARY = "summary"
CAUSAL_POSES = "trajectory/causal"
SMOOTHED_POSES = "trajectory/smoothed"

Colour = tuple[int, int, int]

ORANGE: Colour = (230, 159, 0)
SKY: Colour = (86, 180, 233)
GREEN: Colour = (0, 200, 130)  # lighter than the original, for thin lines
BLUE: Colour = (60, 130, 210)  # lighter than the original, for a dark background
VERMILION: Colour = (225, 85, 20)
PINK: Colour = (204, 121, 167)
YELLOW: Colour = (240, 228, 66)
GREY: Colour = (150, 150, 150)

NEW, TRACKED, LANDMARK, REJECTED = "new", "tracked", "landmark", "rejected"
FEATURE_COLOURS: dict[str, Colour] = {
    NEW: SKY,
    TRACKED: GREEN,
    LANDMARK: PINK,
    REJECTED: VERMILION,
}
STAGE_COLOURS: tuple[Colour, ...] = (ORANGE, SKY, GREEN, PINK, VERMILION, YELLOW, BLUE)
MAP_BACKGROUND: Colour = (22, 24, 29)  # dark: landmarks are grey as in the images
