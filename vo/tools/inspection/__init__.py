"""Inspection of recordings: contents, quality, problems and advice."""
