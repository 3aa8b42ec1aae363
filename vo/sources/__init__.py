"""Recordings on disk, as frames in time order."""
