"""Samples of an inertial sensor (they enter in `samples`), preintegration, scale and gravity."""
