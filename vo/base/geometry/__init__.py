"""Poses, cameras and rectification."""
