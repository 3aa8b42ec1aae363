"""Names of what a recording holds, and its colours; entity tree = frame tree.

Colours are those of Okabe and Ito (2008), which the colour-blind can tell apart; all show on a
light and on a dark ground, since the viewer follows the desktop's theme.
"""

from __future__ import annotations

from vo.types import FeatureState

FRAME_TIMELINE = "frame"
SENSOR_TIMELINE = "sensor_time"

WORLD = "world"
CAMERA = "world/cam0"
IMAGE = "world/cam0/image"
MATCHES = "world/cam0/image/matches"
KEYPOINTS = "world/cam0/image/keypoints"
CAUSAL_PATH = "world/path/causal"
SMOOTHED_PATH = "world/path/smoothed"
WINDOW = "world/path/window"
TRUE_PATH = "world/path/ground_truth"
LOCAL_LANDMARKS = "world/landmarks/local"
SETTLED_LANDMARKS = "world/landmarks/settled"
TRACKING_PLOT = "plot/tracking"
TIME_PLOT = "plot/ms"
EVENTS = "events"
CAUSAL_POSES = "trajectory/causal"
SMOOTHED_POSES = "trajectory/smoothed"

KEYPOINT_NAMES = {
    FeatureState.NEW: "new",
    FeatureState.TRACKED: "tracked",
    FeatureState.REJECTED: "rejected",
}

Colour = tuple[int, int, int]

ORANGE: Colour = (230, 159, 0)
SKY: Colour = (86, 180, 233)
GREEN: Colour = (0, 200, 130)  # lighter than theirs, for thin lines
VERMILION: Colour = (225, 85, 20)
PINK: Colour = (204, 121, 167)
YELLOW: Colour = (240, 228, 66)  # over images only
GREY: Colour = (128, 128, 128)

KEYPOINT_COLOURS: dict[int, Colour] = {
    FeatureState.NEW: SKY,
    FeatureState.TRACKED: GREEN,
    FeatureState.REJECTED: VERMILION,
}
STAGE_COLOURS: tuple[Colour, ...] = (ORANGE, SKY, GREEN, PINK, VERMILION)
