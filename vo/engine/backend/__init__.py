"""Sliding-window optimisation; the only room that imports gtsam."""
