"""Readers of recordings: frames in time order, calibration, inertial samples, ground truth."""
