"""From matches to poses: the two-view start, frame to map, keyframe choice."""
