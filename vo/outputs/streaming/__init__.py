"""Poses of a run for other programs, frame by frame: JSON lines, UDP datagrams, Foxglove."""
