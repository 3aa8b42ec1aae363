"""File and message formats: trajectories, calibrations, images, models and messages of logs."""
