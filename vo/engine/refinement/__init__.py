"""Online calibration: estimates corrections of the cameras, applies none."""
