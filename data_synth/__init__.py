"""Synthetic recordings with exact ground truth: worlds, paths, a renderer and writers."""
