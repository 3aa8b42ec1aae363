"""Procedural worlds, generated from a seed without downloads."""
