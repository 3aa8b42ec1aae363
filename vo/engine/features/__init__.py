"""Detectors, descriptors and matchers by name, as the odometry uses them."""
