"""Model of the camera's sensor: timing, exposure, vignetting, noise and response."""
