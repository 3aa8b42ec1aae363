"""Recordings on disk, in the layouts that people use."""
