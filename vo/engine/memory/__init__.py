"""Memory of a run: from keyframes that are removed from the local map to one map of all places."""
