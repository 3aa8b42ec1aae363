"""What a camera makes of light: timing, exposure, lens and pixels."""
