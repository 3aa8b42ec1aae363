"""Tracking: each frame's pose in the map, first maps, and the decision on keyframes."""
