"""Closed loops: keyframes that leave the local map, places seen again, pose graph, map files."""
