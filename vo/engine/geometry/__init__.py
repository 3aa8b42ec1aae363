"""Cameras, rigid motion and multi-view geometry on plain arrays."""
