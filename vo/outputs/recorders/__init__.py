"""Recorders of a run: for the rerun viewer and as files for other programs."""
