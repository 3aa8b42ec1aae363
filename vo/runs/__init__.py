"""Runs from a recording to its outputs: one, and batches of many."""
