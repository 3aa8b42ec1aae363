"""The GTSAM window over keyframe poses and landmarks; the only room that imports gtsam."""
