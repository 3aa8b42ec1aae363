"""Memory of a run: from keyframes that leave the local map to one map of all places."""
