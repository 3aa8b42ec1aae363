"""Recordings as frames, and the formats of their files."""
