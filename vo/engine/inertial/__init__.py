"""Inertial measurements beside the cameras: samples, preintegration, metric scale and gravity."""
