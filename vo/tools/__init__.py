"""Commands beside the run: calibration, inspection, markers, objects and others."""
