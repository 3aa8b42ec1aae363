"""Evaluation of estimated trajectories against ground truth (ATE, RPE, drift)."""
