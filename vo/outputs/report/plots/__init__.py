"""Figures of a report, grouped by subject."""
