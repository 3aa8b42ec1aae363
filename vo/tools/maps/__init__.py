"""Saved maps: what is in them, two as one, and their points."""
