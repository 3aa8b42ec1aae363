"""How trajectories, calibrations and messages look on disk."""
